"""Excitations of an experiment: commands, weights, durations, and the limits of the bench."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from identification.numerics.arrays import Array

_RAMP_ACCELERATION, _LEAST_RAMP_S, _LONGEST_RAMP = 2.0, 0.05, 0.25
"""Acceleration at which a proposed sine fades in, rad/s^2, the least time that takes, s, and its
greatest share of the whole: both ramps lie inside.
"""

Tone = tuple[float, float]
"""Amplitude, rad, and frequency, Hz."""


@dataclass(frozen=True)
class Ramps:
    """Constant speed, rad/s, away from the centre for a time, s, and back, again and again."""

    speed: float
    away: float


@dataclass(frozen=True)
class Excitation:
    """Sines about a centre, or ramps and no sines; the weight on the lever, kg, and their duration,
    s.
    """

    tones: tuple[Tone, ...]
    weight: float
    seconds: float
    ramps: Ramps | None = None

    @property
    def fade(self) -> float:
        """Time in which a proposal's sines fade in and out, s.

        It is short because the joint creeps or nearly stops meanwhile, and the filter may diverge
        there.
        """
        speed = sum(2.0 * math.pi * frequency * amplitude for amplitude, frequency in self.tones)
        longest = min(1.0, _LONGEST_RAMP * self.seconds)
        return round(min(max(speed / _RAMP_ACCELERATION, _LEAST_RAMP_S), longest), 3)

    @property
    def step(self) -> float:
        """Half a period of a sine, or one ramp away and back, s: it lasts a whole number of
        them.
        """
        return 2.0 * self.ramps.away if self.ramps else 0.5 / self.tones[0][1]

    @property
    def shortest(self) -> float:
        """The least time it can last, s: two ramps, as one has a single breakaway from rest."""
        return 2.0 * self.step if self.ramps else self.step

    def lasting(self, seconds: float) -> Excitation:
        """Return the same for as many half periods or ramps as the time has room for: it ends where
        it began.
        """
        longest = max(math.floor(seconds / self.step + 1e-6) * self.step, self.shortest)
        return replace(self, seconds=round(longest, 3))


@dataclass(frozen=True)
class Frame:
    """A stage as it is: whether loaded, what is commanded, the time it takes, s, and how commands
    become joint angles.

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
    """What the bench allows at the joint, SI: angles, speed, torque, following error; weights that
    can be hung, kg.
    """

    angle_min: float
    angle_max: float
    speed: float
    torque: float
    following: float
    highest_Hz: float
    weights: tuple[float, ...]
