"""Writes a new file: the file is validated before it gets its name, and never replaces an existing
file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from rig.cli.authoring.beside import FOLDER, first_line, require_schema_place, write_schema
from rig.common.errors import InputError
from rig.common.places import replacing, require_file


class RefusedError(InputError):
    """The answers do not give a valid file; nothing was written."""


def require_new(path: Path, kind: str) -> None:
    """Check, before any question, that a file and its schema can be written.

    Raises:
        InputError: The file exists already, its folder does not exist, or it cannot be written.
    """
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(
            f"{path}: the name must end in .yaml, because the commands that read the file expect "
            "this ending"
        )
    if path.exists():
        raise InputError(
            f"{path}: exists already and is not overwritten; choose another name, or move the "
            "file away"
        )
    require_file(path, "PATH")
    require_schema_place(path.parent / FOLDER / f"{kind}.schema.json")


def write_new(path: Path, kind: str, body: str, load: Callable[[Path], object]) -> list[Path]:
    """Write a file that was made from answers, and its schema.

    Args:
        path: The file.
        kind: Kind of file, one of :data:`rig.cli.authoring.schema.KINDS`.
        body: Text of the file without its first line.
        load: Reads the file and raises InputError if it is not valid; called before the file gets
            its name.

    Returns:
        Description of the written files.

    Raises:
        RefusedError: The answers give no valid file.
        InputError: A file cannot be written.
    """
    require_new(path, kind)
    try:
        with replacing(path) as draft:
            draft.write_text(f"{first_line(kind)}\n{body}", encoding="utf-8")
            try:
                load(draft)
            except InputError as error:
                raise RefusedError(_without_place(error.problems, draft)) from error
            schema = write_schema(kind, path.parent / FOLDER)
            if path.exists():
                raise InputError(
                    f"{path}: another program has created this file meanwhile; the file is not "
                    "overwritten"
                )
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written: {error.strerror}; choose another place"
        ) from error
    return [path, schema]


def _without_place(problems: Iterable[str], draft: Path) -> Iterator[str]:
    """Yield messages with keys but without line numbers, because the file does not exist."""
    place = re.compile(rf"{re.escape(str(draft))}:(\d+:\d+: )?")
    for line in problems:
        yield f"not written: {place.sub('', line).strip()}"
