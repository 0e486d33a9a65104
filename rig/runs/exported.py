"""Writes recordings as tables (CSV, MATLAB, Parquet), and reads exported files back.

Channels keep their canonical names and SI units. A description beside the numbers, or inside the
file, contains the data for which a table has no column.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from identification.recording import (
    CHANNELS,
    Array,
    Bench,
    Controller,
    Dataset,
    Hoist,
    Pendulum,
    Recording,
    RecordingError,
)
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.provenance import sha256_file

SCHEMA = "loadrig.export/1"
KEY = "loadrig"  # name of the description inside a file
_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
Read = tuple["Described", Mapping[str, Array]]
"""Result of a reader for each recording: its description and its channels."""


class Described(BaseModel):
    """A recording without its samples; the fields are those of
    :class:`identification.recording.Recording`.

    Attributes:
        samples: Number of samples.
        channels: Names of the channels of this recording; a table may have further channels, which
            belong to other recordings.
    """

    model_config = _STRICT

    name: str
    samples: Annotated[int, Field(ge=2)]
    channels: tuple[str, ...]
    bench: Bench
    stage: Literal["unloaded", "loaded"]
    weight_mass: float
    pendulum: Pendulum | None
    hoist: Hoist | None
    constant_torque: float
    controller: Controller | None
    role: Literal["fit", "validate"]
    averaged: tuple[str, ...]
    partial: bool
    start: float | None
    uncertainties: dict[str, float]

    def recording(
        self, channels: Mapping[str, Array], bench: Bench, source: str, sha256: str
    ) -> Recording:
        """Return the recording."""
        kept = {name: getattr(self, name) for name in _COPIED}
        return Recording(
            channels=channels,
            bench=bench,
            averaged=frozenset(self.averaged),
            source=source,
            sha256=sha256,
            notes=("stage, load and constants are taken from the exported file",),
            **kept,
        )


_COPIED = Described.model_fields.keys() - {"samples", "channels", "bench", "averaged"}


class _Description(BaseModel):
    model_config = ConfigDict(extra="forbid")

    schema_: Literal["loadrig.export/1"] = Field(alias="schema")
    recordings: Annotated[tuple[Described, ...], Field(min_length=1)]


def describe(recordings: Sequence[Recording]) -> str:
    """Return the description of an export."""
    return json.dumps({"schema": SCHEMA, "recordings": [_one(r) for r in recordings]}, indent=1)


def _one(recording: Recording) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "samples": len(recording.time),
        "channels": [name for name in CHANNELS if name in recording.channels],
        "averaged": sorted(recording.averaged),
        "uncertainties": dict(recording.uncertainties),
    }
    for name in Described.model_fields:
        if name not in plain:
            value = getattr(recording, name)
            plain[name] = dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value  # type: ignore[arg-type]
    return plain


def parse(text: str | bytes, path: Path) -> tuple[Described, ...]:
    """Read a description."""
    try:
        return _Description.model_validate_json(text).recordings
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{path}: the description of this export cannot be read ({place}: {first['msg']}); "
            "export the recordings again"
        ) from error


def sidecar(path: Path) -> Path:
    """Return the path of the file beside a CSV file that contains the description."""
    return path.with_name(f"{path.name}.json")


def _misfit(path: Path, error: RecordingError | str) -> InputError:
    """Return the error for a file whose numbers contradict its description."""
    return InputError(
        f"{path}: the numbers contradict the description of this export ({error}); export the "
        "recordings again"
    )


def _columns(dataset: Dataset) -> tuple[list[str], dict[str, Array]]:
    """Stack all recordings: name of the recording for every row, and channels or NaN."""
    present = {name for recording in dataset.recordings for name in recording.channels}
    names = [recording.name for recording in dataset.recordings for _ in range(len(recording.time))]
    stacked = {
        name: np.concatenate([_channel(recording, name) for recording in dataset.recordings])
        for name in CHANNELS
        if name in present
    }
    return names, stacked


def _channel(recording: Recording, name: str) -> Array:
    return recording.channels.get(name, np.full(len(recording.time), np.nan))


def write_csv(dataset: Dataset, path: Path) -> None:
    """Write the only recording of a dataset as a table with one column per channel.

    A missing value is an empty cell. The description goes into a file beside the CSV file; this
    function does not write the description.
    """
    (recording,) = dataset.recordings
    columns = {name: recording.channels[name] for name in CHANNELS if name in recording.channels}
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for values in zip(*(column.tolist() for column in columns.values()), strict=True):
            writer.writerow(["" if value != value else value for value in values])


def write_mat(dataset: Dataset, path: Path) -> None:
    """Write a struct array ``recordings``, one field per channel, and ``units``."""
    from scipy.io import savemat

    present = [name for name in CHANNELS if any(name in r.channels for r in dataset.recordings)]
    fields = ("name", "stage", "weight_mass", "role", *present)
    recordings = np.empty(len(dataset.recordings), dtype=[(field, object) for field in fields])
    for index, r in enumerate(dataset.recordings):
        recordings[index] = (
            r.name,
            r.stage,
            r.weight_mass,
            r.role,
            *(_channel(r, name) for name in present),
        )
    units = {name: CHANNELS[name] for name in present}
    content = {"recordings": recordings, "units": units, KEY: describe(dataset.recordings)}
    savemat(str(path), content, appendmat=False, oned_as="column", do_compression=True)


def write_parquet(dataset: Dataset, path: Path) -> None:
    """Write one table; the metadata of each column contain the unit."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise InputError(
            "parquet needs pyarrow, which is not installed; install it with: pip install "
            "'loadrig[parquet]'"
        ) from error
    names, columns = _columns(dataset)
    fields = [pa.field("recording", pa.dictionary(pa.int32(), pa.string()))]
    fields += [pa.field(name, pa.float64(), metadata={"unit": CHANNELS[name]}) for name in columns]
    arrays = [
        pa.array(names).dictionary_encode(),
        *(pa.array(column) for column in columns.values()),
    ]
    schema = pa.schema(fields, metadata={KEY: describe(dataset.recordings)})
    pq.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


