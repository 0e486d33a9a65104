"""Maps recorded CAN traffic to canonical channels in SI units, in the same way as a run of the
bench.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from canopen.objectdictionary import datatypes

from drivers.canopen import cia402
from drivers.canopen import cia402_objects as objects
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink
from drivers.canopen.motion import TARGET_POSITION
from drivers.canopen.pdo import RECEIVE, TRANSMIT, Direction
from drivers.canopen.sdo import variable
from drivers.clock import SimulatedClock
from drivers.dbc.map import Quantity
from drivers.errors import ConfigurationError
from drivers.objects import ObjectAddress
from identification.recording import CHANNELS
from rig.common.errors import InputError
from rig.config.bench import Bench, load_bench
from rig.config.canopen import EncoderSection, ServoSection
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection, dbc_path
from rig.sources.can_traffic.dbc_map import messages_of
from rig.sources.can_traffic.layout import BusMessage, BusSignal, little_endian
from rig.wiring.connect import eds_path
from rig.wiring.scales import encoder_scales, servo_axis, servo_motion, servo_scales

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
