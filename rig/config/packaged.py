"""Example benches and sequences that ship with the program, reachable by bare name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from drivers.plain_file import require_plain
from rig.common.errors import InputError
from rig.common.input_files import is_file
from rig.config.configuration import nearest

_HERE = Path(__file__).parent


def names(kind: Literal["benches", "sequences"]) -> list[str]:
    """List the packaged names of one kind."""
    return sorted(path.stem for path in (_HERE / kind).glob("*.yaml"))


def packaged(name: str, kind: Literal["benches", "sequences"]) -> Path:
    """Return where the packaged file of that name is, or would be."""
    return _HERE / kind / f"{name}.yaml"


def resolve(name: str | Path, kind: Literal["benches", "sequences"]) -> Path:
    """Return the file a name stands for: the path itself if it exists, else the packaged file of
    that name.

    Raises:
        InputError: Neither is there, or the path is no file; suggests the nearest packaged names.
    """
    path = Path(name)
    if is_file(path):
        return path
    shipped = packaged(str(name), kind)
    if path.name == str(name) and is_file(shipped):
        return shipped
    try:
        require_plain(path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror}") from error
    raise InputError(
        f"{name}: no such file, and not a packaged name; {nearest(str(name), names(kind))}"
    )
