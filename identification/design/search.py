"""The search for sines and weights, and for their shares of the time, that pin one parameter best together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.design.excitation import Bounds, Excitation, Frame, Part
from identification.design.pinning import (
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
from identification.recording import Array

DESIGNS = 3
"""Designs that are rehearsed beside the present one, at most."""
PARTS = 2
"""Stages that take the place of the unloaded ones, and of the loaded ones, at most."""
TRIAL_S = 10.0
"""Duration of the stage on which an excitation is judged."""
LEAST_S = 4.0
"""Least duration of a proposed stage."""
STIFFNESSES = (0.75, 1.35)
"""Drives, beside the one assumed, that a proposal must bear: their velocity gain over its."""
_MARGIN = 0.85
"""Share of the limits on angle, speed and torque that a proposal may use on the nominal bench."""
_FOLLOWING_MARGIN = 0.5
"""The same for the following error, which rests on the assumed drive loop."""
_SLOWEST_HZ, _FASTEST_HZ = 0.15, 2.5
_LEAST_ACCELERATION, _GREATEST_ACCELERATION = 0.45, 15.0
"""Of a random sine at its ends, rad/s^2. The less it is the longer the shaft is near rest; below, it creeps."""
_LEAST_ANGLE = math.radians(0.6)
"""Least amplitude: smaller swings rest on what no nominal model knows (play, presliding)."""
_USELESS = 0.1
"""Relative half width beyond which another parameter's interval counts against a design."""
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


def merit(pins: Pinned, target: str) -> float:
    """Return the target's relative half width, more where another parameter's is beyond use; the less the better."""
    return pins.half_widths[target] * max(1.0, pins.worst / max(_USELESS, pins.half_widths[target]))


@dataclass
class Search:
    """Simulates excitations, keeps those within the limits, and shares the time among them."""

    frames: Sequence[Frame]
    nominal: Nominal
    bounds: Bounds
    rng: np.random.Generator
    target: str
    pool: list[Candidate] = field(default_factory=list)
    count: int = 0

    def add(self, part: Part | None) -> None:
        """Judge an excitation on a short stage and keep it where it says anything."""
        rate = None if part is None else self._rate(part, self.nominal)
        if part is not None and rate is not None:
            self.pool.append(Candidate(part, rate))

    def random(self, loaded: bool) -> Part:
        """Return a sine, logarithmically uniform in frequency and acceleration, under one of the weights."""
        b, rng = self.bounds, self.rng
        number = [f.loaded for f in self.frames].index(loaded)
        frequency = _log_uniform(rng, _SLOWEST_HZ, min(_FASTEST_HZ, b.highest_Hz))
        acceleration = _log_uniform(rng, _LEAST_ACCELERATION, _GREATEST_ACCELERATION)
        pace = 2.0 * math.pi * frequency
        reach = 0.5 * _MARGIN * (b.angle_max - b.angle_min)
        amplitude = max(min(reach, acceleration / pace**2, _MARGIN * b.speed / pace), _LEAST_ANGLE)
        # Friction rises with the weight, and so does what is seen of the load's: half of all are the heaviest.
        heaviest = max(b.weights) if rng.random() < 0.5 else float(rng.choice(b.weights))
        found = Excitation(((amplitude, frequency),), heaviest if loaded else 0.0, 0.0)
        return Part(number, found.lasting(self._trial(number)))

    def changed(self) -> Part | None:
        """Return a small change of an excitation that gets a share, and now and then the next weight up or down."""
        if not self._complete(self.pool):
            return None
        shares = self._shares(self.pool)
        part = self.pool[int(self.rng.choice(len(shares), p=shares))].part
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
        changed = replace(e, tones=(tone,), weight=weight).lasting(self._trial(part.frame))
        return replace(part, excitation=changed)

    def designs(self) -> list[Design]:
        """Return the best design, and those that do without one of its excitations, the most promising first."""
        best = self._design(list(self.pool))
        if best is None:
            return []
        found = [best]
        for candidate in best[1]:
            without = self._design([c for c in self.pool if c is not candidate])
            found += [without] if without is not None else []
        ranked = sorted((design for design, _ in found), key=lambda d: merit(d.promised, self.target))
        return ranked[:DESIGNS]

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
        return {self.frames[c.part.frame].loaded for c in pool} == {f.loaded for f in self.frames}

    def _shares(self, pool: Sequence[Candidate]) -> Array:
        return best_shares([c.rate for c in pool], self.target, any(f.loaded for f in self.frames))

    def _few(self, pool: Sequence[Candidate]) -> list[Candidate]:
        """Return those with the greatest shares, a few of each kind."""
        ranked = [pool[k] for k in np.argsort(-self._shares(pool), kind="stable")]
        room = max(1, int(sum(f.total for f in self.frames) / LEAST_S / len({f.loaded for f in self.frames})))
        out = []
        for loaded in sorted({f.loaded for f in self.frames}):
            out += [c for c in ranked if self.frames[c.part.frame].loaded == loaded][: min(PARTS, room)]
        return out

    def _timed(self, chosen: Sequence[Candidate]) -> Design:
        """Share the whole time among a few excitations, each rounded down to half periods."""
        total = sum(f.total for f in self.frames)
        least = min(LEAST_S, total / len(chosen))
        spans = least + (total - least * len(chosen)) * self._shares(chosen)
        parts, informations = [], []
        for candidate, span in zip(chosen, spans, strict=True):
            part = candidate.part
            seconds = float(span) - self.frames[part.frame].pause
            parts.append(replace(part, excitation=part.excitation.lasting(seconds)))
            informations.append(Information(candidate.rate.normal * float(span)))
        order = sorted(range(len(parts)), key=lambda k: (parts[k].frame, parts[k].excitation.weight))
        return Design(tuple(parts[k] for k in order), pinned(informations, any(f.loaded for f in self.frames)))

    def _sturdy(self, candidate: Candidate) -> bool:
        """Judge a candidate with other drives; its information becomes the mean; False where one does not bear it."""
        rates = [self._rate(candidate.part, replace(self.nominal, stiffness=stiffness)) for stiffness in STIFFNESSES]
        known = [rate for rate in rates if rate is not None]
        candidate.sturdy = len(known) == len(rates)
        candidate.rate = Information(np.mean([r.normal for r in (candidate.rate, *known)], axis=0))
        return candidate.sturdy

    def _trial(self, number: int) -> float:
        return min(TRIAL_S, self.frames[number].present.seconds)

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
