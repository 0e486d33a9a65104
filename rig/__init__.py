"""The bench: configuration, sequences, safety, recorder, command line and reports, wired together
here; in Python, :func:`open` reads recordings for the library ``identification``.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from identification.recording import Dataset

__all__ = ["open"]


def open(path: str | PathLike[str], *, partial: bool = False) -> Dataset:
    """Return the recordings of a run folder or campaign file, for the library ``identification``.

    Args:
        path: Run folder or campaign file.
        partial: Whether to read unfinished excitations of a run as well.

    Raises:
        InputError: The source cannot be read; the message has a line for each problem.
    """
    from rig.sources import load_source

    return load_source(Path(path), partial=partial)
