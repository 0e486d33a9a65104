"""From a bench file to devices on an open bus: the only place where drivers are chosen and wired together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import drivers.mock
from drivers.canopen_link import CanopenLink
from drivers.cia402_servo import Cia402Servo
from drivers.cia406 import Cia406Encoder
from drivers.clock import RealClock
from drivers.mock.bench import simulated_bench
from drivers.units import EncoderScales, ServoScales
from rig.bench import Bench, Bus
from rig.configuration import Document
from rig.cycle import Devices
from rig.errors import InputError

_EDS = Path(drivers.mock.__file__).parent
DRIVE_EDS = _EDS / "drive.eds"
ENCODER_EDS = _EDS / "encoder.eds"


@contextmanager
def connect(document: Document[Bench], seed: int, realtime: bool) -> Iterator[Devices]:
    """Open a bench's bus with its devices on it, and close it at the end. Nothing moves.

    Args:
        document: The bench.
        seed: Of the mock bench's noise.
        realtime: Hold the mock bench to real time.

    Raises:
        InputError: The bench has no bus, or a real device has no EDS file.
        DeviceError: The bus cannot be opened, or the bench file contradicts itself on the wire.
    """
    bench = document.value
    if bench.bus is None:
        text = "this bench has no bus and is only simulated directly, by `rig paper`; use `practical`, or add a bus"
        raise InputError(document.problem(("bus",), text))
    link, hang = _link(bench, bench.bus, seed)
    drive_eds, encoder_eds = _eds(document, "servo", DRIVE_EDS), _eds(document, "encoder", ENCODER_EDS)
    servo = Cia402Servo(link.add_node(bench.servo.node, drive_eds), link, servo_scales(bench))
    encoder = Cia406Encoder(link.add_node(bench.encoder.node, encoder_eds), encoder_scales(bench))
    link.open()
    try:
        yield Devices(link, servo, encoder, hang, RealClock() if realtime and bench.simulated else None)
    finally:
        link.close()


def _link(bench: Bench, bus: Bus, seed: int) -> tuple[CanopenLink, Callable[[float], None] | None]:
    """Return the link, and what hangs a weight on a simulated lever."""
    if bench.mock is not None and bench.simulated:
        mock = simulated_bench(bench.mock, seed, bus.bitrate, bench.servo.node, bench.encoder.node)
        return CanopenLink(mock.clock, lambda: mock.bus, name="simulated bus"), mock.machine.hang
    link = CanopenLink.on_interface(RealClock(), bus.interface, bus.channel or "", bus.bitrate)
    return link, None


def _eds(document: Document[Bench], section: Literal["servo", "encoder"], simulated: Path) -> Path:
    """Return a device's EDS file; the twins' own ship with them, real devices bring theirs."""
    bench = document.value
    named: str | None = getattr(bench, section).eds
    if named is not None:
        return document.path.parent / named
    if not bench.simulated:
        text = "missing; a real device needs its manufacturer's EDS file, relative to this file"
        raise InputError(document.problem((section, "eds"), text))
    return simulated


def servo_scales(bench: Bench) -> ServoScales:
    """Return the drive's scales in SI units."""
    servo = bench.servo
    return ServoScales(
        counts_per_turn=servo.counts_per_motor_turn,
        gear_ratio=bench.machine.gear_ratio,
        rated_current_A=servo.rated_current_A,
        rated_torque_N_m=servo.rated_torque_N_m,
        sign=servo.sign,
        offset_rad=math.radians(servo.offset_deg),
        velocity_unit_rad_s=servo.velocity_unit_rad_s,
        voltage_object=servo.voltage_object,
        voltage_unit_V=servo.voltage_unit_V,
        temperature_object=servo.temperature_object,
        temperature_unit_C=servo.temperature_unit_C,
    )


def encoder_scales(bench: Bench) -> EncoderScales:
    """Return the joint encoder's scales in SI units."""
    encoder = bench.encoder
    return EncoderScales(
        counts_per_turn=encoder.counts_per_turn, sign=encoder.sign, offset_rad=math.radians(encoder.offset_deg)
    )
