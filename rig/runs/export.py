"""Recordings for other tools: CSV, MATLAB, Parquet.

Channels keep their canonical names and SI units.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from identification.recording import CHANNELS, Array, Dataset, Recording
from rig.common.errors import InputError


def files(dataset: Dataset, path: Path, kind: str) -> dict[Path, Dataset]:
    """Return the files of an export, and the recordings in each.

    A CSV file is one table with one time base, so that other tools and campaign files can use it
    directly. Of several recordings, each gets its own file, named ``path`` plus the recording's
    name.
    """
    if kind != "csv" or len(dataset.recordings) == 1:
        return {path: dataset}
    found: dict[Path, Dataset] = {}
    for recording in dataset.recordings:
        name = re.sub(r"[^\w.-]+", "-", recording.name).strip("-")
        place = path.with_name(f"{path.stem}-{name}{path.suffix}")
        if place in found:
            place = path.with_name(f"{path.stem}-{name}-{len(found) + 1}{path.suffix}")
        found[place] = Dataset((recording,))
    return found


def export(dataset: Dataset, path: Path, kind: str) -> None:
    """Write one file of :func:`files`.

    Raises:
        InputError: Parquet is requested but not installed.
        OSError: The file cannot be written.
    """
    WRITERS[kind](dataset, path)


def _columns(dataset: Dataset) -> tuple[list[str], dict[str, Array]]:
    """Stack all recordings: the recording's name for every row, and the channels, NaN where one has
    none.
    """
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


def _write_csv(dataset: Dataset, path: Path) -> None:
    """Write the only recording as a table, one column a channel.

    A missing value is an empty cell.
    """
    (recording,) = dataset.recordings
    columns = {name: recording.channels[name] for name in CHANNELS if name in recording.channels}
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        for values in zip(*(column.tolist() for column in columns.values()), strict=True):
            writer.writerow(["" if value != value else value for value in values])


def _write_mat(dataset: Dataset, path: Path) -> None:
    """Write a struct array ``recordings`` (name, stage, weight_mass, role, one field a channel) and
    ``units``.
    """
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
    content = {"recordings": recordings, "units": units}
    savemat(str(path), content, appendmat=False, oned_as="column", do_compression=True)


def _write_parquet(dataset: Dataset, path: Path) -> None:
    """Write one table; each column carries its unit as metadata."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise InputError(
            "parquet needs pyarrow, which is not installed; pip install 'loadrig[parquet]'"
        ) from error
    names, columns = _columns(dataset)
    fields = [pa.field("recording", pa.dictionary(pa.int32(), pa.string()))]
    fields += [pa.field(name, pa.float64(), metadata={"unit": CHANNELS[name]}) for name in columns]
    arrays = [
        pa.array(names).dictionary_encode(),
        *(pa.array(column) for column in columns.values()),
    ]
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path)


WRITERS: Mapping[str, Callable[[Dataset, Path], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}
