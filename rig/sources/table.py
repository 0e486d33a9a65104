"""Interface of the readers of all formats: named columns, and the place of each row."""

from __future__ import annotations

import gzip
import importlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rig.common.errors import InputError
from rig.common.places import require_plain

Array = NDArray[np.float64]


class Column(NamedTuple):
    """A column of a recording file."""

    name: str  # empty for a column without a name
    source: Any  # what the reader of the format reads
    unit: str = ""  # unit as the file states it
    base: int = 0  # number of the time base
    # Factor and offset if the file stores value = factor x whole number + offset; columns of whole
    # numbers need none.
    scale: tuple[float, float] | None = None


class Table(ABC):
    """An opened recording file. Opening a file reads only the names of the columns.

    A reader may raise anything if its file is damaged; :func:`rig.sources.formats.open_table`
    returns tables whose errors name file and remedy.
    """

    path: Path
    # Column names in file order; an empty string for a column without a name.
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()
    # Units as the file states them, in column order; empty if the file states no units.
    units: tuple[str, ...] = ()
    # Number of the time base of each column, in column order; empty if all columns have the same
    # rows.
    bases: tuple[int, ...] = ()
    base_names: tuple[str, ...] = ()  # name of each time base, for messages
    base: int = 0  # time base whose rows `place` counts
    counts: Mapping[int, tuple[float, float]] = MappingProxyType({})  # scales by column
    # What the user can do about a damaged file.
    remedy: str = "check that the file was copied completely, or save it again"

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index, each of shape (n,); empty cells are NaN.

        The columns are of one time base.
        """
        bases = sorted({self.bases[k] for k in columns}) if self.bases else []
        if len(bases) > 1:
            names = ", ".join(self.base_names[base] for base in bases)
            raise InputError(
                f"{self.path}: columns of several time bases ({names}) share no rows; use "
                "columns of one time base"
            )
        with undamaged(self.path, self.remedy):
            return self._read(columns)

    def __init__(self, path: Path, options: Any = None) -> None:
        self.path = path

    def _lay_out(self, columns: Sequence[Column], base_names: Sequence[str] = ()) -> None:
        """Set the columns; ``base_names`` is empty if all of them have the same rows."""
        self._sources = [column.source for column in columns]
        self.names = tuple(column.name for column in columns)
        units = tuple(column.unit for column in columns)
        self.units = units if any(units) else ()
        self.base_names = tuple(base_names)
        self.bases = tuple(column.base for column in columns) if base_names else ()
        self.counts = {k: c.scale for k, c in enumerate(columns) if c.scale is not None}

    @abstractmethod
    def _read(self, columns: Sequence[int]) -> list[Array]: ...

    def place(self, row: int) -> str:
        """Return the place in the file of row ``row`` (from 0) of the result of :meth:`read`."""
        name = f"{self.base_names[self.base]} " if self.base_names else ""
        return f"{self.path}: {name}row {row + 1}"

    def stamps(self, base: int) -> Array | None:
        """Return the stamps of a time base on the file's clock, s, shape (n,), or None."""
        return None

    def note(self, text: str) -> None:
        """Add a message for the user; a repeated message is added once."""
        if text not in self.notes:
            self.notes = (*self.notes, text)

    def doubles(self, name: str, values: NDArray[Any], kind: str = "channel") -> Array:
        """Return a column as doubles, with a note on changes; InputError if not real numbers."""
        try:
            found, note = as_doubles(values)
        except NotNumbersError as error:
            raise InputError(
                f"{self.path}: {kind} {name!r} does not contain real numbers ({error})"
            ) from None
        if note:
            self.note(f"`{name}`: {note}")
        return found


