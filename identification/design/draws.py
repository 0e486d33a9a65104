"""Draws candidate excitations: random sines and ramps, and small changes of the selected
excitations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.design.excitation import Bounds, Excitation, Frame, Part, Ramps, Tone

TRIAL_S, TRIAL_PERIODS = 5.0, 3.0
"""Least duration of the short stage on which an excitation is judged, in s and in periods of the
excitation.
"""
MARGIN = 0.85
"""Share of the limits on angle, speed and torque that a proposal may reach when it is simulated on
the nominal model.
"""
_SLOWEST_HZ, _FASTEST_HZ = 0.2, 4.0
_LEAST_SPEED, _GREATEST_SPEED = 0.03, 1.8
"""Speed of a random sine at its centre, rad/s."""
_LEAST_ACCELERATION = 0.25
"""Least acceleration of a random sine at its ends, rad/s^2.

With a lower acceleration the joint stays near rest for longer and sticks and slips.
"""
_LEAST_ANGLE = math.radians(0.3)
"""Least amplitude of a sine, rad. Motions of smaller amplitude are dominated by backlash and
presliding, which the nominal model lacks.
"""
_HEAVIEST = 0.25
"""Share of the loaded sines that always have the heaviest weight."""
_NEAR = 0.75
"""Share of the sines whose speed is drawn near the falling branch of friction."""
_NEAR_SPEEDS, _NEAR_ACCELERATIONS = (1.2, 4.0), (_LEAST_ACCELERATION, 1.2)
"""Sines near the falling branch: speed at the centre, as multiples of the Stribeck speed, and
acceleration at the ends, rad/s^2. At lower accelerations the joint sticks and slips; at higher
accelerations it crosses the falling branch within one sample.
"""
_RAMPS = 0.4
"""Share of ramps among the excitations that are drawn."""
_RAMP_SPEEDS, _RAMP_TIMES = (1.2, 5.0), (0.15, 1.0)
"""Speeds of ramps, as multiples of the Stribeck speed, and durations of a ramp in one direction, s.

