"""Finds the input files of a run by their entries in ``run.json``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from rig.common.input_files import is_file
from rig.common.provenance import sha256_file
from rig.common.text import stored_path, valid


def input_entry(path: str | os.PathLike[str], sha256: str) -> dict[str, str]:
    """Return the path of an input file for ``run.json``; it is absolute, because a run may be
    resumed from another working folder.
    """
    return {"file": valid(os.path.abspath(path)), "sha256": sha256}


def recorded_input(folder: Path, entry: Mapping[str, str]) -> Path:
    """Return the present path of an input file of a run; the file may not exist.

    Older run files have the path as typed. If it is not valid from the current folder, it is tried
    from the parent folders of the run, as the run was probably started in one of these.

    Args:
        folder: The run folder.
        entry: Entry of the file in ``run.json``.
    """
    path = stored_path(entry["file"])
    if path.is_absolute():
        return path
    candidates = (base / path for base in (Path(), *folder.absolute().parents))
    return next(
        (candidate for candidate in candidates if _is_file(candidate, entry["sha256"])), path
    )


def _is_file(path: Path, sha256: str) -> bool:
    try:
        return is_file(path) and sha256_file(path) == sha256
    except OSError:
        return False
