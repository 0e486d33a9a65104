"""Injects faults of the joint encoder (bit flips, jumps, freeze) and of the drive's mode."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from drivers.mock.canopen.dictionary import key
from drivers.mock.drive import SimulatedDrive
from drivers.mock.plant.machine import SimulatedMachine

_MODE_DISPLAY = key(0x6061)


class Sensor(Protocol):
    """A simulated encoder of any kind; ``distort`` is the function by which a fault changes the
    counts, or None without a fault.
    """

    distort: Callable[[int], int] | None

    @property
    def counts_per_turn(self) -> int:
        """Counts per turn, in the units of ``distort``."""
        ...


def flip_bit(encoder: Sensor, bit: int, count: int) -> None:
    """Invert one bit of the position in the next ``count`` readings, or in all readings if
    ``count`` is 0.
    """
    left = count or None

    def distort(counts: int) -> int:
        nonlocal left
        if left is not None:
            left -= 1
            if left <= 0:
                encoder.distort = None
        return counts ^ 1 << bit

    encoder.distort = distort


def jump(encoder: Sensor, by_counts: int) -> None:
    """Shift the position permanently, as after a lost reference or a slipped coupling."""
    encoder.distort = lambda counts: counts + by_counts


def freeze(encoder: Sensor) -> None:
    """Return the position of the next reading in all later readings, while time stamps advance."""
    held: int | None = None

    def distort(counts: int) -> int:
        nonlocal held
        held = counts if held is None else held
        return held

    encoder.distort = distort


def reverse(encoder: Sensor) -> None:
    """Reverse the sign of the counts, as with two wires swapped."""
    encoder.distort = _negated


def on_motor_shaft(encoder: Sensor, machine: SimulatedMachine) -> None:
    """Count the motor's turns, as an encoder that is mounted on the other end of the gear."""
    per_turn = encoder.counts_per_turn / (2.0 * math.pi) * machine.constants.motor.gear_ratio
    encoder.distort = lambda _: math.floor(machine.truth().angle_rad * per_turn)


def refuse_mode(drive: SimulatedDrive) -> None:
    """Accept that 6060h is written, but without effect, so that 6061h reports no mode."""
    drive.objects.values[_MODE_DISPLAY] = 0
    ignored: Callable[[int, int], None] = lambda _subindex, _value: None  # noqa: E731
    drive.objects.written[0x6060] = ignored


def _negated(counts: int) -> int:
    return -counts
