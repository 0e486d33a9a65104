"""Writes recordings as tables: CSV, MATLAB, Parquet.

Channels keep their canonical names and SI units. A description beside the numbers, or inside the
file, contains the data for which a table has no column.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from identification.numerics.arrays import plain
from identification.recording import CHANNELS, Array, Dataset, Recording
from rig.common.errors import InputError

SCHEMA = "loadrig.export/1"
KEY = "loadrig"  # name of the description inside a file
_COPIED = (
    *("name", "bench", "stage", "weight_mass", "pendulum", "hoist", "constant_torque"),
    *("controller", "role", "partial", "start"),
)


def describe(recordings: Sequence[Recording]) -> str:
    """Return the description of an export."""
    return json.dumps({"schema": SCHEMA, "recordings": [_one(r) for r in recordings]}, indent=1)


def _one(recording: Recording) -> dict[str, Any]:
    return {
        "samples": len(recording.time),
        "channels": [name for name in CHANNELS if name in recording.channels],
        "averaged": sorted(recording.averaged),
        "uncertainties": dict(recording.uncertainties),
        **{name: plain(getattr(recording, name)) for name in _COPIED},
    }


def sidecar(path: Path) -> Path:
    """Return the path of the file beside a CSV file that contains the description."""
    return path.with_name(f"{path.name}.json")


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


def topics(names: Sequence[str]) -> list[str]:
    """Return the topic of each recording; equal topics are numbered."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "recording"
        topic = f"/recording/{plain}"
        found.append(f"{topic}_{len(found) + 1}" if topic in found else topic)
    return found
