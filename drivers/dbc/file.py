"""Reads the messages of a DBC file, and the signals of each message with their bit positions.

No other module uses the library ``cantools``.
"""

from __future__ import annotations

import codecs
import difflib
import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import cantools.database
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal as FileSignal
from cantools.database.errors import Error as DbcError

from drivers.can.port import EXTENDED_FLAG
from drivers.dbc.codec import Signal, motorola_shift
from drivers.errors import ConfigurationError

_MARKS: Final = (
    (codecs.BOM_UTF8, ("utf-8",)),
    (codecs.BOM_UTF16_LE, ("utf-16",)),
    (codecs.BOM_UTF16_BE, ("utf-16",)),
)
"""Byte order marks with the encoding that belongs to each."""
_ENCODINGS: Final = ("utf-8", "cp1252", "cp932", "gb18030", "big5")
"""Encodings that are tried, in this order, if a file has no byte order mark."""
_ODD: Final = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors that ``cantools`` raises for files with correct syntax and wrong references."""
_TWICE: Final = "is defined twice in the DBC; remove one"
_PLACE: Final = re.compile(r"line (\d+), column (\d+)")


@dataclass(frozen=True)
class Layout:
    """One message of a DBC."""

    name: str
    identifier: int  # CAN identifier; bit 31 is set if the identifier has 29 bits
    size: int  # number of bytes
    # Cycle time in the DBC (`GenMsgCycleTime`), s, or None if the DBC has none.
    period_s: float | None
    signals: Mapping[str, Signal]
    obstacle: str = ""  # reason why the message cannot be used; empty if it can be used


def load_dbc(path: Path) -> tuple[Database, dict[int, str]]:
    """Read a DBC file.

    Signals that overlap, or that do not fit into their message, are faults of this message only:
    the file is read, and the fault is returned.

    Returns:
        The database, and the fault of each faulty message, by the index of the message in the
        database.

    Raises:
        ConfigurationError: The file cannot be read; the message gives ``file:line:column`` of a
            syntax error.
    """
    with _explained(path):
        return _loaded(_content(path))


@lru_cache(maxsize=4)
def _loaded(data: bytes) -> tuple[Database, dict[int, str]]:
    """Return a database and the faults of its messages; cached, since a run reads it repeatedly."""
    database = _load(data)
    faults = {at: _fault(message) for at, message in enumerate(database.messages)}
    return database, {at: words for at, words in faults.items() if words}


def _fault(message: Message) -> str:
    """Return a text on the error in the bits of a message; empty without an error."""
    try:
        message.refresh(strict=True)
    except DbcError as error:
        return str(error).rstrip(".")
    except _ODD as error:
        return f"{type(error).__name__}: {error}"
    return ""


def read_dbc(path: Path) -> dict[str, Layout]:
    """Read those messages of a DBC file that a drive can send or receive.

    Returns:
        Message name to layout.

    Raises:
        ConfigurationError: The file cannot be read, as in :func:`load_dbc`.
    """
    with _explained(path):
        return dict(_layouts(_content(path)))


def _content(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():
            raise OSError("the path leads to a folder, a pipe or a device")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigurationError(
            f"{path}: the file cannot be read: {reason}; state the path of the drive's DBC file"
        ) from error


@lru_cache(maxsize=4)
def _layouts(data: bytes) -> Mapping[str, Layout]:
    """Return the layouts of a file by message name; cached, since a run reads it repeatedly."""
    database, faults = _loaded(data)
    counts = Counter(message.name for message in database.messages)
    layouts = {
        message.name: Layout(
            name=message.name,
            identifier=message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0),
            size=message.length,
            period_s=_period_s(message.cycle_time),
            signals=_signals(message),
            obstacle=faults.get(at, "") or _obstacle(message),
        )
        for at, message in enumerate(database.messages)
    }
    twice = {name: replace(layouts[name], obstacle=_TWICE) for name, n in counts.items() if n > 1}
    return layouts | twice


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Add the file name to the errors of the parser."""
    try:
        yield
    except DbcError as error:
        raise ConfigurationError(
            f"{path}{_explain(str(error))}; correct it with a DBC editor"
        ) from error
    except _NotTextError as error:
        raise ConfigurationError(f"{path}: is not a text file: {error}") from error


