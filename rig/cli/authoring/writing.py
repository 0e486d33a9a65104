"""Writes a new file from its template: validated before it is named, never over another."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from rig.cli.authoring.schema import json_schema
from rig.common.errors import InputError
from rig.common.places import replacing, require_file, require_folder, usable, write_text
from rig.common.yaml_tree import scalar

FOLDER: Final = "schemas"  # subfolder for schemas in the folder of a file
_OWN: Final = '"$id": "urn:loadrig:'


def write_schema(kind: str, folder: Path) -> Path:
    """Write a schema into a folder, over an earlier one of this program; return the path."""
    path = folder / f"{kind}.schema.json"
    _require_schema_place(path)
    with usable(path, "written", "choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(json_schema(kind), indent=1) + "\n")
    return path


def _require_schema_place(path: Path) -> None:
    """Check that a schema can be written here."""
    require_folder(path.parent, "--out")
    with usable(path, "read", "move the file away"):
        if path.exists() and _OWN not in path.read_text(encoding="utf-8", errors="replace")[:400]:
            raise InputError(
                f"{path}: exists already and is no schema of this program; move the file away"
            )


def fill(kind: str, values: Mapping[str, Any]) -> str:
    """Return the text of a file from the template of its kind, without its first line."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        undefined=StrictUndefined,
        trim_blocks=True,
        finalize=flow,
    )
    text = environment.get_template(f"{kind}.yaml.j2").render(values)
    return text if text.endswith("\n") else f"{text}\n"


_PLAIN: Final = re.compile(r"[A-Za-z_][\w./+-]*")


def flow(value: Any) -> str:
    """Return plain data in the flow style of YAML; numbers have twelve digits."""
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{flow(key)}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str) and _PLAIN.fullmatch(value) and scalar(value) == value:
        return value
    return json.dumps(value, ensure_ascii=False)


class RefusedError(InputError):
    """The answers do not give a valid file; nothing was written."""


def require_new(path: Path, kind: str) -> None:
    """Check, before any question, that a file and its schema can be written."""
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
    _require_schema_place(path.parent / FOLDER / f"{kind}.schema.json")


def write_new(path: Path, kind: str, body: str, load: Callable[[Path], object]) -> list[Path]:
    """Write a file that was made from answers, and its schema; return their paths."""
    require_new(path, kind)
    with usable(path, "written", "choose another place"), replacing(path) as draft:
        schema_line = f"# yaml-language-server: $schema={FOLDER}/{kind}.schema.json"
        draft.write_text(f"{schema_line}\n{body}", encoding="utf-8")
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
    return [path, schema]


def _without_place(problems: Iterable[str], draft: Path) -> Iterator[str]:
    """Yield messages with keys but without line numbers, because the file does not exist."""
    place = re.compile(rf"{re.escape(str(draft))}:(\d+:\d+: )?")
    for line in problems:
        yield f"not written: {place.sub('', line).strip()}"
