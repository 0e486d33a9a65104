"""The search for sines and weights, and for their shares of the time, that pin one parameter best together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.design.excitation import Bounds, Excitation, Frame, Part
from identification.design.pinning import (
    NAMES,
    NOTHING,
    Information,
    Nominal,
    Pinned,
    PlannedStage,
    pinned,
    stage_information,
    stage_response,
)
from identification.design.shares import best_shares
from identification.estimate.regression import HIGHEST_SHARE
from identification.recording import Array

DESIGNS = 5
"""Designs that are judged as wholes, at most."""
PARTS = 7
"""Stages of a design, at most."""
_SUPPORT = 12
"""Excitations with the greatest shares, of which a design's are chosen."""
TRIAL_S, TRIAL_PERIODS = 5.0, 2.5
"""Least duration of the stage on which an excitation is judged, s and its periods."""
LEAST_S = 3.0
"""Least duration of a proposed stage."""
ASSUMED, SEEN = (0.75, 1.35), (0.96, 1.04)
"""Drives, beside the nominal one, that a proposal must bear: their velocity gain over its, where that one is assumed,
and where recordings showed it."""
_MARGIN = 0.85
"""Share of the limits on angle, speed and torque that a proposal may use on the nominal bench."""
_FOLLOWING_MARGIN = 0.5
"""The same for the following error, which rests on the assumed drive loop."""
_SLOWEST_HZ, _FASTEST_HZ = 0.2, 4.0
_LEAST_SPEED, _GREATEST_SPEED = 0.03, 1.8
"""Of a random sine at its middle, rad/s."""
_LEAST_ACCELERATION = 0.25
"""At its ends, rad/s^2. The less it is the longer the shaft is near rest, and the more it sticks and slips."""
_STARTING_ACCELERATION = 0.5
"""The same of one unloaded sine at least, rad/s^2, about what Figure 10 has: with less the inertia is not found."""
_LEAST_ANGLE = math.radians(0.3)
"""Least amplitude: smaller swings rest on what no nominal model knows (play, presliding)."""
_HEAVIEST = 0.25
"""Share of loaded sines that get the heaviest weight whatever the draw."""
_NEAR = 0.75
"""Share of sines drawn about where friction falls."""
_NEAR_SPEEDS, _NEAR_ACCELERATIONS = (1.2, 4.0), (_LEAST_ACCELERATION, 1.2)
"""Their speeds at the middle, over the Stribeck speed, and accelerations at the ends, rad/s^2: below, the shaft sticks
and slips; above, it is past the fall of friction before a sample is taken."""
_SPREAD = 0.2
"""Standard deviation of the logarithm of a refinement's change."""


@dataclass(eq=False)
class Candidate:
    """An excitation on a short stage, and its information per second; ``sturdy`` once other drives bear it."""

    part: Part
    rate: Information
    sturdy: bool = False


@dataclass(frozen=True)
class Design:
    """Stages that together take the whole time, and what their information promises."""

    parts: tuple[Part, ...]
    promised: Pinned


def planned(frame: Frame, excitation: Excitation) -> PlannedStage:
    """Return the commands and weight of one stage."""
    return PlannedStage(frame.render(excitation), excitation.weight)


def halved(design: Design, frames: Sequence[Frame], nominal: Nominal) -> Design:
    """Return a design in half of the time, beside the present excitation in the other half.

    The present one leads the searches of an identification into the right basin where a design alone does not.
    """
    parts, left = [], 0.0
    for number, frame in enumerate(frames):
        own = [p.excitation for p in design.parts if p.frame == number]
        spans = [frame.total, *(e.seconds + frame.pause for e in own)]
        for excitation, span in zip((frame.present, *own), spans, strict=True):
            room = 0.5 * span + left - frame.pause
            left = room + frame.pause
            if 2.0 * excitation.tones[0][1] * room >= 1.0:  # less than half a period would take longer
                parts.append(Part(number, excitation.lasting(room)))
                left = room - parts[-1].excitation.seconds
    told = [stage_information(planned(frames[p.frame], p.excitation), nominal) for p in parts]
    return Design(tuple(parts), pinned(told, any(f.loaded for f in frames)))


def drives(nominal: Nominal) -> tuple[float, ...]:
    """Return the velocity gains, over the nominal drive's, that a proposal must bear beside it."""
    return ASSUMED if nominal.loop is None else SEEN


