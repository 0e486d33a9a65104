"""The search for sines, ramps and weights, and for their shares of the time, that pin one parameter best together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.design.excitation import Bounds, Excitation, Frame, Part, Ramps, Tone
from identification.design.pinning import NOTHING, Information, Pinned, heard, pinned, stage_information
from identification.design.shares import shared
from identification.design.simulated import Nominal, PlannedStage, stage_response
from identification.estimate.regression import HIGHEST_SHARE
from identification.recording import Array

DESIGNS = 8
"""Designs that are judged as wholes, at most."""
PARTS = 7
"""Stages of a design, at most."""
_SUPPORT = 12
"""Excitations with the greatest shares, of which a design's are chosen."""
TRIAL_S, TRIAL_PERIODS = 5.0, 3.0
"""Least duration of the stage on which an excitation is judged, s and its periods."""
LEAST_S = 3.0
"""Least duration of a proposed stage."""
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
_RAMPS = 0.3
"""Share of ramps among the excitations that are drawn."""
_RAMP_SPEEDS, _RAMP_TIMES = (1.6, 5.0), (0.5, 1.25)
"""Their speeds over the Stribeck speed, and times to the far end, s. Where friction falls faster than the drive's
velocity gain can hold, the shaft sticks and slips; just beyond, every sample tells of the fall."""
_SPREAD, _RAMP_SPREAD = 0.2, 0.06
"""Standard deviation of the logarithm of a refinement's change; and of a ramp's speed."""


@dataclass(eq=False)
class Candidate:
    """An excitation on a short stage, and its information per second."""

    part: Part
    rate: Information


@dataclass(frozen=True)
class Design:
    """Stages that together take the whole time, and what their information promises."""

    parts: tuple[Part, ...]
    promised: Pinned


def planned(frame: Frame, excitation: Excitation) -> PlannedStage:
    """Return the commands and weight of one stage."""
    return PlannedStage(frame.render(excitation), excitation.weight)


def promised(frames: Sequence[Frame], parts: Sequence[Part], nominals: Sequence[Nominal], target: str) -> Pinned:
    """Return what stages that stand as they are pin, by their information."""
    told = [stage_information(planned(frames[p.frame], p.excitation), nominals) for p in parts]
    loaded = any(f.loaded for f in frames)
    return pinned(heard(told, target, loaded), loaded)


def halved(design: Design, frames: Sequence[Frame], nominals: Sequence[Nominal], target: str) -> Design:
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
            if room >= excitation.shortest:
                parts.append(Part(number, excitation.lasting(room)))
                left = room - parts[-1].excitation.seconds
    return Design(tuple(parts), promised(frames, parts, nominals, target))


