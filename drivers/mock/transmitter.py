"""Simulated pressure transmitter on the gas generator's chamber (CANopen profile CiA 404)."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.clock import SimulatedClock
from drivers.mock.canopen.dictionary import key
from drivers.mock.canopen.node import SimulatedNode
from drivers.mock.plant.parts.constants import Transmitter
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

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
