"""Finds the example benches and sequences that are packaged with the program, by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from drivers.plain_file import require_plain
from rig.common.errors import InputError
from rig.common.input_files import is_file
from rig.config.configuration import nearest

_HERE = Path(__file__).parent


def names(kind: Literal["benches", "sequences"]) -> list[str]:
    """Return the packaged names of one kind."""
    return sorted(path.stem for path in (_HERE / kind).glob("*.yaml"))


def packaged(name: str, kind: Literal["benches", "sequences"]) -> Path:
    """Return the path of the packaged file of this name; the file need not exist."""
    return _HERE / kind / f"{name}.yaml"


def resolve(name: str | Path, kind: Literal["benches", "sequences"]) -> Path:
    """Return the file for a name: the file at this path if it exists, else the packaged file of
    this name.

    Raises:
        InputError: Neither file exists, or the path is not a file; the message suggests the nearest
            packaged names.
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
