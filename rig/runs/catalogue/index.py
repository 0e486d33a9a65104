"""Keeps an index of run folders; the index can be deleted at any time.

Each row holds the entry of one folder, and the signature of the files from which the entry was
made. A row is used only if its signature agrees with the present files; all other folders are read
again, and so are all folders if the checksum of the index is wrong. Therefore a deleted, damaged or
older index does not change the answers.
"""

from __future__ import annotations

import dataclasses
import json
import os
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from os.path import isdir
from pathlib import Path
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.places import is_file, read_bytes, read_json, replacing, usable
from rig.common.provenance import ACCEPTANCE_SCHEMA, DIAGNOSE_SCHEMA, IDENTIFY_SCHEMA, sha256_file
from rig.common.yaml_tree import DocumentError, parse
from rig.runs.catalogue.entry import Constant, Details, Entry, Head
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.run_file import read_record
from rig.runs.run_record import BENCH_ATTACHMENT, SCHEMA, RunRecord

RUN_JSON, RECORDING = "run.json", "recording.mcap"
COMMISSION_JSON = "commission.json"
RESULTS = ("identify.json", "diagnosis/diagnose.json", "acceptance.json")
"""Result files of a run folder whose verdicts are listed."""
MOST_DEEP = 8  # number of folder levels below the searched folder that are searched for runs


class Found(NamedTuple):
    """A run folder."""

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
            below = [item for item in items if not item.name.startswith(".") and isdir(item.path)]
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


INDEX_FILE = ".runs.index"
"""Name of the index in the searched folder: a checksum, and the rows as JSON."""
_FORMAT = 4  # format of the rows; the checksum begins with it, so that other formats are not used


class _Row(NamedTuple):
    """A row of the index: a run folder, the signature of its files, and its entry."""

    folder: str
    signature: str
    head: dict[str, Any]
    details: str

    @property
    def entry(self) -> Entry:
        return Entry(self.folder, Head.of(self.head), self.details)


class Listing(NamedTuple):
    """Result of a search for the runs below a folder."""

    entries: list[Entry]
    read: int
    note: str


def list_runs(root: Path, progress: Callable[[int, int], None] | None = None) -> Listing:
    """Return the runs in and below a folder, from the index if the index is current."""
    with usable(root, "searched"):
        found = list(find_runs(root))
    file = root / INDEX_FILE
    rows = _load(file)
    signed = {folder: row.signature for folder, row in rows.items()}
    kept = [rows[each.folder] for each in found if signed.get(each.folder) == each.signature]
    fresh = [each for each in found if signed.get(each.folder) != each.signature]
    made: list[_Row] = []
    benches: dict[str, str] = {}
    for each in fresh:
        path = root / each.folder
        head, details = Head("unreadable", f"{path}: no permission to read"), Details()
        if not each.signature.startswith("unreadable"):
            head, details = _read_entry(path, benches)
        first, second = (dataclasses.asdict(part) for part in (head, details))
        made.append(_Row(*each, first, json.dumps(second)))
        if progress is not None:
            progress(len(made), len(fresh))
    every = [*kept, *made]
    note = ""
    if len(kept) < max(len(every), len(rows)) and not any(each.folder == "." for each in found):
        note = _store(root, file, every)
    entries = sorted(
        (row.entry for row in every), key=lambda entry: (entry.head.created, entry.folder)
    )
    return Listing(entries, len(made), note)


def _load(file: Path) -> Mapping[str, _Row]:
    """Return the rows of an index by folder; empty if it cannot be used."""
    try:
        checksum, _, text = read_bytes(file).partition(b"\n")
    except OSError:
        return {}
    if checksum != _checksum(text):
        return {}
    return {row[0]: _Row(*row) for row in json.loads(text)}


def _checksum(text: bytes) -> bytes:
    return str(zlib.crc32(text, _FORMAT)).encode()


def _store(root: Path, file: Path, rows: Iterable[_Row]) -> str:
    """Write the index with the rows whose files are unchanged; return why that failed."""
    kept = [row for row in rows if signature_of(str(root / row.folder)) == row.signature]
    text = json.dumps(kept).encode()
    try:
        with replacing(file) as draft:
            draft.write_bytes(_checksum(text) + b"\n" + text)
    except OSError as error:
        return (
            f"{file}: the index cannot be written ({error}); each list therefore reads all runs "
            "again"
        )
    return ""


IDENTIFY, DIAGNOSE, ACCEPTANCE = RESULTS
ROLES = ("servo", "encoder", "pressure")  # roles of the devices of a bench
_TEXTS = {"sequence": "name", "created": "created", "state": "state", "message": "message"}

Benches = MutableMapping[str, str]
"""Names of benches by the SHA-256 of the bench file, so that each file is read once."""


def _read_entry(folder: Path, benches: Benches) -> tuple[Head, Details]:
    """Return the entry of a run folder; ``benches`` are the known names."""
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
        diagnosis=_verdict(diagnosed, DIAGNOSE_SCHEMA),
        acceptance=_verdict(accepted, ACCEPTANCE_SCHEMA),
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
    masses = [s.confirmed_kg for s in record.stages if s.confirmed_kg is not None]
    return Head(
        sequence=record.name,
        created=record.created,
        bench=bench_name(folder, record, benches),
        simulated=record.simulated,
        operators=tuple(record.operators),
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
    """Return the parameters of an identification; what is not a number becomes None."""
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
    """Return a result file; empty if it does not exist or, with a note, is damaged."""
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
    """Return the bench's name from the attached bench file, else the file's name."""
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
