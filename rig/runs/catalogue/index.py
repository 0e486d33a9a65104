"""Keeps an index of run folders in SQLite; the index can be deleted at any time.

Each row holds the entry of one folder as JSON, the signature of the files from which the entry was
made, and a checksum. A row is used only if its signature agrees with the present files and its
checksum is right; all other folders are read again. Therefore a deleted, damaged or older index
does not change the answers.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.places import is_file, read_json
from rig.common.provenance import IDENTIFY_SCHEMA, sha256_file
from rig.common.yaml_tree import DocumentError, parse
from rig.runs.catalogue.entry import Constant, Details, Entry, Head
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.run_file import read_record
from rig.runs.run_record import BENCH_ATTACHMENT, SCHEMA, RunRecord

RUN_JSON, RECORDING = "run.json", "recording.mcap"
COMMISSION_JSON = "commission.json"
RESULTS = ("identify.json", "diagnosis/diagnose.json", "acceptance.json")
"""Result files of a run folder whose verdicts are listed."""
MOST_DEEP = 8
"""Number of folder levels below the searched folder that are searched for runs."""


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


INDEX_FILE = ".runs.sqlite"
"""Name of the index in the searched folder."""
_FORMAT = 3
"""Format number of the entries, which is increased when the content of entries changes, so that
older rows are not used.
"""
_TABLE = (
    "CREATE TABLE IF NOT EXISTS runs (folder TEXT PRIMARY KEY, signature TEXT NOT NULL, "
    "head TEXT NOT NULL, details TEXT NOT NULL, checksum INTEGER NOT NULL)"
)
_WAIT_S = 5.0
"""Time to wait for another program that writes the index, s."""


_NOT_DAMAGED = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
    }
)
"""Errors after which the index is kept, because it is intact but cannot be written now; after other
errors the index is created again.
"""


class _Row(NamedTuple):
    """A row of the index, in the order of its columns."""

    folder: str
    signature: str
    head: str
    details: str
    checksum: int

    @classmethod
    def of(cls, folder: str, signature: str, head: Head, details: Details) -> _Row:
        """Return the row of a run folder."""
        first, second = (json.dumps(dataclasses.asdict(part)) for part in (head, details))
        fields = (folder, signature, first, second)
        return cls(*fields, _checksum(fields))

    @property
    def sound(self) -> bool:
        """Whether the row is unchanged since it was written."""
        return self.checksum == _checksum(self[:4])

    @property
    def entry(self) -> Entry:
        """The entry of the run folder."""
        return Entry(self.folder, Head.of(json.loads(self.head)), self.details)


def _checksum(fields: Iterable[str]) -> int:
    return zlib.crc32("\0".join(fields).encode("utf-8", "surrogateescape"))


class Listing(NamedTuple):
    """Result of a search for the runs below a folder."""

    entries: list[Entry]
    read: int
    note: str


def list_runs(root: Path, progress: Callable[[int, int], None] | None = None) -> Listing:
    """Return the runs in and below a folder, from the index if the index is current.

    Raises:
        InputError: The folder cannot be searched.
    """
    try:
        found = list(find_runs(root))
    except OSError as error:
        raise InputError(f"{root}: cannot be searched: {error.strerror}") from error
    file = root / INDEX_FILE
    rows = _load(file)
    kept: list[_Row] = []
    fresh: list[Found] = []
    for each in found:
        row = rows.get(each.folder)
        if row is not None and row.signature == each.signature and row.sound:
            kept.append(row)
        else:
            fresh.append(each)
    made: list[_Row] = []
    benches: dict[str, str] = {}
    for each in fresh:
        made.append(_read(root, each, benches))
        if progress is not None:
            progress(len(made), len(fresh))
    entries = [row.entry for row in (*kept, *made)]
    entries.sort(key=lambda entry: (entry.head.created, entry.folder))
    gone = rows.keys() - {each.folder for each in found}
    is_run = any(each.folder == "." for each in found)
    note = "" if is_run or not (made or gone) else _store(root, file, made, gone)
    return Listing(entries, len(made), note)


def _read(root: Path, found: Found, benches: Benches) -> _Row:
    if found.signature.startswith("unreadable"):
        problem = f"{root / found.folder}: no permission to read"
        return _Row.of(*found, Head("unreadable", problem), Details())
    return _Row.of(*found, *_read_entry(root / found.folder, benches))


def _load(file: Path) -> Mapping[str, _Row]:
    """Return the rows of an index by folder; empty if it cannot be used."""
    if not os.path.isfile(file):
        return {}
    try:
        with contextlib.closing(_open(file)) as database:
            if database.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
                return {}
            columns = ", ".join(_Row._fields)
            return {row[0]: _Row(*row) for row in database.execute(f"SELECT {columns} FROM runs")}
    except (sqlite3.Error, UnicodeError, TypeError):
        return {}


def _open(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(file, timeout=_WAIT_S, isolation_level=None)


def _store(root: Path, file: Path, made: list[_Row], gone: Iterable[str]) -> str:
    """Update the index with rows whose files are unchanged; return why that failed."""
    kept = [row for row in made if signature_of(str(root / row.folder)) == row.signature]
    for again in (False, True):
        try:
            with contextlib.closing(_open(file)) as database:
                _write(database, kept, gone)
            return ""
        except (sqlite3.Error, UnicodeError) as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
            if again or code in _NOT_DAMAGED:
                return (
                    f"{file}: the index cannot be written ({error}); each list therefore "
                    "reads all runs again"
                )
        with contextlib.suppress(OSError):
            file.unlink()
    return ""


def _write(database: sqlite3.Connection, made: Iterable[_Row], gone: Iterable[str]) -> None:
    database.execute("BEGIN IMMEDIATE")
    if database.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
        database.execute("DROP TABLE IF EXISTS runs")
        database.execute(f"PRAGMA user_version = {_FORMAT}")
    database.execute(_TABLE)
    database.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?)", made)
    database.executemany("DELETE FROM runs WHERE folder = ?", [(folder,) for folder in gone])
    database.execute("COMMIT")


IDENTIFY, DIAGNOSE, ACCEPTANCE = RESULTS
ROLES = ("servo", "encoder", "pressure")
"""Roles of the devices of a bench."""
_DIAGNOSE_SCHEMA, _ACCEPTANCE_SCHEMA = "loadrig.diagnose/1", "loadrig.acceptance/1"
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
