"""Searches for a set of sines, ramps and weights, and their shares of the time, that minimises the
interval of one parameter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from identification.design.simulated import (
    NAMES,
    NOTHING,
    Information,
    Intervals,
    PlannedModel,
    PlannedStage,
    effective,
    followed,
    intervals_of,
    stage_information,
    stage_response,
    weights_of_scores,
)
from identification.estimate.equation_error import HIGHEST_SHARE
from identification.model.parameters import SYSTEM_PARAMETERS
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
        """Return a sine of any speed, or one near the falling branch of friction."""
        near = self.rng.random() < _NEAR
        frequency, speed = self._near(self.frames[number].loaded) if near else self._any()
        pace = 2.0 * math.pi * frequency
        return Excitation(
            ((max(min(self._reach, speed / pace), _LEAST_ANGLE), frequency),), 0.0, 0.0
        )

    def _ramps(self, number: int) -> Excitation:
        """Return ramps near the least speed that the drive can hold on the falling branch."""
        speed = self.stribeck[self.frames[number].loaded] * _log_uniform(self.rng, *_RAMP_SPEEDS)
        speed = min(speed, MARGIN * self.bounds.speed)
        return self._away(number, speed, _log_uniform(self.rng, *_RAMP_TIMES))

    def _away(self, number: int, speed: float, seconds: float) -> Excitation:
        """Return ramps of this speed; range and time of the stage may shorten ``seconds``."""
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
        """Return frequency and centre speed of a sine at a few Stribeck speeds."""
        speed = self.stribeck[loaded] * _log_uniform(self.rng, *_NEAR_SPEEDS)
        speed = min(speed, MARGIN * self.bounds.speed)
        acceleration = _log_uniform(self.rng, *_NEAR_ACCELERATIONS)
        frequency = acceleration / (2.0 * math.pi * speed)
        return min(max(frequency, _SLOWEST_HZ), self.bounds.highest_Hz), speed

    def _tried(self, number: int, e: Excitation) -> Excitation:
        """Return the excitation with the duration on which excitations are judged."""
        period = e.step if e.ramps else 2.0 * e.step
        return e.lasting(
            min(max(TRIAL_S, TRIAL_PERIODS * period), self.frames[number].present.seconds)
        )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


_ROUNDS, _TURNS = 500, 2
_OTHERS = 0.04
"""Weight of the relative variances of the other parameters in the criterion, relative to the weight
of the target parameter's variance; with this weight no parameter stays undetermined.
"""
_FLOOR = 1e-12


def best_shares(
    rates: Sequence[Information], target: str, loaded: bool, least: Array | None = None
) -> Array:
    """Return each excitation's share of the time, shape (n,); the shares sum to 1.

    Args:
        rates: Information of each excitation per second.
        target: The parameter whose variance is minimised.
        loaded: Whether the four load parameters are unknown as well.
        least: Least share of each excitation, shape (n,), of sum 1 at most, or None for zero.
    """
    count = len(NAMES) if loaded else NAMES.index("mu_c")
    normals = np.array([rate.normal[:count, :count] for rate in rates])
    scale = np.sqrt(np.maximum(np.einsum("ikk->k", normals), 1e-300))
    normals = (normals / np.outer(scale, scale)).reshape(len(rates), -1)
    worth = np.where(np.array(NAMES[:count]) == target, 1.0, _OTHERS) / scale**2
    floor = _FLOOR * np.eye(count)
    least = np.zeros(len(rates)) if least is None else least
    left = 1.0 - float(np.sum(least))
    shares = np.full(len(rates), 1.0 / len(rates))
    for _ in range(_ROUNDS):
        spread = np.linalg.inv(((least + left * shares) @ normals).reshape(count, count) + floor)
        gradient = normals @ ((spread * worth) @ spread).ravel()
        shares = shares * np.sqrt(np.maximum(gradient, 0.0))
        shares /= np.sum(shares)
    return np.asarray(least + left * shares)


def shared(
    informations: Sequence[Information], target: str, loaded: bool, least: Array | None = None
) -> tuple[Array, list[Information]]:
    """Return the optimal shares of excitations, shape (n,), and the effective information of each
    excitation on the target at these shares.

    The effective information depends on the weights of the scores in the estimate of the target
    parameter (:func:`identification.design.simulated.weights_of_scores`), and the weights depend on
    the shares; therefore weights and shares are computed in turn.
    """
    counts = list(informations)
    for _ in range(_TURNS):
        shares = best_shares(counts, target, loaded, least)
        total = [i.times(float(share)) for i, share in zip(counts, shares, strict=True)]
        weights = weights_of_scores(total, target, loaded)
        counts = [i.effective(weights) for i in informations]
    return best_shares(counts, target, loaded, least), counts


DESIGNS = 8
"""Greatest number of designs that are judged as a whole."""
PARTS = 7
"""Greatest number of stages of a design."""
_LONGER = 1.3
"""Ratio of an excitation's duration to the duration on which the filter was tested, above which the
filter is tested again.
"""
_OTHER_NOISES = (1000, 1001)
"""Seeds of further noise series with which the filter is tested, because the filter may diverge
with one noise series in six.
"""
_SUPPORT = 12
"""Number of excitations from which a design is chosen; they are those with the greatest shares of
the time.
"""
LEAST_S = 3.0
"""Least duration of a proposed stage."""
_FOLLOWING_MARGIN = 0.5
"""Share of the following-error limit that a proposal may reach; the margin is wide because the
following error depends on the assumed drive loop.
"""
_STARTING_ACCELERATION = 0.5
"""Acceleration, rad/s^2, that at least one unloaded sine must have, about the value of Figure 10;
with a lower acceleration the equation error does not determine the inertia.
"""


@dataclass(eq=False)
class Candidate:
    """An excitation on a short stage, its information per second, and the longest duration, s, for
    which a test showed that the filter does not diverge.
    """

    part: Part
    rate: Information
    followed_s: float = 0.0

    def like(self, part: Part) -> bool:
        """Return whether a proposed stage has this excitation, of any duration."""
        return (
            replace(part, excitation=replace(part.excitation, seconds=self.part.excitation.seconds))
            == self.part
        )


@dataclass(frozen=True)
class Design:
    """Stages that together fill the total time, and the intervals predicted by their
    information.
    """

    parts: tuple[Part, ...]
    predicted: Intervals


def planned(frame: Frame, excitation: Excitation) -> PlannedStage:
    """Return the commands and weight of one stage."""
    return PlannedStage(frame.render(excitation), excitation.weight)


def predicted(
    frames: Sequence[Frame], parts: Sequence[Part], nominals: Sequence[PlannedModel], target: str
) -> Intervals:
    """Return the intervals of fixed stages, predicted by their information."""
    informations = [
        stage_information(planned(frames[p.frame], p.excitation), nominals) for p in parts
    ]
    loaded = any(f.loaded for f in frames)
    return intervals_of(effective(informations, target, loaded), loaded)


def halved(
    design: Design, frames: Sequence[Frame], nominals: Sequence[PlannedModel], target: str
) -> Design:
    """Return the design in half of the time, with the present excitation in the other half.

    With the present excitation the searches of an identification reach the basin of the true
    values, which they may not reach with the design alone.
    """
    parts, left = [], 0.0
    for number, frame in enumerate(frames):
        own = [p.excitation for p in design.parts if p.frame == number]
        spans = [frame.total, *(e.seconds + frame.pause for e in own)]
        for excitation, span in zip((frame.present, *own), spans, strict=True):
            room = 0.5 * span + left - frame.pause
            left = room + frame.pause
            if room >= excitation.shortest:
                parts.append(Part(number, excitation.lasting(room)))
                left = room - parts[-1].excitation.seconds
    return Design(tuple(parts), predicted(frames, parts, nominals, target))


@dataclass
class Search:
    """Simulates excitations, keeps those within the limits, and shares the time among them."""

    frames: Sequence[Frame]
    nominals: Sequence[PlannedModel]
    bounds: Bounds
    rng: np.random.Generator
    target: str
    now: float
    """Relative half width of the target parameter with the present excitation; the relative half
    width of every other parameter should stay below this value.
    """
    pool: list[Candidate] = field(default_factory=list)
    count: int = 0

    def merit(self, pins: Intervals) -> float:
        """Return the merit, which is minimised: the relative half width of the target parameter,
        increased if the relative half width of another parameter exceeds ``now``.
        """
        return pins.half_widths[self.target] * max(
            1.0, pins.worst / max(self.now, pins.half_widths[self.target])
        )

    def add(self, part: Part) -> None:
        """Simulate an excitation on a short stage, and keep the excitation if it has
        information.
        """
        rate = self._rate(part)
        if rate is not None:
            self.pool.append(Candidate(part, rate))

    @property
    def _total(self) -> float:
        """Time of all stages, s."""
        return sum(f.total for f in self.frames)

    @property
    def _room(self) -> int:
        """Number of stages that a design may have."""
        return max(len({f.loaded for f in self.frames}), min(PARTS, int(self._total / LEAST_S)))

    @cached_property
    def draws(self) -> Draws:
        """Random generator of excitations."""
        values = self.nominals[0].values
        stribeck = values["omega_sf"], values.get("omega_sL", values["omega_sf"])
        return Draws(self.frames, self.bounds, stribeck, self._total / self._room, self.rng)

    def changed(self, count: int) -> list[Part]:
        """Return excitations that differ a little from those with a share of the time; the list is
        empty if there is no excitation for unloaded or for loaded stages.
        """
        if not self.complete:
            return []
        shares = self._shares(self.pool)
        return [
            self.draws.changed(self.pool[k].part)
            for k in self.rng.choice(len(shares), count, p=shares)
        ]

    def designs(self) -> list[Design]:
        """Return the best design and its variants that omit one of the longest excitations, sorted
        by merit, best first.
        """
        best = self._design(list(self.pool))
        if best is None:
            return []
        found = [best]
        for candidate in self._longest(best[1])[: DESIGNS - 1]:
            without = self._design([c for c in self.pool if c is not candidate])
            found += [without] if without is not None else []
        ranked = sorted((design for design, _ in found), key=lambda d: self.merit(d.predicted))
        return ranked

    def _longest(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """Return candidates sorted by their shares of the time, greatest first."""
        return [chosen[k] for k in np.argsort(-self._shares(chosen), kind="stable")]

    def _design(self, pool: list[Candidate]) -> tuple[Design, list[Candidate]] | None:
        """Return the best design from a pool and its excitations, or None without one."""
        while self._complete(pool):
            designs = [(self._timed(chosen), chosen) for chosen in self._fewer(pool)]
            design, chosen = min(designs, key=lambda d: self.merit(d[0].predicted))
            lost = [
                c
                for c in chosen
                if not all(self._followed(c, p) for p in design.parts if c.like(p))
            ]
            if not lost:
                return design, chosen
            self.pool, pool = ([c for c in some if c not in lost] for some in (self.pool, pool))
        return None

    def _followed(self, candidate: Candidate, part: Part) -> bool:
        """Return whether the filter follows the whole duration, with other noise series."""
        seconds = part.excitation.seconds
        if seconds > _LONGER * candidate.followed_s:
            frame = self.frames[part.frame]
            names = NAMES if frame.loaded else SYSTEM_PARAMETERS
            if not followed(planned(frame, part.excitation), self.nominals, names, _OTHER_NOISES):
                return False
            candidate.followed_s = seconds
        return True

    @property
    def complete(self) -> bool:
        """Whether the pool has an excitation for every kind of stage, and an unloaded excitation
        from which identification can start.
        """
        return self._complete(self.pool)

    def _complete(self, pool: Sequence[Candidate]) -> bool:
        kinds = {f.loaded for f in self.frames}
        return set(map(self._loaded, pool)) == kinds and (
            False not in kinds or any(map(self._starts, pool))
        )

    def _starts(self, candidate: Candidate) -> bool:
        """Return whether an identification can start from this unloaded stage."""
        # On the falling branch of friction the equation error does not distinguish inertia torque
        # from friction, and at small accelerations it does not determine the inertia.
        if not candidate.part.excitation.tones:
            return False
        ((amplitude, frequency),) = candidate.part.excitation.tones
        pace = 2.0 * math.pi * frequency
        leaves = HIGHEST_SHARE * pace * amplitude >= self.nominals[0].values["omega_sf"]
        return (
            not self._loaded(candidate) and leaves and pace**2 * amplitude >= _STARTING_ACCELERATION
        )

    def _shared(
        self, pool: Sequence[Candidate], least: Array | None = None
    ) -> tuple[Array, list[Information]]:
        return shared(
            [c.rate for c in pool], self.target, any(f.loaded for f in self.frames), least
        )

    def _shares(self, pool: Sequence[Candidate]) -> Array:
        return self._shared(pool)[0]

    def _fewer(self, pool: Sequence[Candidate]) -> list[list[Candidate]]:
        """Return ever smaller selections of a pool, each without the least useful one."""
        ranked = [pool[k] for k in np.argsort(-self._shares(pool), kind="stable")]
        chosen = ranked[:_SUPPORT]
        kinds = {f.loaded for f in self.frames}
        lacking = kinds - {self._loaded(c) for c in chosen}
        chosen += [next(c for c in ranked if self._loaded(c) == loaded) for loaded in lacking]
        if not self._complete(chosen):
            chosen.append(next(c for c in ranked if self._starts(c)))
        found = []
        while True:
            if len(chosen) <= self._room:
                found.append(chosen)
            rests = [[c for c in chosen if c is not left] for left in chosen]
            complete = [rest for rest in rests if self._complete(rest)]
            if not complete:
                return found
            chosen = min(complete, key=self._reached)

    def _loaded(self, candidate: Candidate) -> bool:
        return self.frames[candidate.part.frame].loaded

    def _reached(self, chosen: Sequence[Candidate]) -> float:
        """Return the merit of the best design of these candidates in the whole time."""
        total = self._total
        shares, counts = self._shared(chosen, self._least(chosen))
        parts = [i.times(float(share) * total) for share, i in zip(shares, counts, strict=True)]
        return self.merit(intervals_of(parts, any(f.loaded for f in self.frames)))

    def _least(self, chosen: Sequence[Candidate]) -> Array:
        """Return the least share of the time of each candidate, pauses included, (n,)."""
        shortest = [c.part.excitation.shortest + self.frames[c.part.frame].pause for c in chosen]
        least = np.maximum(min(LEAST_S, self._total / len(chosen)), shortest)
        return np.asarray(least / max(self._total, float(np.sum(least))))

    def _timed(self, chosen: Sequence[Candidate]) -> Design:
        """Return the design that shares the whole time, each part of whole half periods."""
        total = self._total
        shares, counts = self._shared(chosen, self._least(chosen))
        spans = total * shares
        parts: dict[int, Part] = {}
        informations, left = [], 0.0
        # Time that rounding leaves is given to the next excitation; the longest excitation is the
        # last.
        for k in np.argsort(spans, kind="stable").tolist():
            part, pause = chosen[k].part, self.frames[chosen[k].part.frame].pause
            room = float(spans[k]) + left
            parts[k] = replace(part, excitation=part.excitation.lasting(room - pause))
            left = room - pause - parts[k].excitation.seconds
            informations.append(counts[k].times(room - left))
        order = sorted(
            range(len(parts)), key=lambda k: (parts[k].frame, parts[k].excitation.weight)
        )
        return Design(
            tuple(parts[k] for k in order),
            intervals_of(informations, any(f.loaded for f in self.frames)),
        )

    def _rate(self, part: Part) -> Information | None:
        """Return the information per second, or None outside the limits or without any."""
        b, period = self.bounds, self.nominals[0].sensors.period
        stage = planned(self.frames[part.frame], part.excitation)
        middle = 0.5 * (b.angle_max + b.angle_min)
        reach = float(np.max(np.abs(stage.command - middle)))
        fastest = float(np.max(np.abs(np.diff(stage.command)))) / period
        if reach > 0.5 * MARGIN * (b.angle_max - b.angle_min) or fastest > MARGIN * b.speed:
            return None
        self.count += 1
        if not all(self._within_limits(stage, nominal) for nominal in self.nominals):
            return None
        found = stage_information(stage, self.nominals)
        return None if found is NOTHING else found.times(1.0 / (len(stage.command) * period))

    def _within_limits(self, stage: PlannedStage, nominal: PlannedModel) -> bool:
        """Return whether the simulated response stays within the limits, less a margin."""
        b, response = self.bounds, stage_response(stage, nominal)
        return (
            response.peak_speed < MARGIN * b.speed
            and response.peak_torque < MARGIN * b.torque
            and response.peak_following < _FOLLOWING_MARGIN * b.following
        )
