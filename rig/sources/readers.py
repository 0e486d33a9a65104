"""Chooses the reader of a file by the extension of the file."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

from rig.config.campaign_sections import ReadSection
from rig.sources.formats.arrays import MatTable, NpyTable, NpzTable, ParquetTable
from rig.sources.formats.delimited import DelimitedTable
from rig.sources.formats.hdf5 import Hdf5Table, is_hdf5
from rig.sources.formats.json_file import JsonLinesTable, JsonTable
from rig.sources.formats.mcap_log import McapTable
from rig.sources.formats.mdf import MdfTable
from rig.sources.formats.table import Table, format_of
from rig.sources.formats.tdms import TdmsTable


def _can(path: Path, options: ReadSection) -> Table:
    # Imported here, because this reader needs the drivers, which other formats do not need.
    from rig.sources.can_traffic import CanTable

    return CanTable(path, options)


def _mdf(path: Path, options: ReadSection) -> Table:
    """Open the samples of a measurement or, if the meaning of its bus logging is given, the logged
    frames.
    """
    return _can(path, options) if options.dbc or options.bench else MdfTable(path, options)


FORMATS: Mapping[str, Callable[[Path, ReadSection], Table]] = {
    "csv": DelimitedTable,
    "tsv": DelimitedTable,
    "txt": DelimitedTable,
    "mat": lambda path, _: Hdf5Table(path) if _is_hdf5(path) else MatTable(path),
    "h5": lambda path, _: Hdf5Table(path),
    "hdf5": lambda path, _: Hdf5Table(path),
    "mcap": lambda path, _: McapTable(path),
    "log": _can,
    "asc": _can,
    "blf": _can,
    "trc": _can,
    "mf4": _mdf,
    "mdf": _mdf,
    "tdms": TdmsTable,
    "parquet": lambda path, _: ParquetTable(path),
    "npz": lambda path, _: NpzTable(path),
    "npy": lambda path, _: NpyTable(path),
    "json": JsonTable,
    "jsonl": lambda path, _: JsonLinesTable(path),
    "ndjson": lambda path, _: JsonLinesTable(path),
}
"""Readers by file extension, without dot and without ``.gz``."""
FOREIGN: Mapping[str, str] = {
    "bag": "a bag of ROS 1; convert it to MCAP with: mcap convert",
    "db3": "a bag of ROS 2; convert it to MCAP with: ros2 bag convert",
    "xlsx": "a workbook; save its sheet as CSV",
    "xls": "a workbook; save its sheet as CSV",
    "ods": "a workbook; save its sheet as CSV",
    "lvm": "a text file of LabVIEW; name it .txt, and skip its head with read.skip_rows",
    "dat": "an extension that several programs use; rename a text file to .csv, and an MDF "
    "file to .mdf",
    "pkl": "a pickle, which may run code when it is opened; save it as CSV, Parquet or npz",
    "feather": "an Arrow file; save it as Parquet",
    "nc": "netCDF; a file of version 4 is HDF5: rename it to .h5",
}
"""Kind of file and remedy for extensions of files that cannot be read."""


def unknown_format(path: Path) -> str:
    """Return the error for a file whose extension does not belong to a readable format."""
    words = FOREIGN.get(format_of(path))
    hint = f" ({words})" if words else ""
    return f"unknown format{hint}; readable are {', '.join(FORMATS)}"


def _is_hdf5(path: Path) -> bool:
    """Return whether a MATLAB file is of version 7.3. A file that cannot be opened counts as a file
    of another version; the reader of other versions then reports the error.
    """
    try:
        return is_hdf5(path)
    except (EOFError, zlib.error):
        return False


def open_table(path: Path, options: ReadSection) -> Table:
    """Open a recording file with the reader for its extension.

    Raises:
        InputError: The file is empty or damaged.
    """
    return FORMATS[format_of(path)](path, options)
