"""Reads the messages of a DBC file as signals of recorded CAN traffic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.can.port import EXTENDED_FLAG
from drivers.dbc.file import load_dbc
from drivers.errors import ConfigurationError
from rig.common.errors import InputError
from rig.sources.can_traffic.layout import (
    MOST_BITS,
    BusMessage,
    BusSignal,
    big_endian,
    little_endian,
)

_FLOAT_WIDTHS = (16, 32, 64)


def messages_of(path: Path) -> list[BusMessage]:
    """Return the messages of a DBC file.

    Raises:
        InputError: The file cannot be read; the message names line and column.
    """
    try:
        database, faults = load_dbc(path)
    except ConfigurationError as error:
        raise InputError(str(error)) from error
    return [_message(message, faults.get(at, "")) for at, message in enumerate(database.messages)]


def _message(message: Any, fault: str) -> BusMessage:
    found: dict[str, BusSignal] = {}
    left_out: list[str] = []
    if message.is_container:
        left_out.append(f"{message.name} (a container of other messages)")
    by_name = {signal.name: signal for signal in message.signals}
    for signal in message.signals:
        words = _obstacle(signal)
        if words:
            left_out.append(f"{message.name}.{signal.name} ({words})")
        elif not message.is_container:
            _signal(signal, by_name, found)
    return BusMessage(
        name=message.name,
        identifier=message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0),
        signals=tuple(found[name] for name in by_name if name in found),
        by_group=message.protocol == "j1939" and message.is_extended_frame,
        left_out=tuple(left_out),
        fault=fault,
    )


def _obstacle(signal: Any) -> str:
    """Return the reason why a signal cannot be read; empty if it can be read."""
    if signal.length > MOST_BITS:
        return f"{signal.length} bits, at most {MOST_BITS} are read"
    if signal.is_float and signal.length not in _FLOAT_WIDTHS:
        return f"a floating-point number of {signal.length} bits"
    return ""


def _signal(signal: Any, by_name: dict[str, Any], found: dict[str, BusSignal]) -> BusSignal | None:
    """Return a signal, after its multiplexers were added to ``found``, or None if a multiplexer
    cannot be read.
    """
    if signal.name in found:
        return found[signal.name]
    selector = None
    if signal.multiplexer_ids and signal.multiplexer_signal:
        above = by_name.get(signal.multiplexer_signal)
        if above is None or above is signal or _obstacle(above):
            return None
        selector = _signal(above, by_name, found)
        if selector is None:
            return None
    bits = big_endian if signal.byte_order == "big_endian" else little_endian
    low, high = signal.minimum, signal.maximum
    stated = low is not None and high is not None and low < high
    found[signal.name] = BusSignal(
        name=signal.name,
        parts=bits(signal.start, signal.length),
        width=signal.length,
        signed=bool(signal.is_signed),
        real=bool(signal.is_float),
        factor=float(signal.scale),
        offset=float(signal.offset),
        unit=str(signal.unit or ""),
        low=float(low) if stated else None,
        high=float(high) if stated else None,
        selector=selector,
        pages=frozenset(signal.multiplexer_ids or ()) if selector is not None else frozenset(),
    )
    return found[signal.name]
