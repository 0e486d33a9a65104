"""Parquet files, through the optional pyarrow."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.table import Table, damaged, open_binary


class ParquetTable(Table):
    """A Parquet file; time stamps are read as seconds since the first.

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
            raise damaged(path, error, "check that it was copied whole") from error

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        names = [self.names[k] for k in columns]
        try:
            with open_binary(self.path) as stream:
                table = self._parquet.read_table(stream, columns=names)
        except (self._arrow.ArrowException, OSError, EOFError) as error:
            raise damaged(self.path, error, "check that it was copied whole") from error
        return [self._numbers(name, table.column(name)) for name in names]

    def _numbers(self, name: str, column: Any) -> Array:
        arrow = self._arrow
        try:
            if arrow.types.is_timestamp(column.type):
                ticks = column.cast(arrow.timestamp("ns")).cast(arrow.int64()).to_numpy()
                return cast(Array, (ticks - ticks[0]) * 1e-9)
            values = column.cast(arrow.float64()).to_numpy()
        except arrow.ArrowException as error:
            raise InputError(
                f"{self.path}: column {name!r} is not numbers (type {column.type})"
            ) from error
        return np.asarray(values, dtype=np.float64)
