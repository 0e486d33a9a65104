"""Exports recordings and raw traffic for other tools, and reads exported recordings back."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from identification.recording import Bench, Dataset, Recording, RecordingError
from rig.common.errors import InputError
from rig.common.places import write_text
from rig.common.provenance import sha256_file
from rig.runs.export import tables
from rig.runs.export.mcap_file import read_mcap, write_mcap
from rig.runs.export.tables import Read, describe, misfit, sidecar
from rig.runs.export.traffic import TRAFFIC, Count, export_traffic
from rig.runs.run_record import RunRecord

WRITERS: Mapping[str, Callable[[Dataset, Path], None]] = {
    "csv": tables.write_csv,
    "mat": tables.write_mat,
    "parquet": tables.write_parquet,
    "mcap": lambda dataset, path: write_mcap(dataset, path, None),
}
"""Writers of recordings by format."""
READERS: Mapping[str, Callable[[Path], list[Read] | None]] = {
    "csv": tables.read_csv,
    "mat": tables.read_mat,
    "parquet": tables.read_parquet,
    "mcap": read_mcap,
}
"""Readers of exported files by format; a reader returns None for a file of another program."""

FORMATS = (*WRITERS, *TRAFFIC)
"""Formats by name: first those of recordings, then those of raw traffic."""
__all__ = [
    "FORMATS",
    "TRAFFIC",
    "WRITERS",
    "Count",
    "beside",
    "export",
    "export_beside",
    "export_traffic",
    "extension",
    "files",
    "read_back",
    "with_ending",
]


def extension(kind: str) -> str:
    """Return the usual extension of a format's files, without a dot."""
    return TRAFFIC[kind][0] if kind in TRAFFIC else kind


def with_ending(path: Path, kind: str) -> Path:
    """Return the path of an export with the ending of its format, by which a campaign and other
    programs recognise it; an ending that is missing is added.

    Raises:
        InputError: The path has the ending of another format, or an unknown one.
    """
    ending = extension(kind)
    if not path.suffix:
        return path.with_name(f"{path.name}.{ending}")
    given = path.suffix[1:].lower()
    if given == ending:
        return path
    other = next((name for name in FORMATS if extension(name) == given), None)
    remedy = f"give --out {path}.{ending}" + (f", or --format {other}" if other else "")
    raise InputError(
        f"--out {path}: a file of format {kind} ends in .{ending}, not in {path.suffix}; {remedy}"
    )


def files(dataset: Dataset, path: Path, kind: str) -> dict[Path, Dataset]:
    """Return the files of an export, and the recordings in each file.

    A CSV file is one table with one time base, so that other tools and campaign files can use the
    file directly. Each of several recordings is written to its own file, whose name is ``path``
    plus the name of the recording.
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


def beside(path: Path, kind: str) -> Path | None:
    """Return the path of the description of an export, or None if the exported file contains the
    description.
    """
    return sidecar(path) if kind == "csv" else None


def export(
    dataset: Dataset, path: Path, kind: str, run: tuple[Path, RunRecord] | None = None
) -> None:
    """Write one file of :func:`files`.

    Args:
        dataset: The recordings.
        path: The file.
        kind: One of :data:`WRITERS`.
        run: Folder and record of the run of the recordings; an MCAP file also contains the events
            and frames of the run.

    Raises:
        InputError: Parquet is requested but not installed, or the run is damaged.
        OSError: The file cannot be written.
    """
    if kind == "mcap":
        write_mcap(dataset, path, run)
    else:
        WRITERS[kind](dataset, path)


def export_beside(dataset: Dataset, path: Path) -> None:
    """Write the description of an export beside the exported file.

    Raises:
        OSError: The description cannot be written.
    """
    write_text(path, describe(dataset.recordings))


def read_back(path: Path, kind: str, bench: Mapping[str, object]) -> list[Recording] | None:
    """Return the recordings of an export, or None if another program wrote the file.

    Args:
        path: The file.
        kind: Format of the file.
        bench: Constants that replace those of the file.

    Raises:
        InputError: The numbers in the file do not fit the description.
        OSError: The file cannot be read.
    """
    reader = READERS.get(kind)
    found = None if reader is None else reader(path)
    if found is None:
        return None
    digest = sha256_file(path)
    try:
        return [
            one.recording(channels, _with(one.bench, bench), str(path), digest)
            for one, channels in found
        ]
    except RecordingError as error:
        raise misfit(path, error) from error


def _with(bench: Bench, changed: Mapping[str, object]) -> Bench:
    return replace(bench, **changed) if changed else bench  # type: ignore[arg-type]
