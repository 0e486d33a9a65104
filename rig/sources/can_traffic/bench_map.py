"""Maps recorded CAN traffic to canonical channels in SI units, in the same way as a run of the
bench.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from canopen.objectdictionary import datatypes
from numpy.typing import NDArray

from drivers.can.port import EXTENDED_FLAG
from drivers.canopen import cia402
from drivers.canopen import cia402_objects as objects
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink
from drivers.canopen.motion import TARGET_POSITION
from drivers.canopen.pdo import RECEIVE, TRANSMIT, Direction
from drivers.canopen.sdo import variable
from drivers.clock import SimulatedClock
from drivers.dbc.file import load_dbc
from drivers.dbc.map import Quantity
from drivers.errors import ConfigurationError
from drivers.objects import ObjectAddress
from identification.recording import CHANNELS, Array
from rig.common.errors import InputError
from rig.config.bench import Bench, load_bench
from rig.config.canopen import EncoderSection, ServoSection
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection, dbc_path
from rig.sources.can_traffic.frames import Frames
from rig.sources.formats.table import as_doubles
from rig.wiring.connect import eds_path
from rig.wiring.scales import encoder_scales, servo_axis, servo_motion, servo_scales

MOST_BITS = 64
_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """Neighbouring bits of a signal in one byte.

    Attributes:
        byte: Index of the byte in the frame.
        low: Number of the lowest of the bits in this byte.
        count: Number of bits.
        place: Number of the bit of the raw value that the lowest of the bits gives.
    """

    byte: int
    low: int
    count: int
    place: int


@dataclass(frozen=True)
class BusSignal:
    """One signal of a CAN message.

    Attributes:
        name: Name of the signal's column.
        parts: Bits of the signal, least significant first.
        width: Number of bits.
        signed: Whether the raw value is in two's complement.
        real: Whether the raw value is a number by IEEE 754.
        factor: Value of one raw unit.
        offset: Value at raw 0.
        unit: Unit as the source states it.
        low: Least value that the source allows, or None if the source states no range.
        high: Greatest value that the source allows, or None.
        selector: The multiplexer that determines whether the signal is in a frame, or None for a
            signal that is in every frame.
        pages: Raw values of the selector with which the signal is in the frame.
    """

    name: str
    parts: tuple[Part, ...]
    width: int
    signed: bool = False
    real: bool = False
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    low: float | None = None
    high: float | None = None
    selector: BusSignal | None = None
    pages: frozenset[int] = frozenset()

    @property
    def bytes(self) -> int:
        """Number of bytes that a frame must have to contain the signal."""
        return max(part.byte for part in self.parts) + 1

    def present(self, frames: Frames) -> Mask:
        """Return a mask of the frames that contain the signal, by their length and their
        multiplexers.
        """
        there: Mask = frames.lengths >= self.bytes
        if self.selector is not None:
            there = there & self.selector.present(frames)
            there = there & np.isin(self.selector.bits(frames), list(self.pages))
        return there

    def bits(self, frames: Frames) -> NDArray[np.uint64]:
        """Return the raw bits in each frame; zero if a frame is too short."""
        value = np.zeros(len(frames.data), np.uint64)
        for part in self.parts:
            if part.byte < frames.data.shape[1]:
                byte = frames.data[:, part.byte].astype(np.uint64)
                own = (byte >> np.uint64(part.low)) & np.uint64((1 << part.count) - 1)
                value |= own << np.uint64(part.place)
        return value

    def values(self, frames: Frames, rows: Mask) -> tuple[Array, str]:
        """Return the values in the given frames, and a note if values were changed."""
        bits = self.bits(frames)[rows]
        if self.real:
            unsigned, kind = _FLOATS[self.width]
            # The bits of a float may also represent NaN or infinity.
            with np.errstate(over="ignore", invalid="ignore"):
                raw = bits.astype(unsigned).view(kind).astype(np.float64)
                return raw * self.factor + self.offset, ""
        whole: NDArray[np.uint64] | NDArray[np.int64] = bits
        if self.signed:
            shift = np.uint64(MOST_BITS - self.width)
            whole = (bits << shift).view(np.int64) >> np.int64(shift)
        if self.factor == 1.0 and self.offset == 0.0:
            return as_doubles(whole)
        return whole.astype(np.float64) * self.factor + self.offset, ""


@dataclass(frozen=True)
class BusMessage:
    """One CAN message with its signals.

    Attributes:
        name: First part of the names of the columns; empty if the names of the signals suffice.
        identifier: Identifier, with the flag for 29 bits.
        signals: Signals in the order of the source.
        by_group: Whether frames with other priorities and source addresses are also this message,
            as in SAE J1939.
        left_out: Texts on the parts of the message that cannot be read.
        fault: Text on wrong places of bits in the source, which are read nevertheless; empty for
            none.
    """

    name: str
    identifier: int
    signals: tuple[BusSignal, ...]
    by_group: bool = False
    left_out: tuple[str, ...] = field(default=())
    fault: str = ""


def little_endian(start: int, width: int) -> tuple[Part, ...]:
    """Return the bits of a little-endian signal whose least significant bit is at ``start``."""
    return tuple(_parts(range(start, start + width)))


def big_endian(start: int, width: int) -> tuple[Part, ...]:
    """Return the bits of a big-endian signal whose most significant bit has the DBC number
    ``start``.
    """
    positions = []
    at = start
    for _ in range(width):
        positions.append(at)
        at = at + 15 if at % 8 == 0 else at - 1
    return tuple(_parts(positions[::-1]))


def _parts(positions: Sequence[int]) -> Iterator[Part]:
    """Yield the neighbouring bits in each byte; ``positions`` begin with the least significant
    bit.
    """
    first = 0
    for k in range(1, len(positions) + 1):
        broken = (
            k == len(positions)
            or positions[k] != positions[k - 1] + 1
            or positions[k] // 8 != positions[first] // 8
        )
        if broken:
            start = positions[first]
            yield Part(start // 8, start % 8, k - first, first)
            first = k


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


_UNITS = {name: unit.replace("deg C", "degC") for name, unit in CHANNELS.items()}
_COUNTER_BITS = 32
_PDO_STEP = 0x100
"""Difference of the identifiers of two successive PDOs of a node in the predefined connection
set.
"""
_Scale = tuple[str, float, float]
"""Name of a column, SI units per raw unit, and SI value at raw value 0."""


def messages_of_bench(path: Path) -> list[BusMessage]:
    """Return the messages of a bench's drive and joint encoder as a run maps them.

    Raises:
        InputError: The bench file or a device file cannot be used, or the bus of the bench is not
            CAN.
    """
    document = load_bench(path)
    bench = document.value
    try:
        if isinstance(bench.servo, DbcServoSection):
            found = list(_dbc(document, bench.servo))
        elif isinstance(bench.servo, ServoSection) and getattr(bench.bus, "bitrate", None):
            found = list(_drive(document, bench.servo))
        else:
            raise InputError(
                f"{path}: the drive of this bench is not on a CAN bus; name a DBC file instead"
            )
        if isinstance(bench.encoder, EncoderSection):
            found += _encoder(document, bench.encoder)
    except ConfigurationError as error:
        raise InputError(f"{path}: {error}") from error
    return found


def _drive(document: Document[Bench], servo: ServoSection) -> Iterator[BusMessage]:
    """Yield the PDOs of a CiA 402 drive as messages."""
    data = servo.device_data(document.path.parent)
    scales = servo_scales(servo, document.value.machine, data)
    motion = servo_motion(servo, scales, data)
    eds = eds_path(document, "servo")
    link = CanopenLink(SimulatedClock(), _never_opened)
    node = link.add_node(servo.node, eds, servo_axis(servo, data))
    sent = objects.cyclic(node, scales)
    angle = (scales.motor_rad_per_count, scales.offset_rad * scales.gear_ratio)
    meaning: dict[ObjectAddress, _Scale] = {
        cia402.STATUSWORD: ("statusword", 1.0, 0.0),
        cia402.CONTROLWORD: ("controlword", 1.0, 0.0),
        objects.POSITION: ("motor_angle", *angle),
        TARGET_POSITION: ("command", scales.joint_rad_per_count, scales.offset_rad),
    }
    optional: tuple[tuple[ObjectAddress | None, str, float], ...] = (
        (sent.current, "current", scales.sign * sent.current_unit_A),
        (sent.speed, "velocity", scales.sign * scales.joint_speed_unit_rad_s),
        (sent.time, "device_time", 1e-6),
        (sent.voltage, "voltage", scales.sign * scales.voltage_unit_V),
        (sent.supply, "supply_voltage", scales.supply_unit_V),
        (sent.temperature, "temperature", scales.temperature_unit_C),
        (sent.torque, "torque_6077h", 1.0),
    )
    meaning |= {at: (name, unit, 0.0) for at, name, unit in optional if at is not None}
    for direction, layouts in (
        (RECEIVE, objects.outputs(motion)),
        (TRANSMIT, objects.inputs(sent, node)),
    ):
        for layout in layouts:
            yield _pdo(direction, layout.number, servo.node, eds, layout.objects, meaning)


def _encoder(document: Document[Bench], encoder: EncoderSection) -> Iterator[BusMessage]:
    """Yield the PDO of a CiA 406 encoder as a message, without its time stamp."""
    scales = encoder_scales(encoder, document.value.limits)
    position = (0x6004, 0)
    meaning = {position: ("angle", scales.rad_per_count, scales.offset_rad)}
    eds = eds_path(document, "encoder")
    yield _pdo(TRANSMIT, 1, encoder.node, eds, (position,), meaning)


def _pdo(
    direction: Direction,
    number: int,
    node: int,
    eds: Path,
    mapped: Sequence[ObjectAddress],
    meaning: Mapping[ObjectAddress, _Scale],
) -> BusMessage:
    dictionary = read_eds(eds, node)
    signals = []
    start = 0
    for address in mapped:
        item = variable(dictionary, *address)
        name, factor, offset = meaning[address]
        width = len(item)
        signals.append(
            BusSignal(
                name,
                little_endian(start, width),
                width,
                # A counter of 32 bits counts from zero in both directions.
                signed=item.data_type in datatypes.SIGNED_TYPES or width == _COUNTER_BITS,
                factor=factor,
                offset=offset,
                unit=_UNITS.get(name, ""),
            )
        )
        start += width
    identifier = direction.identifiers + (number - 1) * _PDO_STEP + node
    return BusMessage(f"{direction.name}{number}_node{node}", identifier, tuple(signals))


def _dbc(document: Document[Bench], servo: DbcServoSection) -> Iterator[BusMessage]:
    """Yield the messages of the drive's DBC file; a signal that the map assigns to a channel has
    the name of the channel.
    """
    gear = document.value.machine.gear_ratio
    channels = {
        "position": ("motor_angle", 1.0, gear * servo.drive(gear, 1.0).offset_rad),
        "velocity": ("velocity", 1.0 / gear, 0.0),
        "torque": ("torque", gear, 0.0),
        "current": ("current", 1.0, 0.0),
        "voltage": ("voltage", 1.0, 0.0),
        "supply_voltage": ("supply_voltage", 1.0, 0.0),
        "temperature": ("temperature", 1.0, 0.0),
    }
    meaning: dict[str, list[tuple[str, Quantity, float, float]]] = {}
    for name, (channel, factor, zero) in channels.items():
        quantity: Quantity | None = getattr(servo.inputs, name)
        if quantity is not None:
            meaning.setdefault(quantity.signal, []).append((channel, quantity, factor, zero))
    for message in messages_of(dbc_path(servo, document.path)):
        signals = []
        for signal in message.signals:
            signals.append(signal)
            for channel, quantity, factor, zero in meaning.get(f"{message.name}.{signal.name}", ()):
                gain = factor * quantity.sign * quantity.scale
                bias = factor * quantity.sign * quantity.offset + zero
                signals.append(
                    dataclasses.replace(
                        signal,
                        name=channel,
                        factor=gain * signal.factor,
                        offset=gain * signal.offset + bias,
                        unit=_UNITS.get(channel, ""),
                        low=None,
                        high=None,
                    )
                )
        yield dataclasses.replace(message, signals=tuple(signals))


def _never_opened() -> NoReturn:
    raise AssertionError("only the map of this bench is read, and its bus must not be opened")
