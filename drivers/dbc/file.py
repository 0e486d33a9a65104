"""Reads a DBC file into layouts; the only module that uses ``cantools``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cantools.database
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal as FileSignal
from cantools.database.errors import Error as DbcError

from drivers.dbc.codec import Signal, motorola_shift
from drivers.errors import ConfigurationError
from drivers.plain_file import require_plain

_PLACE: Final = re.compile(r"line (\d+), column (\d+)")


@dataclass(frozen=True)
class Layout:
    """One message of a DBC.

    Attributes:
        name: Name in the DBC.
        identifier: CAN identifier, 11 bits.
        size: Number of bytes.
        period_s: Cycle time in the DBC (``GenMsgCycleTime``), s; None if there is none.
        signals: Signals by name.
        obstacle: Reason why it cannot be used here; empty if it can.
    """

    name: str
    identifier: int
    size: int
    period_s: float | None
    signals: Mapping[str, Signal]
    obstacle: str = ""


def read_dbc(path: Path) -> dict[str, Layout]:
    """Read a DBC file.

    Returns:
        Message name to layout.

    Raises:
        ConfigurationError: It cannot be read; ``file:line:column`` where the syntax is wrong.
    """
    try:
        require_plain(path)
        # The encoding that DBC editors use.
        text = path.read_text(encoding="cp1252")
    except OSError as error:
        raise ConfigurationError(
            f"{path}: cannot be read: {error.strerror}; name the drive's DBC file"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(
            f"{path}: is not a text file: byte {error.start} is not cp1252"
        ) from error
    try:
        database = cantools.database.load_string(text, database_format="dbc")
    except DbcError as error:
        raise ConfigurationError(
            f"{path}{_explain(str(error))}; correct it with a DBC editor"
        ) from error
    assert isinstance(database, Database)
    return {message.name: _layout(message) for message in database.messages}


def _explain(error: str) -> str:
    text = error.removeprefix("DBC: ").strip('"')
    place = _PLACE.search(text)
    return f":{place[1]}:{place[2]}: {text}" if place else f": {text}"


def _layout(message: Message) -> Layout:
    return Layout(
        name=message.name,
        identifier=message.frame_id,
        size=message.length,
        period_s=message.cycle_time / 1e3 if message.cycle_time else None,
        signals={signal.name: _signal(signal, message.length) for signal in message.signals},
        obstacle=_obstacle(message),
    )


def _obstacle(message: Message) -> str:
    if message.is_extended_frame:
        return "has a 29-bit identifier; only 11-bit ones are supported"
    if message.length > 8:
        return f"has {message.length} bytes; classical CAN carries at most 8"
    if message.is_multiplexed():
        return "is multiplexed, which is not supported; use a message with a fixed layout"
    if odd := [s.name for s in message.signals if s.is_float and s.length not in (32, 64)]:
        return f"has floating-point signals that are not of 32 or 64 bits: {', '.join(odd)}"
    return ""


def _signal(signal: FileSignal, size: int) -> Signal:
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
    )
