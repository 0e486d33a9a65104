"""Input files of a run, found by their entries in ``run.json``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from rig.common.input_files import is_file
from rig.common.provenance import sha256_file
from rig.common.text import stored_path, valid


def input_entry(path: str | os.PathLike[str], sha256: str) -> dict[str, str]:
    """Return an input file's path for ``run.json``: absolute, as a run may go on from another
    folder.
    """
    return {"file": valid(os.path.abspath(path)), "sha256": sha256}


def recorded_input(folder: Path, entry: Mapping[str, str]) -> Path:
    """Return where an input file of a run is now; it may be missing.

    Older run files hold the path as it was typed. Where it does not lead to the file from the
    current folder, it is followed from the folders above the run, one of which the run was most
    likely started in.

    Args:
        folder: The run folder.
        entry: Of the file in ``run.json``.
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