@contextmanager
def undamaged(path: Path, remedy: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into an InputError that names the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise damaged(path, error, remedy) from error


def damaged(path: Path, error: Exception | str, remedy: str) -> InputError:
    """Return the error for a file that a library could not read, from the error of the library."""
    said = str(error).strip().splitlines()
    return InputError(
        f"{path}: cannot be read ({said[0] if said else type(error).__name__}); {remedy}"
    )


def open_binary(path: Path) -> IO[bytes]:
    """Open a file for reading; it is decompressed by gzip if its name ends in ``.gz``."""
    require_plain(path)
    zipped = path.suffix.lower() == ".gz"
    return cast("IO[bytes]", gzip.open(path, "rb")) if zipped else path.open("rb")


def format_of(path: Path) -> str:
    """Return the extension that determines the format, without a dot and without ``.gz``."""
    return (
        (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower().lstrip(".")
    )


EXACT = 2**53  # greatest integer up to which doubles represent every integer exactly
_LARGEST = 2**63 - 1
_UNIT_S = {"D": 86400.0, "h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}


def seconds_per(unit: str) -> float | None:
    """Return a unit of time, as files write it, in seconds; None for any other unit."""
    return _TIME_UNITS.get(unit.strip().lower())


class NotNumbersError(Exception):
    """The values are not real numbers; the message states their type."""


def as_doubles(values: NDArray[Any]) -> tuple[Array, str]:
    """Return values as doubles, and a note if the conversion changed them.

    Integers beyond 2^53 are read as differences to the first integer; dates and times are read as
    seconds since the first date or time; missing dates and times are NaN.
    """
    kind = values.dtype.kind
    if values.ndim != 1:
        raise NotNumbersError("bytes or a structure")
    if kind in "iu":
        if values.size and (int(values.max()) > EXACT or int(values.min()) < -EXACT):
            first = int(values[0])
            return _differences(values), (
                f"64-bit integers beyond 2^53: read as the difference to the first, {first}"
            )
        return np.ascontiguousarray(values, np.float64), ""
    if kind in "bf":
        # A float of another width may be a signalling NaN, whose conversion raises a warning.
        with np.errstate(invalid="ignore", over="ignore"):
            return np.ascontiguousarray(values, np.float64), ""
    if kind in "Mm":
        return _seconds(values)
    if values.dtype.names is not None and set(values.dtype.names) == {"real", "imag"}:
        raise NotNumbersError("complex numbers")
    words = {"c": "complex numbers", "S": "text", "U": "text", "O": "text or objects"}
    raise NotNumbersError(words.get(kind, f"of the type {values.dtype}"))


def _differences(values: NDArray[Any]) -> Array:
    first = int(values[0])
    if int(values.max()) - first > _LARGEST or first - int(values.min()) > _LARGEST:
        return np.array([float(int(value) - first) for value in values])
    differences = values - values[0]
    if values.dtype.kind == "u":
        differences = differences.view(differences.dtype.str.replace("u", "i"))
    return cast(Array, differences.astype(np.float64))


def _seconds(values: NDArray[Any]) -> tuple[Array, str]:
    unit, count = np.datetime_data(values.dtype)
    if unit not in _UNIT_S:
        raise NotNumbersError(f"times in units of {unit}")
    missing = np.isnat(values)
    known = values[~missing]
    first = known[0] if known.size else values.dtype.type(0, unit)
    dated = values.dtype.kind == "M"
    since = values - first if dated else values
    ticks = np.where(missing, 0, since.astype(np.int64)).astype(np.float64) * count
    scale = _UNIT_S[unit]
    seconds = ticks * scale if scale >= 1.0 else ticks / round(1.0 / scale)
    seconds[missing] = np.nan
    note = f"dates: read as seconds since {first}" if dated and known.size else ""
    return seconds, note


_MOST_WORDS = 200  # greatest length of a library's warning that is shown to the user, characters


def library(name: str, path: Path, format_name: str, extra: str) -> Any:
    """Import an optional library of a format; the InputError names the ``extra``."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.split(".")[0]
        raise InputError(
            f"{path}: reading {format_name} needs {package}; install it with: pip install "
            f"'loadrig[{extra}]'"
        ) from error


class _Heard(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.words: dict[str, int] = {}

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())[:_MOST_WORDS]
        self.words[text] = self.words.get(text, 0) + 1


@contextmanager
def heard(logger: str) -> Iterator[list[str]]:
    """Keep the warnings of a library from the terminal; the list contains them at the end."""
    log, handler, found = logging.getLogger(logger), _Heard(), list[str]()
    propagate, handlers = log.propagate, log.handlers
    # Some libraries install their own handlers, which print the warnings.
    log.propagate, log.handlers = False, [handler]
    try:
        yield found
    finally:
        log.propagate, log.handlers = propagate, handlers
        found += [text if n == 1 else f"{text} ({n} times)" for text, n in handler.words.items()]
