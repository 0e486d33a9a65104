"""Finds run folders, and computes a signature of the files from which an entry is made."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

RUN_JSON, RECORDING = "run.json", "recording.mcap"
COMMISSION_JSON = "commission.json"
RESULTS = ("identify.json", "diagnosis/diagnose.json", "acceptance.json")
"""Result files of a run folder whose verdicts are listed."""
MOST_DEEP = 8
"""Number of folder levels below the searched folder that are searched for runs."""


class Found(NamedTuple):
    """A run folder.

    Attributes:
        folder: Path relative to the searched folder; ``.`` for the searched folder itself.
        signature: Inode, time of change and size of each file from which the entry is made.
    """

    folder: str
    signature: str


def find_runs(root: Path) -> Iterator[Found]:
    """Yield the run folders in and below ``root``, in any order; each link is followed once.

    A run folder has a ``run.json`` or a ``recording.mcap``; run folders are not searched for
    further runs.
    """
    yield from _found(str(root), "", 0, {os.path.realpath(root)})


def _found(root: str, folder: str, depth: int, seen: set[str]) -> Iterator[Found]:
    path = f"{root}/{folder}" if folder else root
    signature = signature_of(path)
    if signature is not None:
        yield Found(folder or ".", signature)
        return
    if depth == MOST_DEEP:
        return
    try:
        with os.scandir(path) as items:
            below = [item for item in items if not item.name.startswith(".") and item.is_dir()]
    except OSError as error:
        if depth:
            yield Found(folder, f"unreadable {error.errno}")
            return
        raise
    for item in below:
        if item.is_symlink():
            target = os.path.realpath(item.path)
            if target in seen:
                continue
            seen.add(target)
        inner = f"{folder}/{item.name}" if folder else item.name
        yield from _found(root, inner, depth + 1, seen)


def signature_of(path: str) -> str | None:
    """Return the signature of a run folder, or None if the folder is not a run folder."""
    first = _stamp(f"{path}/{RUN_JSON}")
    if not first:
        # A half-written run folder may have only the recording.
        first = _stamp(f"{path}/{RECORDING}")
        if not first:
            return None
        first = f"recording {first} {_stamp(f'{path}/{COMMISSION_JSON}')}"
    return ";".join([first, *(_stamp(f"{path}/{name}") for name in RESULTS)])


def _stamp(path: str) -> str:
    """Return inode, time of change and size of a file; empty if the file does not exist."""
    try:
        found = os.stat(path)
    except OSError:
        return ""
    return f"{found.st_ino}.{found.st_ctime_ns}.{found.st_size}"
