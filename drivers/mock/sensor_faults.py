"""Faults of the joint encoder, and of the drive's mode of operation: what they make of good values."""

from __future__ import annotations

from collections.abc import Callable

from drivers.mock.dictionary import key
from drivers.mock.drive import SimulatedDrive
from drivers.mock.encoder import SimulatedEncoder

_MODE_DISPLAY = key(0x6061)


def flip_bit(encoder: SimulatedEncoder, bit: int, count: int) -> None:
    """Invert one bit of the position in the next ``count`` readings (0: in all)."""
    left = count or None

    def distort(counts: int) -> int:
        nonlocal left
        if left is not None:
            left -= 1
            if left <= 0:
                encoder.distort = None
        return counts ^ 1 << bit

    encoder.distort = distort


def jump(encoder: SimulatedEncoder, by_counts: int) -> None:
    """Shift the position for good, as after a lost reference or a slipped coupling."""
    encoder.distort = lambda counts: counts + by_counts


def freeze(encoder: SimulatedEncoder) -> None:
    """Hold the position at its next reading, while time stamps go on."""
    held: int | None = None

    def distort(counts: int) -> int:
        nonlocal held
        held = counts if held is None else held
        return held

    encoder.distort = distort


def reverse(encoder: SimulatedEncoder) -> None:
    """Count the other way from zero, as with two wires swapped."""
    encoder.distort = _negated


def refuse_mode(drive: SimulatedDrive) -> None:
    """Take 6060h without acting on it: 6061h shows no mode."""
    drive.objects.values[_MODE_DISPLAY] = 0
    ignored: Callable[[int, int], None] = lambda _subindex, _value: None  # noqa: E731
    drive.objects.written[0x6060] = ignored


def _negated(counts: int) -> int:
    return -counts
