"""Simulated absolute joint encoder with the CANopen profile CiA 406."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.amt21.encoder import COUNTS_PER_TURN, DEFAULT_ADDRESS, encode
from drivers.clock import SimulatedClock
from drivers.mock.canopen.dictionary import key
from drivers.mock.canopen.node import SimulatedNode
from drivers.mock.plant.parts.constants import Transmitter
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

ENCODER_EDS: Final = Path(__file__).with_name("encoder.eds")
EXACT_COUNTS: Final = 1 << 22  # counts per turn of an exact sensor

_POSITION: Final = key(0x6004)
_SCALING: Final = 0x04
_TURNS: Final = 4096


class SimulatedEncoder(SimulatedNode):
    """A simulated multi-turn encoder: 6004h = scaled joint counts modulo 6002h."""

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
        # Function that changes the joint counts as a faulty sensor does, or None for a sensor
        # without fault.
        self.distort: Callable[[int], int] | None = None
        for index in (0x6000, 0x6001, 0x6002):
            self.objects.written[index] = lambda _sub, _value: self._configure()
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
        self._configure()

    def refresh(self) -> None:
        """Update the position for an SDO upload."""
        self.stamp(self._clock.now_ns())
        self._measure()

    def latch(self) -> None:
        """Sample position and time at a SYNC."""
        self._measure()
        self.stamp(self._sampler.time_ns)

    def _measure(self) -> None:
        counts = self._sampler.peek(self._clock.now_ns()).joint_counts
        if self.distort is not None:
            counts = self.distort(counts)
        self._values[_POSITION] = counts * self._units // self._resolution % self._range

    def _configure(self) -> None:
        operating = self.objects.integer(0x6000)
        self._units = self.objects.integer(0x6001) if operating & _SCALING else self._resolution
        self._range = self.objects.integer(0x6002)
        self._values[key(0x6500)] = operating


class SimulatedAmt21:
    """A simulated encoder; a :class:`~drivers.mock.wires.serial_line.Station`."""

    counts_per_turn: Final = COUNTS_PER_TURN

    def __init__(
        self, clock: SimulatedClock, sampler: Sampler, address: int = DEFAULT_ADDRESS
    ) -> None:
        # Function that changes the counts as a faulty sensor does, or None for a sensor without
        # fault.
        self.distort: Callable[[int], int] | None = None
        self._clock = clock
        self._sampler = sampler
        self._address = address
        self._resolution = sampler.machine.constants.sensing.joint_counts_per_turn or EXACT_COUNTS

    def receive(self, data: bytes) -> bytes:
        """Return the answers to the requests to this address in ``data``."""
        return b"".join(encode(self._counts()) for byte in data if byte == self._address)

    def _counts(self) -> int:
        joint = self._sampler.peek(self._clock.now_ns()).joint_counts
        counts = joint * COUNTS_PER_TURN // self._resolution
        return counts if self.distort is None else self.distort(counts)


TRANSMITTER_EDS: Final = Path(__file__).with_name("transmitter.eds")
PRESSURE_UNIT_PA: Final = 100.0  # unit of 9130h: bar (6131h) with three decimal digits (6132h)

_VALUE: Final = key(0x9130, 1)
_STATUS: Final = key(0x6150, 1)
_OVERLOAD: Final = 0x02


class SimulatedTransmitter(SimulatedNode):
    """A transmitter: 9130h is the pressure at the last SYNC, 6150h whether it is in range."""

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