class _NotTextError(Exception):
    """The bytes of the file are not the text of a DBC file."""


def _load(data: bytes) -> Database:
    """Parse a DBC file with the first encoding for which the syntax is correct.

    The names that a map uses are ASCII; other characters are in comments and labels, and bytes that
    no encoding can decode are replaced. The encodings of East Asia are needed because in them the
    second byte of a character may be a backslash, which another encoding would read as an escape of
    the following quotation mark.
    """
    encodings = next((names for mark, names in _MARKS if data.startswith(mark)), _ENCODINGS)
    if encodings is _ENCODINGS and (zero := data.find(0)) >= 0:
        raise _NotTextError(f"byte {zero} is zero; state the path of the drive's DBC file")
    first: DbcError | None = None
    tried: set[str] = set()
    for encoding in encodings:
        try:
            # Invalid bytes show that a text is not UTF-8; all other encodings accept almost all
            # bytes, so that the encoding is selected by the syntax.
            strict = encodings is _ENCODINGS and encoding == "utf-8"
            text = data.decode(encoding, "strict" if strict else "replace").removeprefix("\ufeff")
        except UnicodeDecodeError:
            continue
        if text in tried:  # an ASCII text is the same in all encodings
            continue
        tried.add(text)
        try:
            with _quiet():
                database = cantools.database.load_string(text, database_format="dbc", strict=False)
        except DbcError as error:
            first = first or error
        except _ODD as error:
            first = first or DbcError(f"DBC: {type(error).__name__}: {error}")
        else:
            assert isinstance(database, Database)
            return database
    assert first is not None
    raise first


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide the warnings of ``cantools``: a fault of a message is reported where it is used."""
    log, handler = logging.getLogger("cantools"), logging.NullHandler()
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


def _explain(error: str) -> str:
    text = error.removeprefix("DBC: ").strip('"')
    place = _PLACE.search(text)
    return f":{place[1]}:{place[2]}: {text}" if place else f": {text}"


def _period_s(cycle_time_ms: object) -> float | None:
    """Return a cycle time, s, or None if the attribute is no positive number."""
    if not isinstance(cycle_time_ms, int | float) or not cycle_time_ms > 0:
        return None
    return cycle_time_ms / 1e3


def _obstacle(message: Message) -> str:
    if message.length > 8:
        return f"has {message.length} bytes; a classical CAN frame has at most 8"
    selectors = {s.name: s for s in message.signals if s.is_multiplexer}
    if len(selectors) > 1 or any(s.multiplexer_ids for s in selectors.values()):
        return (
            f"is multiplexed by more than one signal ({', '.join(selectors)}); only one is "
            "supported"
        )
    if odd := [s.name for s in message.signals if s.is_float and s.length not in (32, 64)]:
        return f"has floating-point signals that are not of 32 or 64 bits: {', '.join(odd)}"
    return ""


def _signals(message: Message) -> dict[str, Signal]:
    size = message.length
    selector = next((_signal(s, size) for s in message.signals if s.is_multiplexer), None)
    return {s.name: _signal(s, size, selector) for s in message.signals}


def _signal(signal: FileSignal, size: int, selector: Signal | None = None) -> Signal:
    pages = tuple(signal.multiplexer_ids or ())
    motorola = signal.byte_order == "big_endian"
    return Signal(
        name=signal.name,
        size=size,
        shift=motorola_shift(signal.start, signal.length, size) if motorola else signal.start,
        width=signal.length,
        motorola=motorola,
        signed=signal.is_signed,
        real=signal.is_float,
        factor=float(signal.scale),
        offset=float(signal.offset),
        labels={value: str(name) for value, name in (signal.choices or {}).items()},
        selector=selector if pages else None,
        pages=pages,
    )


Place = tuple[str | int, ...]  # keys that lead from the top of the map to a faulty value
Problem = tuple[Place, str]


class DbcMapError(Exception):
    """The map does not fit the DBC."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)  # place in the map and description of each problem
        super().__init__(
            "; ".join(f"{'.'.join(map(str, place))}: {text}" for place, text in self.problems)
        )


