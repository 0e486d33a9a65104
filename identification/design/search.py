"""Searches for a set of sines, ramps and weights, and their shares of the time, that minimises the
interval of one parameter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from identification.design.draws import MARGIN, Draws
from identification.design.excitation import Bounds, Excitation, Frame, Part
from identification.design.intervals import (
    NAMES,
    NOTHING,
    Information,
    Intervals,
    effective,
    intervals_of,
    stage_information,
)
from identification.design.shares import shared
from identification.design.simulated import PlannedModel, PlannedStage, followed, stage_response
from identification.estimate.equation_error.regression import HIGHEST_SHARE
from identification.model.parameters import SYSTEM_PARAMETERS
from identification.numerics.arrays import Array

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
        """Return the best design from a pool, and its excitations, or None if there is no
        excitation for unloaded or for loaded stages.

        An excitation on whose whole stage the filter diverges is removed from the pool permanently.
        """
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
        """Return whether the filter does not diverge over the whole duration of an excitation, with
        other noise series than those with which the excitation was judged.
        """
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
        """Return whether an identification can start from this unloaded stage: its motion has
        enough acceleration, and a speed above the falling branch of friction.

        On the falling branch of friction the equation error does not distinguish inertia torque
        from friction, and at small accelerations it does not determine the inertia.
        """
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
        """Return successively smaller selections of a pool; each step removes the excitation whose
        removal worsens the merit least.

        The first selection has the greatest possible number of stages, the last the least possible
        number. Each excitation gets at least its shortest duration.
        """
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
        """Return the merit of the best design that shares the whole time, without pauses, among
        these candidates.
        """
        total = self._total
        shares, counts = self._shared(chosen, self._least(chosen))
        parts = [i.times(float(share) * total) for share, i in zip(shares, counts, strict=True)]
        return self.merit(intervals_of(parts, any(f.loaded for f in self.frames)))

    def _least(self, chosen: Sequence[Candidate]) -> Array:
        """Return the least share of the time of each candidate, the pause of its stage included,
        shape (n,).
        """
        shortest = [c.part.excitation.shortest + self.frames[c.part.frame].pause for c in chosen]
        least = np.maximum(min(LEAST_S, self._total / len(chosen)), shortest)
        return np.asarray(least / max(self._total, float(np.sum(least))))

    def _timed(self, chosen: Sequence[Candidate]) -> Design:
        """Return the design that shares the whole time among a few excitations, each rounded down
        to half periods.
        """
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
        """Return the information per second of an excitation, or None if the excitation violates a
        limit or has no information.
        """
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
        """Return whether the simulated response of a drive stays within the limits, less a
        margin.
        """
        b, response = self.bounds, stage_response(stage, nominal)
        return (
            response.peak_speed < MARGIN * b.speed
            and response.peak_torque < MARGIN * b.torque
            and response.peak_following < _FOLLOWING_MARGIN * b.following
        )
