"""Makes the entry of a run folder from its files; a folder with missing or damaged files also gives
an entry.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_json
from rig.common.provenance import sha256_file
from rig.common.result_files import IDENTIFY_SCHEMA
from rig.common.yaml_tree import DocumentError, parse
from rig.runs.catalogue.entry import Constant, Details, Head
from rig.runs.catalogue.walk import COMMISSION_JSON, RECORDING, RESULTS, RUN_JSON
from rig.runs.mcap.records import DamageError
from rig.runs.mcap.stream import first_attachment
from rig.runs.run_file import read_record
from rig.runs.run_record import BENCH_ATTACHMENT, SCHEMA, RunRecord

IDENTIFY, DIAGNOSE, ACCEPTANCE = RESULTS
ROLES = ("servo", "encoder", "pressure")
"""Roles of the devices of a bench."""
_DIAGNOSE_SCHEMA, _ACCEPTANCE_SCHEMA = "loadrig.diagnose/1", "loadrig.acceptance/1"
_TEXTS = {"sequence": "name", "created": "created", "state": "state", "message": "message"}

Benches = MutableMapping[str, str]
"""Names of benches by the SHA-256 of the bench file, so that each file is read once."""


def read_entry(folder: Path, benches: Benches) -> tuple[Head, Details]:
    """Return the entry of a run folder.

    Args:
        folder: The folder.
        benches: Known names of benches, to which this function adds names.
    """
    path = folder / RUN_JSON
    if not is_file(path):
        return _without_record(folder), Details()
    try:
        digest = sha256_file(path)
        record = read_record(folder)
    except (InputError, OSError) as error:
        return _not_a_run(path, error), Details()
    notes: list[str] = []
    results = [_result(folder / name, notes) for name in RESULTS]
    identified, diagnosed, accepted = results
    if identified and identified["schema"] != IDENTIFY_SCHEMA:
        notes.append(
            f"{IDENTIFY}: its format {identified['schema']} cannot be read by this version"
        )
        identified = {}
    head = dataclasses.replace(
        _head(folder, record, benches),
        identified=str(identified.get("method", "")),
        diagnosis=_verdict(diagnosed, _DIAGNOSE_SCHEMA),
        acceptance=_verdict(accepted, _ACCEPTANCE_SCHEMA),
        digest=digest,
        notes=tuple(notes),
    )
    return head, _details(record, identified)


def _without_record(folder: Path) -> Head:
    """Return the entry of a folder that has a recording and no ``run.json``."""
    if is_file(folder / COMMISSION_JSON):
        notes: list[str] = []
        found = _result(folder / COMMISSION_JSON, notes)
        keys = ("created", "bench", "state", "message")
        known = {key: found[key] for key in keys if isinstance(found.get(key), str)}
        operator, real = found.get("operator"), found.get("real")
        return Head(
            "commissioning",
            **known,
            simulated=None if real is None else not real,
            operators=(operator,) if isinstance(operator, str) else (),
            notes=tuple(notes),
        )
    try:
        first_attachment(folder / RECORDING, RUN_JSON)
    except (DamageError, OSError):
        problem = (
            f"there is neither a {RUN_JSON} nor a copy of it in the recording, as after a "
            "commissioning that died; remove the folder, or repeat the commissioning in a new one"
        )
        return Head("half written", problem)
    return Head("half written", f"there is no {RUN_JSON}; `rig recover` rebuilds it")


def _head(folder: Path, record: RunRecord, benches: Benches) -> Head:
    operators = [part.operator for part in record.parts if part.operator]
    masses = [s.confirmed_kg for s in record.stages if s.confirmed_kg is not None]
    return Head(
        sequence=record.name,
        created=record.created,
        bench=bench_name(folder, record, benches),
        simulated=record.simulated,
        operators=tuple(dict.fromkeys(operators or filter(None, [record.operator]))),
        masses_kg=tuple(sorted(set(masses or [s.weight_kg for s in record.stages]))),
        state=record.state,
        message=record.message,
        seconds=record.seconds,
        weights=tuple(dict.fromkeys(str(w["verdict"]) for w in record.weights)),
    )


def _details(record: RunRecord, identified: Mapping[str, Any]) -> Details:
    last = record.parts[-1].devices
    devices = {
        role: f"{last[role].get('name')}, serial {last[role].get('serial_number')}"
        for role in ROLES
        if isinstance(last.get(role), Mapping)
    }
    fit = identified.get("fit")
    fit = fit if isinstance(fit, Mapping) else {}
    return Details(
        constants_of(identified),
        _number(fit.get("train_rms")),
        str(fit.get("unit") or ""),
        str(record.bench["motion"]),
        devices,
    )


def constants_of(identified: Mapping[str, Any]) -> dict[str, Constant]:
    """Return the parameters of a result of ``rig identify``; a value that is not a number becomes
    None.
    """
    parameters = identified.get("parameters")
    return {
        str(name): Constant(
            _number(each.get("value")),
            _number(each.get("low")),
            _number(each.get("high")),
            str(each.get("unit") or ""),
            bool(each.get("at_bound")),
        )
        for name, each in (parameters.items() if isinstance(parameters, Mapping) else ())
        if isinstance(each, Mapping)
    }


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _verdict(result: Mapping[str, Any], schema: str) -> str:
    return str(result.get("verdict", "")) if result.get("schema") == schema else ""


def _result(path: Path, notes: list[str]) -> dict[str, Any]:
    """Return a result file; empty if the file does not exist or, with a note, if it cannot be
    read.
    """
    if not is_file(path):
        return {}
    try:
        found = read_json(path)
    except InputError as error:
        notes.append(error.problems[0])
        return {}
    if not isinstance(found, dict) or not isinstance(found.get("schema"), str):
        notes.append(f"{path}: not a result file of this program")
        return {}
    return found


def _not_a_run(path: Path, error: InputError | OSError) -> Head:
    """Return the entry of a folder whose record cannot be read, with the message of the error."""
    problem = error.problems[0] if isinstance(error, InputError) else f"{path}: {error}"
    try:
        raw = json.loads(path.read_bytes())
    except (OSError, RecursionError):
        return Head("unreadable", problem)
    except ValueError:
        return Head("half written", problem)
    if not isinstance(raw, dict):
        return Head("unreadable", problem)
    said = {key: raw[name] for key, name in _TEXTS.items() if isinstance(raw.get(name), str)}
    kind = "unreadable" if raw.get("schema") == SCHEMA else "other version"
    return Head(kind, problem, **said)  # type: ignore[arg-type]


def bench_name(folder: Path, record: RunRecord, benches: Benches | None = None) -> str:
    """Return the bench's name from the bench file that is attached to the recording, else the name
    of the file.
    """
    benches = {} if benches is None else benches
    source = record.inputs[BENCH_ATTACHMENT]
    digest = source["sha256"]
    if digest not in benches:
        benches[digest] = _attached_name(folder / RECORDING) or Path(source["file"]).stem
    return benches[digest]


def _attached_name(path: Path) -> str:
    try:
        content = first_attachment(path, BENCH_ATTACHMENT)
        root, _ = parse(content.decode("utf-8"))
        bench = root.plain()
    except (DamageError, OSError, DocumentError, UnicodeDecodeError):
        return ""
    name = bench.get("name") if isinstance(bench, dict) else None
    return name if isinstance(name, str) else ""
