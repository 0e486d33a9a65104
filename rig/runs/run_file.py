"""Reads ``run.json`` and validates it: users may edit the file."""

from __future__ import annotations

import dataclasses
import functools
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from identification.model.gas_generator import GasGenerator, ValveGeometry
from identification.recording import Bench as BenchConstants
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import is_file, parse_json, read_utf8, write_text
from rig.common.provenance import sha256_file
from rig.common.timing import Timing
from rig.config.configuration import Loc, explain_json, place_json
from rig.runs.run_record import (
    BENCH_ATTACHMENT,
    RUN_FILE,
    SCHEMA,
    SEQUENCE_ATTACHMENT,
    STRICT,
    RunRecord,
)


@dataclass(frozen=True)
class _Constants(BenchConstants):
    """Constants of a bench that ``run.json`` must contain."""

    __pydantic_config__ = STRICT


_BENCH = {field.name for field in dataclasses.fields(BenchConstants)}
"""Constants that every record states."""
_MUST_HOLD = {
    "inputs": {"file", "sha256"},
    "calibrations": {"device", "id", "due", "overdue"},
    "weights": {"stage", "confirmed_kg", "measured_kg", "verdict", "message"},
    "devices": {"name", "serial_number", "revision", "software_version"},
    "timing": set(Timing().record()),
}
"""Required keys of records that are stored unchanged."""


@functools.cache
def _adapter(record: type[Any]) -> TypeAdapter[Any]:
    """Return the validator of a record; its creation takes longer than a validation."""
    return TypeAdapter(record)


def read_record(folder: Path) -> RunRecord:
    """Read ``run.json``."""
    path = folder / RUN_FILE
    text = read_utf8(path, "is this a run folder?")
    try:
        raw = parse_json(path, text)
    except InputError as error:
        raise InputError(f"{error}; `rig recover` rebuilds the file from the recording") from error
    if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
        found = raw.get("schema") if isinstance(raw, dict) else type(raw).__name__
        raise InputError(f"{path}: schema: this program reads {SCHEMA} (got {found!r})")
    try:
        record: RunRecord = _adapter(RunRecord).validate_json(json.dumps(raw), strict=True)
    except ValidationError as error:
        raise InputError(explain_json(path, text, RunRecord, error)) from None
    problems = list(_contradictions(record))
    if problems:
        raise InputError(place_json(path, text, problems))
    return record


def recorded_bench(record: RunRecord) -> BenchConstants:
    """Return the bench constants of a record that :func:`read_record` has read."""
    burns = record.bench["gas_generator"]
    rebuilt = (
        None
        if burns is None
        else GasGenerator(**{**burns, "valve": ValveGeometry(**burns["valve"])})
    )
    return BenchConstants(**{**record.bench, "gas_generator": rebuilt})


def _contradictions(record: RunRecord) -> Iterator[tuple[Loc, str]]:
    """Yield missing constants, and references to stages or recordings that do not exist."""
    missing = _BENCH - set(record.bench)
    for name in sorted(missing):
        yield ("bench", name), "missing; state every constant, because a default would not be safe"
    if not missing:
        try:
            _adapter(_Constants).validate_json(json.dumps(record.bench), strict=True)
        except ValidationError as error:
            for details in error.errors(include_url=False):
                yield ("bench", *details["loc"]), details["msg"]
    for name in {BENCH_ATTACHMENT: None, SEQUENCE_ATTACHMENT: None, **record.inputs}:
        yield from _lacking(record.inputs.get(name, {}), "inputs", ("inputs", name))
    for name in ("calibrations", "weights"):
        for index, item in enumerate(getattr(record, name)):
            yield from _lacking(item, name, (name, index))
    if not record.parts:
        yield ("parts",), "empty; a run has at least one recording"
    for index, part in enumerate(record.parts):
        if Path(part.file).name != part.file:
            yield ("parts", index, "file"), "must be a file of the run folder"
        for role, who in part.devices.items():
            if role in ("servo", "encoder"):
                yield from _lacking(who, "devices", ("parts", index, "devices", role))
        if part.timing:
            yield from _lacking(part.timing, "timing", ("parts", index, "timing"))
    last = 0
    for index, segment in enumerate(record.segments):
        if segment.index <= last:
            yield (
                ("segments", index, "index"),
                f"must be above {last}: segments are numbered in order, from 1",
            )
        last = max(last, segment.index)
        if not 0 <= segment.stage_index < len(record.stages):
            yield (
                ("segments", index, "stage_index"),
                f"there are {len(record.stages)} stages, numbered from 0",
            )
        elif segment.stage != record.stages[segment.stage_index].stage:
            yield ("segments", index, "stage"), "differs from the load condition of its stage"
        elif segment.kept and segment.weight_kg != record.stages[segment.stage_index].mass_kg:
            yield ("segments", index, "weight_kg"), "differs from the confirmed mass of its stage"
        if not 1 <= segment.part <= len(record.parts):
            yield (
                ("segments", index, "part"),
                f"there are {len(record.parts)} recordings, numbered from 1",
            )


def _lacking(item: Any, kind: str, loc: Loc) -> Iterator[tuple[Loc, str]]:
    """Yield the missing keys of a record that is stored unchanged."""
    if not isinstance(item, Mapping):
        yield loc, "must be a mapping"
        return
    for name in sorted(_MUST_HOLD[kind] - set(item)):
        yield (*loc, name), "missing; this key is required"


SEAL_FILE = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")


def seal(folder: Path, names: Iterable[str]) -> None:
    """Write the digests of these files; digests of other files in ``SHA256SUMS`` are kept."""
    path = folder / SEAL_FILE
    try:
        found = [_LINE.fullmatch(line) for line in read_utf8(path).splitlines()]
    except InputError:
        found = []
    # A damaged seal is replaced by the digests of the given files.
    sealed = {match[2]: match[1] for match in found if match} if all(found) else {}
    sealed |= {name: sha256_file(folder / name) for name in names if is_file(folder / name)}
    lines = (f"{digest}  {name}\n" for name, digest in sorted(sealed.items()))
    write_text(path, "".join(lines))


def seal_run(folder: Path, record: RunRecord) -> None:
    """Record the digests of a run's record and recordings at its end."""
    seal(folder, [RUN_FILE, *(part.file for part in record.parts)])


def partial_names(dataset: Dataset) -> list[str]:
    """Return the names of the recordings that were not finished."""
    return [recording.name for recording in dataset.recordings if recording.partial]


def partial_warnings(dataset: Dataset) -> tuple[str, ...]:
    """Return the warning on recordings that were not finished; empty if all were."""
    names = partial_names(dataset)
    if not names:
        return ()
    were = "was" if len(names) == 1 else "were"
    return (
        f"partial result: the run stopped before {', '.join(names)} {were} finished; the "
        "result does not use the motion that was not recorded, and with a shortened motion "
        "the intervals can be too narrow; `rig resume` finishes the run",
    )


def without_partial(dataset: Dataset) -> str:
    """Return the remedy of an error that an unfinished recording may cause."""
    finished = any(not recording.partial for recording in dataset.recordings)
    return (
        "; without --partial, only finished excitations are used"
        if partial_names(dataset) and finished
        else ""
    )