Where friction falls faster than the drive's velocity gain can compensate, the joint sticks and
slips. Just above that speed every sample carries information on the falling branch. Samples just
after a breakaway carry most information, and short ramps have more breakaways.
"""
_SPREAD, _RAMP_SPREAD = 0.2, 0.06
"""Standard deviation of the logarithm of the factor by which a quantity is changed, and of the
factor on the speed of a ramp.
"""


@dataclass(frozen=True)
class Draws:
    """Draws excitations for some stages.

    Attributes:
        frames: The stages.
        bounds: Limits of the bench.
        stribeck: Stribeck speeds of the system load and of the working load, rad/s.
        slot: Least time of each stage of a design, s.
        rng: Source of all randomness.
    """

    frames: Sequence[Frame]
    bounds: Bounds
    stribeck: tuple[float, float]
    slot: float
    rng: np.random.Generator

    def random(self, loaded: bool) -> Part:
        """Return a random excitation with one of the weights: a sine of any speed, a sine near the
        falling branch of friction, or ramps near the falling branch.
        """
        b, rng = self.bounds, self.rng
        number = [f.loaded for f in self.frames].index(loaded)
        # Load friction, and the information of fast sines on it, grows with the weight; only under
        # lighter weights can the drive hold the joint on the falling branch.
        weight = max(b.weights) if rng.random() < _HEAVIEST else float(rng.choice(b.weights))
        found = self._ramps(number) if rng.random() < _RAMPS else self._sine(number)
        return Part(number, self._tried(number, replace(found, weight=weight if loaded else 0.0)))

    def _sine(self, number: int) -> Excitation:
        """Return a sine of any speed and frequency, or a sine near the falling branch of
        friction.
        """
        near = self.rng.random() < _NEAR
        frequency, speed = self._near(self.frames[number].loaded) if near else self._any()
        pace = 2.0 * math.pi * frequency
        return Excitation(
            ((max(min(self._reach, speed / pace), _LEAST_ANGLE), frequency),), 0.0, 0.0
        )

    def _ramps(self, number: int) -> Excitation:
        """Return ramps near the least speed at which the drive can hold the joint on the falling
        branch of friction.
        """
        speed = self.stribeck[self.frames[number].loaded] * _log_uniform(self.rng, *_RAMP_SPEEDS)
        speed = min(speed, MARGIN * self.bounds.speed)
        return self._away(number, speed, _log_uniform(self.rng, *_RAMP_TIMES))

    def _away(self, number: int, speed: float, seconds: float) -> Excitation:
        """Return ramps at this speed; ``seconds`` is the duration of a ramp, which the range of the
        angle and the time of the stage may shorten.
        """
        slot = self.slot - self.frames[number].pause
        longest = min(
            _RAMP_TIMES[1], self._reach / speed, 0.25 * slot
        )  # the shortest excitation has two ramps away and two back
        shortest = max(_RAMP_TIMES[0], _LEAST_ANGLE / speed)
        away = math.floor(100.0 * min(max(seconds, shortest), longest)) / 100.0
        return Excitation((), 0.0, 0.0, Ramps(speed, max(away, 0.01)))

    def changed(self, part: Part) -> Part:
        """Return an excitation that differs a little from the given one, sometimes with the next
        heavier or lighter weight.
        """
        e, ladder = part.excitation, sorted({*self.bounds.weights, part.excitation.weight})
        weight = e.weight
        changed = (
            self._other_ramps(part.frame, e.ramps) if e.ramps else self._other_sine(e.tones[0])
        )
        if self.frames[part.frame].loaded and self.rng.random() < 0.3:
            place = ladder.index(weight) + int(self.rng.choice([-1, 1]))
            weight = ladder[min(max(place, 0), len(ladder) - 1)]
        return replace(part, excitation=self._tried(part.frame, replace(changed, weight=weight)))

    def _other_sine(self, tone: Tone) -> Excitation:
        amplitude, frequency = tone
        wider, faster = np.exp(_SPREAD * self.rng.standard_normal(2))
        frequency = min(frequency * float(faster), self.bounds.highest_Hz)
        least = max(_LEAST_ANGLE, _LEAST_ACCELERATION / (2.0 * math.pi * frequency) ** 2)
        return Excitation(((max(amplitude * float(wider), least), frequency),), 0.0, 0.0)

    def _other_ramps(self, number: int, ramps: Ramps) -> Excitation:
        faster, longer = np.exp((_RAMP_SPREAD, _SPREAD) * self.rng.standard_normal(2))
        return self._away(number, ramps.speed * float(faster), ramps.away * float(longer))

    @property
    def _reach(self) -> float:
        """Return the greatest amplitude, rad."""
        return 0.5 * MARGIN * (self.bounds.angle_max - self.bounds.angle_min)

    def _any(self) -> tuple[float, float]:
        """Return a log-uniform random frequency, Hz, and speed at the centre, rad/s."""
        frequency = _log_uniform(self.rng, _SLOWEST_HZ, min(_FASTEST_HZ, self.bounds.highest_Hz))
        speed = _log_uniform(
            self.rng, _LEAST_SPEED, min(_GREATEST_SPEED, MARGIN * self.bounds.speed)
        )
        return frequency, max(speed, _LEAST_ACCELERATION / (2.0 * math.pi * frequency))

    def _near(self, loaded: bool) -> tuple[float, float]:
        """Return frequency and centre speed of a sine whose centre speed is a few times the
        Stribeck speed.
        """
        speed = self.stribeck[loaded] * _log_uniform(self.rng, *_NEAR_SPEEDS)
        speed = min(speed, MARGIN * self.bounds.speed)
        acceleration = _log_uniform(self.rng, *_NEAR_ACCELERATIONS)
        frequency = acceleration / (2.0 * math.pi * speed)
        return min(max(frequency, _SLOWEST_HZ), self.bounds.highest_Hz), speed

    def _tried(self, number: int, e: Excitation) -> Excitation:
        """Return the excitation with the duration of the short stage on which excitations are
        judged.
        """
        period = e.step if e.ramps else 2.0 * e.step
        return e.lasting(
            min(max(TRIAL_S, TRIAL_PERIODS * period), self.frames[number].present.seconds)
        )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