class Names:
    """Looks up the names of a map in a DBC, and collects the problems to report them together."""

    def __init__(self, layouts: Mapping[str, Layout]) -> None:
        self.layouts = layouts
        self.problems: list[Problem] = []  # the problems found so far

    def report(self, place: Place, text: str) -> None:
        """Add a problem."""
        self.problems.append((place, text))

    def layout(self, place: Place, message: str) -> Layout | None:
        """Return a message, or report why it cannot be used and return None."""
        layout = self.layouts.get(message)
        if layout is None:
            self.report(
                place, f"the DBC has no message {message!r}; {nearest(message, self.layouts)}"
            )
        elif layout.obstacle:
            self.report(place, f"message {message!r} {layout.obstacle}")
            return None
        return layout

    def signal(self, place: Place, name: str) -> tuple[Layout, Signal] | None:
        """Return message and signal of ``Message.Signal``, or report and return None."""
        message, dot, signal = name.partition(".")
        if not dot:
            self.report(place, f"{name!r} must have the form Message.Signal")
            return None
        layout = self.layout(place, message)
        found = None if layout is None else self.part(place, layout, signal)
        return None if layout is None or found is None else (layout, found)

    def part(self, place: Place, layout: Layout, name: str) -> Signal | None:
        """Return a signal of a message, or report that there is none and return None."""
        signal = layout.signals.get(name)
        if signal is None:
            near = nearest(name, layout.signals)
            self.report(place, f"message {layout.name!r} has no signal {name!r}; {near}")
        return signal

    def require_whole(self, place: Place, signal: Signal) -> bool:
        """Report a problem if a signal that must be a whole number is floating-point."""
        if signal.real:
            self.report(
                place, f"signal {signal.name!r} is floating-point; use a signal with whole numbers"
            )
        return not signal.real

    def raw(self, place: Place, signal: Signal, value: str | int | float) -> int | None:
        """Return the raw value of a label or number, or report that it does not fit."""
        if isinstance(value, str):
            raw = next((raw for raw, label in signal.labels.items() if label == value), None)
            if raw is None:
                near = nearest(value, signal.labels.values())
                self.report(place, f"signal {signal.name!r} has no value {value!r}; {near}")
            return raw
        if not self.require_whole(place, signal):
            return None
        low, high = signal.range
        if isinstance(value, int) and low <= value <= high:
            return value
        what = f"is outside {low} to {high}, the range of {signal.name!r}"
        if not isinstance(value, int):
            what = f"is not a whole number, as signal {signal.name!r} requires"
        self.report(place, f"{value} {what}")
        return None

    def bits(self, place: Place, signal: Signal, value: str | int | float) -> int | None:
        """Return the bits of a value, also for a floating-point signal."""
        if signal.real and not isinstance(value, str):
            try:
                return signal.pack(float(value))
            except (ValueError, OverflowError) as error:
                self.report(place, str(error))
                return None
        raw = self.raw(place, signal, value)
        return None if raw is None else raw & signal.mask


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a text with the known names that are most similar to a name, or with all."""
    names = sorted(known)
    close = [k for k in names if k.casefold() == name.casefold()] or difflib.get_close_matches(
        name, names, n=3
    )
    if close:
        return f"did you mean {' or '.join(repr(k) for k in close)}?"
    return f"known names are {', '.join(names)}" if names else "no name is known"