def _read_csv(path: Path) -> list[Read] | None:
    """Read a CSV file back; return None if there is no description beside the file."""
    beside = sidecar(path)
    if not is_file(beside):
        return None
    described = parse(beside.read_bytes(), beside)
    with open(path, newline="", encoding="utf-8") as stream:
        rows = csv.reader(stream)
        names = next(rows, [])
        try:
            table = [[float(cell) if cell else np.nan for cell in row] for row in rows]
            columns = np.array(table, dtype=np.float64).reshape(len(table), len(names))
        except ValueError as error:
            raise _misfit(path, str(error)) from error
    return _split(path, described, dict(zip(names, columns.T, strict=True)))


def _read_mat(path: Path) -> list[Read] | None:
    """Read a MATLAB file back; return None if it holds no description."""
    from scipy.io import loadmat

    try:
        content = loadmat(str(path), appendmat=False, variable_names=[KEY, "recordings"])
    except Exception:  # noqa: BLE001 - scipy raises anything on a damaged file
        return None  # the reader of other MATLAB files reports the error
    if KEY not in content or "recordings" not in content:
        return None
    described = parse(str(content[KEY].ravel()[0]), path)
    structs = content["recordings"].ravel()
    if len(structs) != len(described):
        raise _misfit(
            path,
            f"the file contains {len(structs)} recordings, its description states {len(described)}",
        )
    try:
        return [
            (one, {name: np.array(struct[name]).ravel() for name in one.channels})
            for one, struct in zip(described, structs, strict=True)
        ]
    except ValueError as error:
        raise _misfit(path, str(error)) from error


def _read_parquet(path: Path) -> list[Read] | None:
    """Read a Parquet file back; return None if it holds no description."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        return None  # the reader of other Parquet files names the missing package
    try:
        schema = pq.read_schema(path)
        text = (schema.metadata or {}).get(KEY.encode())
        if text is None:
            return None
        described = parse(text, path)
        table = pq.read_table(path)
    except pa.ArrowException:
        return None
    names = [name for name in table.column_names if name in CHANNELS]
    return _split(path, described, {name: table.column(name).to_numpy() for name in names})


def topics(names: Sequence[str]) -> list[str]:
    """Return the topic of each recording; equal topics are numbered."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "recording"
        topic = f"/recording/{plain}"
        found.append(f"{topic}_{len(found) + 1}" if topic in found else topic)
    return found


_CDR_HEAD = 4  # number of bytes before the first field of a message


def _read_mcap(path: Path) -> list[Read] | None:
    """Read the recordings back. The result is None if the file contains no description."""
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            texts = [item.metadata for item in reader.iter_metadata() if item.name == KEY]
            if not texts or "description" not in texts[0]:
                return None
            described = parse(texts[0]["description"], path)
            rows: dict[str, list[bytes]] = {
                topic: [] for topic in topics([one.name for one in described])
            }
            for _, channel, message in reader.iter_messages(rows, log_time_order=False):
                rows[channel.topic].append(message.data[_CDR_HEAD:])
    except (McapError, ValueError, EOFError, RuntimeError):
        return None  # the reader of other MCAP files reports the error
    found: list[Read] = []
    for one, data in zip(described, rows.values(), strict=True):
        width = len(one.channels)
        values = np.frombuffer(b"".join(data), "<f8")
        if len(data) != one.samples or values.size != one.samples * width:
            raise _misfit(
                path,
                f"{one.name}: the file contains {len(data)} samples, its description states "
                f"{one.samples}",
            )
        columns = values.reshape(one.samples, width).T
        found.append(
            (one, {n: np.array(c, float) for n, c in zip(one.channels, columns, strict=True)})
        )
    return found


def _split(path: Path, described: tuple[Described, ...], columns: dict[str, Any]) -> list[Read]:
    """Split stacked columns into recordings."""
    rows = len(next(iter(columns.values()), ()))
    expected = sum(one.samples for one in described)
    missing = {name for one in described for name in one.channels} - columns.keys()
    if rows != expected or missing:
        lacks = f"; no column {', '.join(sorted(missing))}" if missing else ""
        raise _misfit(
            path, f"the file contains {rows} rows, its description states {expected}{lacks}"
        )
    found: list[Read] = []
    start = 0
    for one in described:
        stop = start + one.samples
        found.append((one, {name: np.array(columns[name][start:stop]) for name in one.channels}))
        start = stop
    return found


READERS: Mapping[str, Callable[[Path], list[Read] | None]] = {
    "csv": _read_csv,
    "mat": _read_mat,
    "parquet": _read_parquet,
    "mcap": _read_mcap,
}
"""Readers of exported files by format; a reader returns None for a file of another program."""


def read_back(path: Path, kind: str, bench: Mapping[str, Any]) -> list[Recording] | None:
    """Return the recordings of an export, or None if another program wrote the file.

    Raises:
        OSError: The file cannot be read.
    """
    reader = READERS.get(kind)
    found = None if reader is None else reader(path)
    if found is None:
        return None
    digest = sha256_file(path)
    try:
        return [
            one.recording(channels, replace(one.bench, **bench), str(path), digest)
            for one, channels in found
        ]
    except RecordingError as error:
        raise _misfit(path, error) from error