@dataclass
class Search:
    """Simulates excitations, keeps those within the limits, and shares the time among them."""

    frames: Sequence[Frame]
    nominals: Sequence[Nominal]
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
        rate = self._rate(part)
        if rate is not None:
            self.pool.append(Candidate(part, rate))

    def random(self, loaded: bool) -> Part:
        """Return a sine or ramps under one of the weights: of any speed, or about where friction falls."""
        b, rng = self.bounds, self.rng
        number = [f.loaded for f in self.frames].index(loaded)
        # Friction rises with the weight, and so does what fast sines show of the load's; under the lighter ones the
        # drive holds the shaft where friction falls.
        weight = max(b.weights) if rng.random() < _HEAVIEST else float(rng.choice(b.weights))
        found = self._ramps(number) if rng.random() < _RAMPS else self._sine(number)
        return Part(number, self._tried(number, replace(found, weight=weight if loaded else 0.0)))

    def _sine(self, number: int) -> Excitation:
        """Return a sine of any speed and frequency, or about where friction falls."""
        near = self.rng.random() < _NEAR
        frequency, speed = self._near(self.frames[number].loaded) if near else self._any()
        pace = 2.0 * math.pi * frequency
        return Excitation(((max(min(self._reach, speed / pace), _LEAST_ANGLE), frequency),), 0.0, 0.0)

    def _ramps(self, number: int) -> Excitation:
        """Return ramps about the least speed at which the drive holds the shaft while friction falls."""
        speed = self._stribeck(self.frames[number].loaded) * _log_uniform(self.rng, *_RAMP_SPEEDS)
        speed = min(speed, _MARGIN * self.bounds.speed)
        return self._away(number, speed, _log_uniform(self.rng, *_RAMP_TIMES))

    def _away(self, number: int, speed: float, seconds: float) -> Excitation:
        """Return ramps at a speed, as long as wanted and as angle and time allow."""
        slot = self._total / self._room - self.frames[number].pause
        longest = min(_RAMP_TIMES[1], self._reach / speed, 0.25 * slot)  # the least of them is twice there and back
        away = math.floor(100.0 * min(max(seconds, _RAMP_TIMES[0]), longest)) / 100.0
        return Excitation((), 0.0, 0.0, Ramps(speed, max(away, 0.01)))

    @property
    def _total(self) -> float:
        """Time of all stages, s."""
        return sum(f.total for f in self.frames)

    @property
    def _room(self) -> int:
        """Stages that a design may have."""
        return max(len({f.loaded for f in self.frames}), min(PARTS, int(self._total / LEAST_S)))

    @property
    def _reach(self) -> float:
        """The greatest amplitude, rad."""
        return 0.5 * _MARGIN * (self.bounds.angle_max - self.bounds.angle_min)

    def _stribeck(self, loaded: bool) -> float:
        return self.nominals[0].values["omega_sL" if loaded else "omega_sf"]

    def _any(self) -> tuple[float, float]:
        """Return a frequency, Hz, and a speed at the middle, rad/s, logarithmically uniform."""
        frequency = _log_uniform(self.rng, _SLOWEST_HZ, min(_FASTEST_HZ, self.bounds.highest_Hz))
        speed = _log_uniform(self.rng, _LEAST_SPEED, min(_GREATEST_SPEED, _MARGIN * self.bounds.speed))
        return frequency, max(speed, _LEAST_ACCELERATION / (2.0 * math.pi * frequency))

    def _near(self, loaded: bool) -> tuple[float, float]:
        """Return the same of a sine whose speed at the middle is a few times the Stribeck speed."""
        speed = self._stribeck(loaded) * _log_uniform(self.rng, *_NEAR_SPEEDS)
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
        weight = e.weight
        changed = self._other_ramps(part.frame, e.ramps) if e.ramps else self._other_sine(e.tones[0])
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
        """Return the best design from a pool, and its excitations; None where a kind of stage has none."""
        if not self._complete(pool):
            return None
        chosen = self._few(pool)
        return self._timed(chosen), chosen

    def _complete(self, pool: Sequence[Candidate]) -> bool:
        kinds = {f.loaded for f in self.frames}
        return set(map(self._loaded, pool)) == kinds and (False not in kinds or any(map(self._starts, pool)))

    def _starts(self, candidate: Candidate) -> bool:
        """Return whether an unloaded stage leaves the fall of friction fast enough for identification to start from.

        Within it the equation error takes the acceleration for friction, and where there is little acceleration it
        finds no inertia.
        """
        if not candidate.part.excitation.tones:
            return False
        ((amplitude, frequency),) = candidate.part.excitation.tones
        pace = 2.0 * math.pi * frequency
        leaves = HIGHEST_SHARE * pace * amplitude >= self.nominals[0].values["omega_sf"]
        return not self._loaded(candidate) and leaves and pace**2 * amplitude >= _STARTING_ACCELERATION

    def _shared(self, pool: Sequence[Candidate]) -> tuple[Array, list[Information]]:
        return shared([c.rate for c in pool], self.target, any(f.loaded for f in self.frames))

    def _shares(self, pool: Sequence[Candidate]) -> Array:
        return self._shared(pool)[0]

    def _few(self, pool: Sequence[Candidate]) -> list[Candidate]:
        """Return a few that do nearly as well as the whole pool: those are left out in turn that are missed least."""
        ranked = [pool[k] for k in np.argsort(-self._shares(pool), kind="stable")]
        chosen = ranked[:_SUPPORT]
        kinds = {f.loaded for f in self.frames}
        lacking = kinds - {self._loaded(c) for c in chosen}
        chosen += [next(c for c in ranked if self._loaded(c) == loaded) for loaded in lacking]
        if not self._complete(chosen):
            chosen.append(next(c for c in ranked if self._starts(c)))
        while len(chosen) > self._room:
            rests = [[c for c in chosen if c is not left] for left in chosen]
            chosen = min((rest for rest in rests if self._complete(rest)), key=self._reached)
        return chosen

    def _loaded(self, candidate: Candidate) -> bool:
        return self.frames[candidate.part.frame].loaded

    def _reached(self, chosen: Sequence[Candidate]) -> float:
        """Return the merit of sharing the whole time among these, pauses and least durations aside."""
        total = self._total
        told = [i.times(float(share) * total) for share, i in zip(*self._shared(chosen), strict=True)]
        return self.merit(pinned(told, any(f.loaded for f in self.frames)))

    def _timed(self, chosen: Sequence[Candidate]) -> Design:
        """Share the whole time among a few excitations, each rounded down to half periods."""
        total = self._total
        pauses = [self.frames[c.part.frame].pause for c in chosen]
        shortest = [c.part.excitation.shortest + pause for c, pause in zip(chosen, pauses, strict=True)]
        least = np.maximum(min(LEAST_S, total / len(chosen)), shortest)
        shares, counts = self._shared(chosen)
        spans = least + (total - np.sum(least)) * shares
        parts: dict[int, Part] = {}
        informations, left = [], 0.0
        # What rounding leaves of the time goes to the next, the longest last.
        for k in np.argsort(spans, kind="stable").tolist():
            part, pause = chosen[k].part, self.frames[chosen[k].part.frame].pause
            room = float(spans[k]) + left
            parts[k] = replace(part, excitation=part.excitation.lasting(room - pause))
            left = room - pause - parts[k].excitation.seconds
            informations.append(counts[k].times(room - left))
        order = sorted(range(len(parts)), key=lambda k: (parts[k].frame, parts[k].excitation.weight))
        return Design(tuple(parts[k] for k in order), pinned(informations, any(f.loaded for f in self.frames)))

    def _tried(self, number: int, e: Excitation) -> Excitation:
        """Return an excitation of the duration for which it is judged."""
        period = e.step if e.ramps else 2.0 * e.step
        return e.lasting(min(max(TRIAL_S, TRIAL_PERIODS * period), self.frames[number].present.seconds))

    def _rate(self, part: Part) -> Information | None:
        """Return an excitation's information per second; None where it breaks a limit or says nothing."""
        b, period = self.bounds, self.nominals[0].sensors.period
        stage = planned(self.frames[part.frame], part.excitation)
        middle = 0.5 * (b.angle_max + b.angle_min)
        reach = float(np.max(np.abs(stage.command - middle)))
        fastest = float(np.max(np.abs(np.diff(stage.command)))) / period
        if reach > 0.5 * _MARGIN * (b.angle_max - b.angle_min) or fastest > _MARGIN * b.speed:
            return None
        self.count += 1
        if not all(self._bears(stage, nominal) for nominal in self.nominals):
            return None
        found = stage_information(stage, self.nominals)
        return None if found is NOTHING else found.times(1.0 / (len(stage.command) * period))

    def _bears(self, stage: PlannedStage, nominal: Nominal) -> bool:
        """Return whether a drive stays within the limits, by a margin."""
        b, response = self.bounds, stage_response(stage, nominal)
        return (
            response.peak_speed < _MARGIN * b.speed
            and response.peak_torque < _MARGIN * b.torque
            and response.peak_following < _FOLLOWING_MARGIN * b.following
        )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
