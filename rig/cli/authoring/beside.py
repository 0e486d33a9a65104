"""Writes the JSON Schema beside a file, and composes the first line of the file, which refers an
editor to the schema.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from rig.cli.authoring.schema import json_schema
from rig.common.errors import InputError
from rig.common.places import require_folder, write_text

FOLDER: Final = "schemas"
"""Subfolder for schemas in the folder of a file."""
_OWN: Final = '"$id": "urn:loadrig:'


def first_line(kind: str) -> str:
    """Return the comment that names the schema of a file, relative to the file itself.

    A relative path stays valid when the folder is moved or shared, and needs neither network nor an
    installed program.
    """
    return f"# yaml-language-server: $schema={FOLDER}/{kind}.schema.json"


def write_schema(kind: str, folder: Path) -> Path:
    """Write a schema into a folder; an earlier schema of this program is replaced. Return the path.

    Raises:
        InputError: The schema cannot be written, or another file of that name is there.
    """
    path = folder / f"{kind}.schema.json"
    require_schema_place(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(json_schema(kind), indent=1) + "\n")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written: {error.strerror}; choose another folder"
        ) from error
    return path


def require_schema_place(path: Path) -> None:
    """Check that a schema can be written into a folder.

    Raises:
        InputError: The folder cannot be made, or the file exists and is not a schema of this
            program.
    """
    require_folder(path.parent, "--out")
    try:
        if path.exists() and _OWN not in path.read_text(encoding="utf-8", errors="replace")[:400]:
            raise InputError(
                f"{path}: exists already and is no schema of this program; move the file away"
            )
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; move the file away") from error
