"""A parent whose workers hang, run by ``test_pool`` in a process of its own:
``python orphans.py FIFO``.
"""

from __future__ import annotations

import sys
import threading

from rig.results.prove.pool import each


def hang(fifo: str) -> None:
    """Say so through the pipe, hold it open, and do not come back."""
    with open(fifo, "wb", buffering=0) as pipe:
        pipe.write(b"!")
        threading.Event().wait(120.0)


if __name__ == "__main__":
    list(each(hang, [sys.argv[1]] * 2, 2))
