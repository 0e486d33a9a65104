"""Excitations of an experiment: commands, weights, durations, and the limits of the bench."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from identification.numerics.arrays import Array

_RAMP_ACCELERATION, _LEAST_RAMP_S, _LONGEST_RAMP = 2.0, 0.05, 0.25
"""Fade of a proposed sine: acceleration, rad/s^2; least time, s; and greatest share of the duration
of the sine, fade-in and fade-out included.
"""

Tone = tuple[float, float]
"""Amplitude, rad, and frequency, Hz."""


@dataclass(frozen=True)
class Ramps:
    """Repeated ramps: the joint moves away from the centre at constant speed (rad/s) for a given
    time (s), and back.
    """

    speed: float
    away: float


@dataclass(frozen=True)
class Excitation:
    """Sines about a centre or ramps, with the weight on the lever, kg, and the duration, s."""

    tones: tuple[Tone, ...]
    weight: float
    seconds: float
    ramps: Ramps | None = None

    @property
    def fade(self) -> float:
        """Time in which the sine of a proposal fades in, and in which it fades out, s.

        The time is short because the joint creeps or nearly stops during a fade, and then the
        filter may diverge.
        """
        speed = sum(2.0 * math.pi * frequency * amplitude for amplitude, frequency in self.tones)
        longest = min(1.0, _LONGEST_RAMP * self.seconds)
        return round(min(max(speed / _RAMP_ACCELERATION, _LEAST_RAMP_S), longest), 3)

    @property
    def step(self) -> float:
        """Half a period of a sine, or one ramp away and back, s; the duration is a whole number of
        steps.
        """
        return 2.0 * self.ramps.away if self.ramps else 0.5 / self.tones[0][1]

    @property
    def shortest(self) -> float:
        """Least duration, s; at least two ramps are needed, because one ramp has only one breakaway
        from rest.
        """
        return 2.0 * self.step if self.ramps else self.step

    def lasting(self, seconds: float) -> Excitation:
        """Return the excitation with as many half periods or ramps as fit into the time, so that
        the motion ends at its start angle.
        """
        longest = max(math.floor(seconds / self.step + 1e-6) * self.step, self.shortest)
        return replace(self, seconds=round(longest, 3))


@dataclass(frozen=True)
class Frame:
    """A stage of the given sequence: whether the stage is loaded, its excitation, its total time,
    s, and a function that computes the joint angles of an excitation.

    ``pause`` is the time of the stage without its excitation, s.
    """

    loaded: bool
    present: Excitation
    total: float
    pause: float
    render: Callable[[Excitation], Array]


@dataclass(frozen=True)
class Part:
    """A proposed stage: its excitation, and the number of the present stage whose settings the
    proposed stage keeps.
    """

    frame: int
    excitation: Excitation


@dataclass(frozen=True)
class Bounds:
    """Limits of the bench at the joint, SI: angles, speed, torque, following error, frequency; and
    the weights that can be hung, kg.
    """

    angle_min: float
    angle_max: float
    speed: float
    torque: float
    following: float
    highest_Hz: float
    weights: tuple[float, ...]
