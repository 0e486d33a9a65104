"""Chooses the reader of a file by the extension of the file."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rig.sources.served import ServedTable
from rig.sources.table import Table, format_of, open_binary, undamaged

if TYPE_CHECKING:
    from rig.config.campaign_sections import ReadSection

FORMATS: Mapping[str, str] = {
    "csv": "text:DelimitedTable",
    "tsv": "text:DelimitedTable",
    "txt": "text:DelimitedTable",
    "mat": "arrays:MatTable",
    "h5": "arrays:Hdf5Table",
    "hdf5": "arrays:Hdf5Table",
    "mcap": "mcap_log:McapTable",
    "log": "can_traffic:CanTable",
    "asc": "can_traffic:CanTable",
    "blf": "can_traffic:CanTable",
    "trc": "can_traffic:CanTable",
    "mf4": "measurement:MdfTable",
    "mdf": "measurement:MdfTable",
    "tdms": "measurement:TdmsTable",
    "parquet": "arrays:ParquetTable",
    "npz": "arrays:NpzTable",
    "npy": "arrays:NpyTable",
    "json": "text:JsonTable",
    "jsonl": "text:JsonLinesTable",
    "ndjson": "text:JsonLinesTable",
}
"""Module and class of the reader by file extension, without dot and without ``.gz``."""
SERVED = frozenset({"mat", "h5", "hdf5", "mf4", "mdf", "tdms", "parquet"})
"""Formats whose libraries may end the process, or ask for all of its memory, on a damaged file."""
_HDF5 = b"\x89HDF\r\n\x1a\n"
"""Signature of an HDF5 file, which follows a user block of 0, 512, 1024, ... bytes."""
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


def open_table(path: Path, options: ReadSection) -> Table:
    """Open a recording file with the reader for its extension."""
    open_binary(path).close()
    if format_of(path) in SERVED:
        return ServedTable(path, options.model_dump(exclude_defaults=True, mode="json"))
    return open_here(path, options)


def open_here(path: Path, options: ReadSection | None) -> Table:
    """Open a recording file in this process; None stands for the usual options."""
    with undamaged(path, Table.remedy):
        module, name = FORMATS[format_of(path)].split(":")
        if name == "MatTable" and _is_hdf5(path):
            name = "Hdf5Table"
        if name == "MdfTable" and options is not None and options.dbc:
            # The meaning of the logged frames is given.
            module, name = "can_traffic", "CanTable"
        reader: type[Table] = getattr(importlib.import_module(f"rig.sources.{module}"), name)
        with undamaged(path, reader.remedy):
            return reader(path, options)


def _is_hdf5(path: Path) -> bool:
    """Return whether a MATLAB file is of version 7.3, by its first bytes."""
    with open_binary(path) as stream:
        head = stream.read(2048 + len(_HDF5))
    return any(head[at : at + len(_HDF5)] == _HDF5 for at in (0, 512, 1024, 2048))
