"""Creates the devices of the serial sections of a bench file, real or simulated."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.amt21.encoder import COUNTS_PER_TURN, Amt21Encoder, Gate
from drivers.amt21.line import Amt21Line
from drivers.clock import Clock
from drivers.epos.link import EposSerialLink
from drivers.interfaces import Servo
from drivers.mock.amt21 import SimulatedAmt21
from drivers.mock.bench import SimulatedBench
from drivers.mock.epos_serial import SimulatedEposPort
from drivers.mock.wires.serial_line import SimulatedLine, Station
from drivers.serial_port import BytePort, PySerialPort
from drivers.units import EncoderScales
from rig.config.serial_bus import Amt21Section, SerialBus
from rig.wiring.guard import Guard


def epos_link(
    bus: SerialBus, simulated: SimulatedBench | None, clock: Clock, guard: Guard | None
) -> EposSerialLink:
    """Return the link of a drive on a serial line: a real port with its guard, or the simulated
    bench's link in simulated time.
    """
    if simulated is None:
        assert guard is not None
        return EposSerialLink(clock, guard.open_port, guard.name, guard=guard)
    station = SimulatedEposPort(simulated.bus, simulated.clock, simulated.drive)
    return EposSerialLink(
        clock, _simulated(simulated, "drive", bus.baud, station), "simulated EPOS4"
    )


def amt21_encoder(
    section: Amt21Section,
    middle_rad: float,
    simulated: SimulatedBench | None,
    clock: Clock,
    servo: Servo,
    gear_ratio: float,
) -> Amt21Encoder:
    """Return an encoder on its line, real or simulated.

    Args:
        section: The encoder in the bench file.
        middle_rad: Middle of the joint's travel, rad.
        simulated: The simulated bench, if there is one.
        clock: The host's clock.
        servo: The drive; its position decides the number of turns after a long pause.
        gear_ratio: Motor turns per joint turn.
    """
    connect: Callable[[], BytePort]
    if simulated is None:
        connect, name = lambda: PySerialPort(section.port, section.baud), f"AMT21 at {section.port}"
    else:
        station = SimulatedAmt21(simulated.clock, simulated.sampler, section.address)
        connect, name = _simulated(simulated, "encoder", section.baud, station), "simulated AMT21"
    line = Amt21Line(clock, connect, name, section.address)
    scales = EncoderScales(
        COUNTS_PER_TURN, section.sign, math.radians(section.offset_deg), middle_rad
    )
    gate = Gate(
        math.radians(section.gate_speed_deg_s), math.radians(section.gate_acceleration_deg_s2)
    )

    def elsewhere_rad() -> float | None:
        sample = servo.sample()
        return sample.motor_angle_rad / gear_ratio if sample.fresh else None

    return Amt21Encoder(line, scales, gate, elsewhere_rad)


def _simulated(
    simulated: SimulatedBench, device: str, baud: int, station: Station
) -> Callable[[], BytePort]:
    line = simulated.lines[device] = SimulatedLine(simulated.clock, baud, station)
    return lambda: line
