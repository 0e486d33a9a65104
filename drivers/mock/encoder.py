"""Simulated absolute joint encoder with the CANopen profile CiA 406."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.amt21.encoder import (
    COUNTS_PER_TURN,
    DEFAULT_ADDRESS,
    EXTENDED,
    RESET,
    SET_ZERO,
    TURNS,
    encode,
)
from drivers.clock import NS, SimulatedClock
from drivers.mock.canopen.dictionary import clamp_i16, key
from drivers.mock.canopen.node import SimulatedNode
from drivers.mock.plant.parts.constants import Transmitter
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

ENCODER_EDS: Final = Path(__file__).with_name("encoder.eds")
EXACT_COUNTS: Final = 1 << 22
"""Counts per turn of an exact sensor."""

_POSITION: Final = key(0x6004)
_SPEED: Final = key(0x6030, 1)
_COUNTER_CLOCKWISE: Final = 0x01
_SCALING: Final = 0x04
_TURNS: Final = 4096


class SimulatedEncoder(SimulatedNode):
    """A simulated multi-turn encoder: 6004h = (direction x scaled joint counts + preset offset)
    modulo 6002h.

    Attributes:
        distort: Function that changes the joint counts as a faulty sensor does, or None for a
            sensor without fault.
    """

    def __init__(
        self,
        bus: SimulatedBus,
        clock: SimulatedClock,
        node_id: int,
        sampler: Sampler,
        clock_offset_us: int = 0,
    ) -> None:
        super().__init__(bus, clock, node_id, ENCODER_EDS, clock_offset_us)
        self._sampler = sampler
        self._resolution = sampler.machine.constants.sensing.joint_counts_per_turn or EXACT_COUNTS
        self.distort: Callable[[int], int] | None = None
        self._offset = 0
        self._before: tuple[int, int] | None = None
        for index in (0x6000, 0x6001, 0x6002):
            self.objects.written[index] = lambda _sub, _value: self._configure()
        self.objects.written[0x6003] = lambda _sub, value: self._preset(value)
        self.restore()

    @property
    def counts_per_turn(self) -> int:
        """Joint counts of one turn, in the units of :attr:`distort`."""
        return self._resolution

    def restore(self) -> None:
        """Set resolution and range of this machine's encoder in the dictionary."""
        values = self._values
        values[key(0x6001)] = values[key(0x6501)] = self._resolution
        values[key(0x6002)] = min(self._resolution * _TURNS, 1 << 30)
        self._offset = 0
        self._configure()

    def refresh(self) -> None:
        """Update the position for an SDO upload."""
        self.stamp(self._clock.now_ns())
        self._values[_POSITION] = self._position(self._counts())

    def latch(self) -> None:
        """Sample position, speed and time at a SYNC."""
        counts = self._counts()
        now = self._sampler.time_ns
        self.stamp(now)
        self._values[_POSITION] = self._position(counts)
        if self._before is not None and now > self._before[1]:
            moved = (counts - self._before[0]) * self._factor * self._units / self._resolution
            self._values[_SPEED] = clamp_i16(round(moved * NS / (now - self._before[1])))
        self._before = (counts, now)

    def _counts(self) -> int:
        counts = self._sampler.peek(self._clock.now_ns()).joint_counts
        return counts if self.distort is None else self.distort(counts)

    def _configure(self) -> None:
        operating = self.objects.integer(0x6000)
        scaled = bool(operating & _SCALING)
        self._factor = -1 if operating & _COUNTER_CLOCKWISE else 1
        self._units = self.objects.integer(0x6001) if scaled else self._resolution
        self._range = self.objects.integer(0x6002)
        self._values[key(0x6500)] = operating
        self._before = None

    def _position(self, counts: int) -> int:
        return (
            self._factor * counts * self._units // self._resolution + self._offset
        ) % self._range

    def _preset(self, value: int) -> None:
        self._offset = 0
        self._offset = value - self._position(self._counts())


RESTART_S: Final = 0.2


