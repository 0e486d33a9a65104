"""Interface of every reader: named columns of numbers, and the place of a row in the file."""

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
    """An opened recording file. Opening reads the names only.

    Attributes:
        path: The file.
        names: Column names in file order; an empty string for a column without a name.
        notes: Messages to the user about the reading.
        units: Units as the file states them, in column order; empty where it states none.
    """

    path: Path
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @abstractmethod
    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index, each of shape (n,); empty cells are NaN.

        Raises:
            InputError: A value is not a number, or the file is damaged; names file, row and column.
        """

    def place(self, row: int) -> str:
        """Return the place in the file of row ``row`` (from 0) of the result of :meth:`read`."""
        return f"{self.path}: row {row + 1}"


def open_binary(path: Path) -> IO[bytes]:
    """Open a plain file for reading, through gzip where its name ends in ``.gz``.

    Raises:
        OSError: It cannot be opened.
    """
    require_plain(path)
    return cast("IO[bytes]", gzip.open(path, "rb")) if path.suffix == ".gz" else path.open("rb")


def format_of(path: Path) -> str:
    """Return the extension that names the format, without a dot and without ``.gz``."""
    return (
        (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower().lstrip(".")
    )


def damaged(path: Path, error: Exception, remedy: str) -> InputError:
    """Return a message from a library's error on a file that it could not read."""
    said = str(error).strip().splitlines()
    return InputError(
        f"{path}: cannot be read ({said[0] if said else type(error).__name__}); {remedy}"
    )
