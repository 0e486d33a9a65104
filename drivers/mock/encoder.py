"""Simulated absolute joint encoder with the CANopen profile CiA 406."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from drivers.clock import NS, SimulatedClock
from drivers.mock.canopen.dictionary import clamp_i16, key
from drivers.mock.canopen.node import SimulatedNode
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
