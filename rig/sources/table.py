"""Interface of the readers of all file formats: named columns of numbers, places of rows."""

from __future__ import annotations

import gzip
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import IO, cast

from drivers.plain_file import require_plain
from identification.recording import Array
from rig.common.errors import InputError


class Table(ABC):
    """An opened recording file. Opening reads only the names of the columns.

    Attributes:
        path: The file.
        names: Column names in file order; an empty string for a column without a name.
        notes: Messages to the user about the reading of the file.
        units: Units that the file states, in column order; empty for a column without a unit.
    """

    path: Path
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @abstractmethod
    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index, each of shape (n,); empty cells are NaN.

        Raises:
            InputError: A value is not a number, or the file is damaged; the message states file,
                row and column.
        """

    def place(self, row: int) -> str:
        """Return the place in the file of row ``row`` (from 0) of the result of :meth:`read`."""
        return f"{self.path}: row {row + 1}"


def open_binary(path: Path) -> IO[bytes]:
    """Open a file for reading; it is decompressed by gzip if its name ends in ``.gz``.

    Raises:
        OSError: The file cannot be opened.
    """
    require_plain(path)
    return cast("IO[bytes]", gzip.open(path, "rb")) if path.suffix == ".gz" else path.open("rb")


def format_of(path: Path) -> str:
    """Return the extension that determines the format, without a dot and without ``.gz``."""
    return (
        (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower().lstrip(".")
    )


def damaged(path: Path, error: Exception, remedy: str) -> InputError:
    """Return the message for a file that a library could not read, from the library's error."""
    said = str(error).strip().splitlines()
    return InputError(
        f"{path}: cannot be read ({said[0] if said else type(error).__name__}); {remedy}"
    )
