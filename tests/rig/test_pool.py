"""Workers of a proof share its work out and end with it, however it ends."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rig.results.prove.pool import each

PATIENCE_S = 60.0
"""Of the test, where workers never start or never end."""


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_is_done_once(jobs: int) -> None:
    assert sorted(each(abs, [-3, 2, -1], jobs)) == [1, 2, 3]


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    fifo = tmp_path / "alive"
    os.mkfifo(fifo)
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    try:
        script = Path(__file__).with_name("orphans.py")
        with subprocess.Popen([sys.executable, script, fifo], stderr=subprocess.DEVNULL) as parent:
            try:
                started = b""
                while len(started) < 2:
                    started += _next(reading)
            finally:
                parent.send_signal(signal.SIGKILL)
        assert _next(reading) == b"", "end of file: no worker holds the pipe any more"
    finally:
        os.close(reading)


def _next(reading: int) -> bytes:
    ready, _, _ = select.select([reading], [], [], PATIENCE_S)
    assert ready, "workers are still there"
    return os.read(reading, 1)
