"""Interface of the readers of all file formats: named columns of numbers, and the place of each row
in the file.
"""

from __future__ import annotations

import gzip
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, cast

from drivers.plain_file import require_plain
from identification.recording import Array
from rig.common.errors import InputError


class Table(ABC):
    """An opened recording file. Opening a file reads only the names of the columns.

    Attributes:
        path: The file.
        names: Column names in file order; an empty string for a column without a name.
        notes: Messages to the user about the reading.
        units: Units as the file states them, in column order; empty if the file states no units.
        bases: Number of the time base of each column, in column order; empty if all columns have
            the same rows.
        base_names: Name of each time base, for messages.
        base: Time base whose rows :meth:`place` counts.
        counts: Factor and offset of the columns that the file stores as value = factor x whole
            number + offset, by column; columns of whole numbers need no entry.
    """

    path: Path
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    bases: tuple[int, ...] = ()
    base_names: tuple[str, ...] = ()
    base: int = 0
    counts: Mapping[int, tuple[float, float]] = MappingProxyType({})

    @abstractmethod
    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index, each of shape (n,); empty cells are NaN.

        The columns are of one time base.

        Raises:
            InputError: A value is not a number, or the file is damaged; the message states file,
                row and column.
        """

    def place(self, row: int) -> str:
        """Return the place in the file of row ``row`` (from 0) of the result of :meth:`read`."""
        name = f"{self.base_names[self.base]} " if self.base_names else ""
        return f"{self.path}: {name}row {row + 1}"

    def stamps(self, base: int) -> Array | None:
        """Return the time stamps of the rows of a time base, s, on one clock for the whole file,
        shape (n,).

        Returns:
            None if the file has no clock that all its time bases share.
        """
        return None

    def require_one_base(self, columns: Sequence[int]) -> None:
        """Refuse columns that have no common rows.

        Raises:
            InputError: The columns have several time bases.
        """
        bases = sorted({self.bases[k] for k in columns})
        if len(bases) > 1:
            names = ", ".join(self.base_names[base] for base in bases)
            raise InputError(
                f"{self.path}: columns of several time bases ({names}) share no rows; use "
                "columns of one time base"
            )

    def note(self, text: str) -> None:
        """Add a message for the user; a repeated message is added once."""
        if text not in self.notes:
            self.notes = (*self.notes, text)


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
    """Return the error for a file that a library could not read, from the error of the library."""
    said = str(error).strip().splitlines()
    return InputError(
        f"{path}: cannot be read ({said[0] if said else type(error).__name__}); {remedy}"
    )
