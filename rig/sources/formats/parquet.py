"""Reads Parquet files, with the optional library pyarrow."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.table import Table, damaged, open_binary


class ParquetTable(Table):
    """A Parquet file as a table; time stamps are read as seconds since the first stamp.

    Raises:
        InputError: pyarrow is not installed, or the file is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._arrow: Any = importlib.import_module("pyarrow")
            parquet: Any = importlib.import_module("pyarrow.parquet")
        except ImportError as error:
            raise InputError(
                f"{path}: reading Parquet needs pyarrow; install it with: pip install "
                f"loadrig[parquet]"
            ) from error
        self._parquet = parquet
        try:
            with open_binary(path) as stream:
                self.names = tuple(parquet.read_schema(stream).names)
        except (self._arrow.ArrowException, OSError, EOFError) as error:
            raise damaged(path, error, "check that the file was copied completely") from error

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        names = [self.names[k] for k in columns]
        try:
            with open_binary(self.path) as stream:
                table = self._parquet.read_table(stream, columns=names)
        except (self._arrow.ArrowException, OSError, EOFError) as error:
            raise damaged(self.path, error, "check that the file was copied completely") from error
        return [self._numbers(name, table.column(name)) for name in names]

    def _numbers(self, name: str, column: Any) -> Array:
        arrow, types = self._arrow, self._arrow.types
        try:
            if types.is_timestamp(column.type):
                ticks = column.cast(arrow.timestamp("ns")).cast(arrow.int64())
                return _differences(ticks) / 1e9
            if types.is_duration(column.type):
                return _differences(column.cast(arrow.duration("ns")).cast(arrow.int64())) / 1e9
            if types.is_integer(column.type) and _exceeds_doubles(column):
                self.notes = (
                    *self.notes,
                    f"column {name!r} holds 64-bit integers beyond 2^53: read as the difference to "
                    f"the first, {_first(column)}",
                )
                return _differences(column)
            if types.is_boolean(column.type):
                column = column.cast(arrow.int8())
            values = column.cast(arrow.float64()).to_numpy()
        except arrow.ArrowException as error:
            raise InputError(
                f"{self.path}: column {name!r} does not contain numbers (type {column.type})"
            ) from error
        return np.asarray(values, dtype=np.float64)


EXACT = 2**53
"""Greatest integer up to which doubles represent every integer exactly."""


def _first(column: Any) -> int:
    """Return the first value that is not missing; 0 if all values are missing."""
    known = column.drop_null()
    return int(known[0].as_py()) if len(known) else 0


def _exceeds_doubles(column: Any) -> bool:
    known = column.drop_null().to_numpy()
    return bool(known.size) and (int(known.max()) > EXACT or int(known.min()) < -EXACT)


def _differences(column: Any) -> Array:
    """Return integers minus the first integer, exact if a double represents the difference."""
    first = _first(column)
    missing = column.is_null().to_numpy()
    whole = column.fill_null(first).to_numpy()
    differences = whole - whole.dtype.type(first)
    if whole.dtype.kind == "u":
        differences = differences.view(np.int64)
    return cast(Array, np.where(missing, np.nan, differences.astype(np.float64)))