class SimulatedAmt21:
    """A simulated multi-turn encoder; a :class:`~drivers.mock.wires.serial_line.Station`.

    The encoder ignores requests for 0.2 s after a reset and after its zero was set.

    Args:
        clock: Simulated time.
        sampler: Sampler of the machine.
        address: Address of the encoder, a multiple of 4.

    Attributes:
        distort: Function that changes the counts as a faulty sensor does, or None for a sensor
            without fault.
    """

    counts_per_turn: Final = COUNTS_PER_TURN

    def __init__(
        self, clock: SimulatedClock, sampler: Sampler, address: int = DEFAULT_ADDRESS
    ) -> None:
        self.distort: Callable[[int], int] | None = None
        self._clock = clock
        self._sampler = sampler
        self._address = address
        self._resolution = sampler.machine.constants.sensing.joint_counts_per_turn or EXACT_COUNTS
        self._zero = 0
        self._extended = False
        self._deaf_until_ns = 0

    def receive(self, data: bytes) -> bytes:
        """Return the answers to the requests in ``data``; requests to other addresses get no
        answer.
        """
        if self._clock.now_ns() < self._deaf_until_ns:
            return b""
        return b"".join(self._answer(byte) for byte in data)

    def _answer(self, byte: int) -> bytes:
        if self._extended:
            self._extended = False
            if byte == SET_ZERO:
                self._zero += self._counts()
            if byte in (SET_ZERO, RESET):
                self._deaf_until_ns = self._clock.now_ns() + round(RESTART_S * NS)
            return b""
        match byte - self._address:
            case 0:
                return encode(self._counts())
            case value if value == TURNS:
                return encode(self._counts() // COUNTS_PER_TURN)
            case value if value == EXTENDED:
                self._extended = True
        return b""

    def _counts(self) -> int:
        joint = self._sampler.peek(self._clock.now_ns()).joint_counts
        counts = joint * COUNTS_PER_TURN // self._resolution
        return (counts if self.distort is None else self.distort(counts)) - self._zero


TRANSMITTER_EDS: Final = Path(__file__).with_name("transmitter.eds")
PRESSURE_UNIT_PA: Final = 100.0
"""Unit of 9130h: bar (6131h) with three decimal digits (6132h)."""

_VALUE: Final = key(0x9130, 1)
_STATUS: Final = key(0x6150, 1)
_OVERLOAD: Final = 0x02


class SimulatedTransmitter(SimulatedNode):
    """A simulated transmitter: 9130h is the pressure at the last SYNC, with noise; 6150h reports
    whether the pressure is out of range.
    """

    def __init__(
        self,
        bus: SimulatedBus,
        clock: SimulatedClock,
        node_id: int,
        sampler: Sampler,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(bus, clock, node_id, TRANSMITTER_EDS, 0)
        self._sampler = sampler
        self._rng = rng

    def refresh(self) -> None:
        """Update the pressure for an SDO upload."""
        self.latch()

    def latch(self) -> None:
        """Sample the pressure at a SYNC."""
        now = self._clock.now_ns()
        exact = np.array([self._sampler.peek(now).pressure_Pa])
        units, over = transmitted(self._sampler.machine.constants.gas.transmitter, exact, self._rng)
        self.stamp(now)
        self._values[_VALUE] = int(units[0])
        self._values[_STATUS] = _OVERLOAD if over[0] else 0


def transmitted(
    transmitter: Transmitter, pressure_Pa: NDArray[np.float64], rng: np.random.Generator | None
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return a transmitter's readings of exact pressures, shape (n,).

    Returns:
        The readings in whole units of :data:`PRESSURE_UNIT_PA`, and a mask of the readings that are
        limited to the range.
    """
    noise = 0.0 if rng is None else transmitter.noise_Pa * rng.standard_normal(len(pressure_Pa))
    reading = pressure_Pa + noise
    over = np.asarray(reading > transmitter.range_Pa)
    return np.rint(np.minimum(reading, transmitter.range_Pa) / PRESSURE_UNIT_PA), over