@dataclass
class Search:
    """Simulates excitations, keeps those within the limits, and shares the time among them."""

    frames: Sequence[Frame]
    nominal: Nominal
    bounds: Bounds
    rng: np.random.Generator
    target: str
    now: float
    """The target's relative half width as it is: what no other parameter's should exceed."""
    pool: list[Candidate] = field(default_factory=list)
    count: int = 0

    def merit(self, pins: Pinned) -> float:
        """Return the target's relative half width, more where another's exceeds what it is now; the less the better."""
        return pins.half_widths[self.target] * max(1.0, pins.worst / max(self.now, pins.half_widths[self.target]))

    def add(self, part: Part) -> None:
        """Judge an excitation on a short stage and keep it where it says anything."""
        rate = self._rate(part, self.nominal)
        if rate is not None:
            self.pool.append(Candidate(part, rate))

    def random(self, loaded: bool) -> Part:
        """Return a sine under one of the weights: of any speed and frequency, or about where friction falls."""
        b, rng = self.bounds, self.rng
        number = [f.loaded for f in self.frames].index(loaded)
        frequency, speed = self._near(loaded) if rng.random() < _NEAR else self._any()
        pace = 2.0 * math.pi * frequency
        amplitude = max(min(0.5 * _MARGIN * (b.angle_max - b.angle_min), speed / pace), _LEAST_ANGLE)
        # Friction rises with the weight, and so does what fast sines show of the load's; under the lighter ones the
        # drive holds the shaft where friction falls.
        weight = max(b.weights) if rng.random() < _HEAVIEST else float(rng.choice(b.weights))
        found = Excitation(((amplitude, frequency),), weight if loaded else 0.0, 0.0)
        return Part(number, found.lasting(self._trial(number, frequency)))

    def _any(self) -> tuple[float, float]:
        """Return a frequency, Hz, and a speed at the middle, rad/s, logarithmically uniform."""
        frequency = _log_uniform(self.rng, _SLOWEST_HZ, min(_FASTEST_HZ, self.bounds.highest_Hz))
        speed = _log_uniform(self.rng, _LEAST_SPEED, min(_GREATEST_SPEED, _MARGIN * self.bounds.speed))
        return frequency, max(speed, _LEAST_ACCELERATION / (2.0 * math.pi * frequency))

    def _near(self, loaded: bool) -> tuple[float, float]:
        """Return the same of a sine whose speed at the middle is a few times the Stribeck speed."""
        speed = self.nominal.values["omega_sL" if loaded else "omega_sf"] * _log_uniform(self.rng, *_NEAR_SPEEDS)
        speed = min(speed, _MARGIN * self.bounds.speed)
        acceleration = _log_uniform(self.rng, *_NEAR_ACCELERATIONS)
        frequency = acceleration / (2.0 * math.pi * speed)
        return min(max(frequency, _SLOWEST_HZ), self.bounds.highest_Hz), speed

    def changed(self, count: int) -> list[Part]:
        """Return small changes of excitations that get a share; none where a kind of stage has no excitation."""
        if not self._complete(self.pool):
            return []
        shares = self._shares(self.pool)
        return [self._changed(self.pool[k].part) for k in self.rng.choice(len(shares), count, p=shares)]

    def _changed(self, part: Part) -> Part:
        """Return a small change of an excitation, and now and then the next weight up or down."""
        e, ladder = part.excitation, sorted({*self.bounds.weights, part.excitation.weight})
        ((amplitude, frequency),) = e.tones
        wider, faster = np.exp(_SPREAD * self.rng.standard_normal(2))
        frequency = min(frequency * float(faster), self.bounds.highest_Hz)
        least = max(_LEAST_ANGLE, _LEAST_ACCELERATION / (2.0 * math.pi * frequency) ** 2)
        tone = (max(amplitude * float(wider), least), frequency)
        weight = e.weight
        if self.frames[part.frame].loaded and self.rng.random() < 0.3:
            place = ladder.index(weight) + int(self.rng.choice([-1, 1]))
            weight = ladder[min(max(place, 0), len(ladder) - 1)]
        changed = replace(e, tones=(tone,), weight=weight).lasting(self._trial(part.frame, frequency))
        return replace(part, excitation=changed)

    def designs(self) -> list[Design]:
        """Return the best design, and those without one of its longest excitations, the most promising first."""
        best = self._design(list(self.pool))
        if best is None:
            return []
        found = [best]
        for candidate in self._longest(best[1])[: DESIGNS - 1]:
            without = self._design([c for c in self.pool if c is not candidate])
            found += [without] if without is not None else []
        ranked = sorted((design for design, _ in found), key=lambda d: self.merit(d.promised))
        return ranked

    def _longest(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """Return candidates by their shares of the time, the greatest first."""
        return [chosen[k] for k in np.argsort(-self._shares(chosen), kind="stable")]

    def _design(self, pool: list[Candidate]) -> tuple[Design, list[Candidate]] | None:
        """Return the best design from a pool in which every part is sturdy; None where a kind of stage has none."""
        while self._complete(pool):
            chosen = self._few(pool)
            doubtful = [c for c in chosen if not c.sturdy]
            for candidate in doubtful:
                if not self._sturdy(candidate):
                    pool.remove(candidate)
                    self.pool.remove(candidate)
            if not doubtful:
                return self._timed(chosen), chosen
        return None

    def _complete(self, pool: Sequence[Candidate]) -> bool:
        kinds = {f.loaded for f in self.frames}
        return set(map(self._loaded, pool)) == kinds and (False not in kinds or any(map(self._starts, pool)))

    def _starts(self, candidate: Candidate) -> bool:
        """Return whether an unloaded stage leaves the fall of friction fast enough for identification to start from.

        Within it the equation error takes the acceleration for friction, and where there is little acceleration it
        finds no inertia.
        """
        ((amplitude, frequency),) = candidate.part.excitation.tones
        pace = 2.0 * math.pi * frequency
        leaves = HIGHEST_SHARE * pace * amplitude >= self.nominal.values["omega_sf"]
        return not self._loaded(candidate) and leaves and pace**2 * amplitude >= _STARTING_ACCELERATION

    def _shares(self, pool: Sequence[Candidate]) -> Array:
        return best_shares([c.rate for c in pool], self.target, any(f.loaded for f in self.frames))

    def _few(self, pool: Sequence[Candidate]) -> list[Candidate]:
        """Return a few that do nearly as well as the whole pool: those are left out in turn that are missed least."""
        ranked = [pool[k] for k in np.argsort(-self._shares(pool), kind="stable")]
        chosen = ranked[:_SUPPORT]
        kinds = {f.loaded for f in self.frames}
        lacking = kinds - {self._loaded(c) for c in chosen}
        chosen += [next(c for c in ranked if self._loaded(c) == loaded) for loaded in lacking]
        if not self._complete(chosen):
            chosen.append(next(c for c in ranked if self._starts(c)))
        room = max(len(kinds), min(PARTS, int(sum(f.total for f in self.frames) / LEAST_S)))
        while len(chosen) > room:
            rests = [[c for c in chosen if c is not left] for left in chosen]
            chosen = min((rest for rest in rests if self._complete(rest)), key=self._reached)
        return chosen

    def _loaded(self, candidate: Candidate) -> bool:
        return self.frames[candidate.part.frame].loaded

    def _reached(self, chosen: Sequence[Candidate]) -> float:
        """Return the merit of sharing the whole time among these, pauses and least durations aside."""
        total = sum(f.total for f in self.frames)
        pairs = zip(chosen, self._shares(chosen), strict=True)
        told = [Information(c.rate.normal * float(share) * total) for c, share in pairs]
        return self.merit(pinned(told, any(f.loaded for f in self.frames)))

    def _timed(self, chosen: Sequence[Candidate]) -> Design:
        """Share the whole time among a few excitations, each rounded down to half periods."""
        total = sum(f.total for f in self.frames)
        least = min(LEAST_S, total / len(chosen))
        spans = least + (total - least * len(chosen)) * self._shares(chosen)
        parts: dict[int, Part] = {}
        informations, left = [], 0.0
        # What rounding leaves of the time goes to the next, the longest last.
        for k in np.argsort(spans, kind="stable").tolist():
            part, pause = chosen[k].part, self.frames[chosen[k].part.frame].pause
            room = float(spans[k]) + left
            parts[k] = replace(part, excitation=part.excitation.lasting(room - pause))
            left = room - pause - parts[k].excitation.seconds
            informations.append(Information(chosen[k].rate.normal * (room - left)))
        order = sorted(range(len(parts)), key=lambda k: (parts[k].frame, parts[k].excitation.weight))
        return Design(tuple(parts[k] for k in order), pinned(informations, any(f.loaded for f in self.frames)))

    def _sturdy(self, candidate: Candidate) -> bool:
        """Judge a candidate with other drives; the least information counts; False where one does not bear it."""
        beside = drives(self.nominal)
        rates = [self._rate(candidate.part, replace(self.nominal, stiffness=stiffness)) for stiffness in beside]
        known = [candidate.rate, *(rate for rate in rates if rate is not None)]
        candidate.sturdy = len(known) > len(beside)
        place = NAMES.index(self.target)
        candidate.rate = min(known, key=lambda rate: float(rate.normal[place, place]))
        return candidate.sturdy

    def _trial(self, number: int, frequency: float) -> float:
        return min(max(TRIAL_S, TRIAL_PERIODS / frequency), self.frames[number].present.seconds)

    def _rate(self, part: Part, nominal: Nominal) -> Information | None:
        """Return an excitation's information per second; None where it breaks a limit or says nothing."""
        b = self.bounds
        stage = planned(self.frames[part.frame], part.excitation)
        middle = 0.5 * (b.angle_max + b.angle_min)
        reach = float(np.max(np.abs(stage.command - middle)))
        fastest = float(np.max(np.abs(np.diff(stage.command)))) / nominal.sensors.period
        if reach > 0.5 * _MARGIN * (b.angle_max - b.angle_min) or fastest > _MARGIN * b.speed:
            return None
        self.count += 1
        response = stage_response(stage, nominal)
        if not (
            response.peak_speed < _MARGIN * b.speed
            and response.peak_torque < _MARGIN * b.torque
            and response.peak_following < _FOLLOWING_MARGIN * b.following
        ):
            return None
        found = stage_information(stage, nominal, response)
        return None if found is NOTHING else Information(found.normal / (len(stage.command) * nominal.sensors.period))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
