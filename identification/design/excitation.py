"""What an experiment commands, under which weight, for how long, and within which limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from identification.recording import Array

_RAMP_ACCELERATION, _LEAST_RAMP_S, _LONGEST_RAMP = 2.0, 0.05, 0.25
"""Acceleration at which a proposed sine fades in, rad/s^2, the least time that takes, s, and its greatest share of the
whole: both ramps lie inside."""

Tone = tuple[float, float]
"""Amplitude, rad, and frequency, Hz."""


@dataclass(frozen=True)
class Excitation:
    """Sines about a centre, the weight on the lever, kg, and their duration, s."""

    tones: tuple[Tone, ...]
    weight: float
    seconds: float

    @property
    def ramp(self) -> float:
        """Time in which a proposal fades in and out, s: short, since on the way the shaft creeps or nearly stops.

        One stretch in which the filter loses it widened the interval of omega_sL twofold.
        """
        speed = sum(2.0 * math.pi * frequency * amplitude for amplitude, frequency in self.tones)
        longest = min(1.0, _LONGEST_RAMP * self.seconds)
        return round(min(max(speed / _RAMP_ACCELERATION, _LEAST_RAMP_S), longest), 3)

    def lasting(self, seconds: float) -> Excitation:
        """Return the same for as many half periods of its sine as the time has room for: it ends where it began."""
        pace = 2.0 * self.tones[0][1]
        return replace(self, seconds=round(max(1.0, math.floor(seconds * pace + 1e-6)) / pace, 3))


@dataclass(frozen=True)
class Frame:
    """A stage as it is: whether loaded, what is commanded, the time it takes, s, and how commands become joint angles.

    ``pause`` is what a stage takes beside its excitation, s.
    """

    loaded: bool
    present: Excitation
    total: float
    pause: float
    render: Callable[[Excitation], Array]


@dataclass(frozen=True)
class Part:
    """A proposed stage: the number of the stage whose settings it has, and its excitation."""

    frame: int
    excitation: Excitation


@dataclass(frozen=True)
class Bounds:
    """What the bench allows at the joint, SI: angles, speed, torque, following error; weights that can be hung, kg."""

    angle_min: float
    angle_max: float
    speed: float
    torque: float
    following: float
    highest_Hz: float
    weights: tuple[float, ...]
