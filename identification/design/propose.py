"""Which excitation, within a bench's limits and in the same time, would pin the weakest parameter best.

Informations of stages add, so each stage gets a list of candidates that are judged once; stages then exchange their
candidate for a better one in turn until none is better (Fedorov, Theory of Optimal Experiments, 1972, ch. 3). The best
is refined by small random changes. What is minimised is the relative interval of the parameter that the present
excitation pins worst, as long as no other becomes useless by it. In the end the best few designs are rehearsed, and the
rehearsal decides.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.design.pinning import (
    Information,
    Nominal,
    Pinned,
    PlannedStage,
    pinned,
    stage_information,
    stage_response,
)
from identification.design.rehearsal import rehearse
from identification.recording import Array

CANDIDATES = 60
"""Random excitations judged per stage."""
REFINEMENTS = 40
"""Small changes tried per stage afterwards."""
RUNNERS_UP = 4
"""Designs per stage that are rehearsed beside the best."""
REHEARSALS = 1
"""Runs per rehearsal, with noise of their own; the worst counts."""
_MARGIN = 0.85
"""Share of the limits on angle, speed and torque that a proposal may use on the nominal bench."""
_FOLLOWING_MARGIN = 0.5
"""The same for the following error, which rests on the assumed drive loop."""
_SLOWEST_HZ, _FASTEST_HZ = 0.05, 5.0
_SLOWEST_SPEED = 0.04
"""Least peak speed of a random sine, over the speed limit: slower ones creep."""
_LEAST_ANGLE = math.radians(1.0)
"""Least amplitude: smaller swings rest on what no nominal model knows (play, presliding)."""
_USELESS = 0.1
"""Relative half width beyond which another parameter's interval counts against a design."""
_SPREAD = 0.25
"""Standard deviation of the logarithm of a refinement's change."""

Tone = tuple[float, float]
"""Amplitude, rad, and frequency, Hz."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Excitation:
    """Sines about a centre, and the weight on the lever, kg."""

    tones: tuple[Tone, ...]
    weight: float


@dataclass(frozen=True)
class Frame:
    """What stays of a stage: whether it is loaded, what is commanded now, and how a command becomes joint angles."""

    loaded: bool
    present: Excitation
    render: Callable[[Excitation], Array]


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


@dataclass(frozen=True)
class Proposal:
    """What the present excitation pins, what is proposed instead, and what that would pin.

    Attributes:
        weakest: The parameter that is to be pinned better.
        present: By the rehearsal of the present excitation.
        stages: The proposal; the present excitation where nothing better was found.
        pinned: By its rehearsal.
        promised: By its Fisher information.
        judged: Excitations simulated.
        rehearsed: Whole experiments rehearsed.
    """

    weakest: str
    present: Pinned
    stages: tuple[Excitation, ...]
    pinned: Pinned
    promised: Pinned
    judged: int
    rehearsed: int


@dataclass(frozen=True)
class _Judged:
    excitation: Excitation
    information: Information


def present_pins(frames: Sequence[Frame], nominal: Nominal) -> Pinned:
    """Return what the excitation of these stages pins as it stands."""
    found = [stage_information(PlannedStage(f.render(f.present), f.present.weight), nominal) for f in frames]
    return pinned(found, any(f.loaded for f in frames))


def propose(
    frames: Sequence[Frame],
    nominal: Nominal,
    bounds: Bounds,
    rng: np.random.Generator,
    progress: Progress | None = None,
    weakest: str | None = None,
) -> Proposal:
    """Search for the excitation that narrows one parameter's relative interval most.

    Args:
        frames: The stages; number, duration and load state of each stay.
        nominal: The model.
        bounds: Limits of the bench.
        rng: Source of all randomness.
        progress: Called with what is done and its share.
        weakest: That parameter; None for the one that a rehearsal of the present excitation pins worst.
    """
    tell = progress or (lambda _label, _share: None)
    judge = _Judge(nominal, bounds)
    present_pinned = _rehearsed([PlannedStage(f.render(f.present), f.present.weight) for f in frames], nominal, 0)
    target = weakest or present_pinned.weakest
    lists: list[list[_Judged]] = []
    for number, frame in enumerate(frames):
        present = judge.of(frame, frame.present, within=False)
        lists.append([] if present is None else [present])
        for k in range(CANDIDATES):
            found = judge.of(frame, _random(frame, bounds, rng))
            lists[-1] += [] if found is None else [found]
            tell("candidates", (number + (k + 1) / CANDIDATES) / len(frames))
    present_choice = [each[0] for each in lists]
    choice = _exchange(present_choice, lists, target)
    designs = [present_choice, choice]
    for k in range(REFINEMENTS):
        for number, frame in enumerate(frames):
            found = judge.of(frame, _changed(choice[number].excitation, frame, bounds, rng))
            if found is not None:
                choice = _exchange(choice, [[found] if j == number else [] for j in range(len(frames))], target)
        tell("refinement", (k + 1) / REFINEMENTS)
    designs += [choice, *_others(present_choice, choice, lists, target)]
    rehearsed = [present_pinned]
    for k, design in enumerate(designs[1:], 1):
        planned = [
            PlannedStage(f.render(c.excitation), c.excitation.weight) for f, c in zip(frames, design, strict=True)
        ]
        rehearsed.append(_rehearsed(planned, nominal, k))
        tell("rehearsal", k / (len(designs) - 1))
    best = min(range(len(designs)), key=lambda k: _merit(rehearsed[k], target))
    return Proposal(
        weakest=target,
        present=rehearsed[0],
        stages=tuple(c.excitation for c in designs[best]),
        pinned=rehearsed[best],
        promised=_pins(designs[best]),
        judged=judge.count,
        rehearsed=len(designs),
    )


def _others(
    present: Sequence[_Judged], choice: Sequence[_Judged], lists: Sequence[Sequence[_Judged]], target: str
) -> list[list[_Judged]]:
    """Return the designs that come next: for each stage alone, the best few candidates in place of the chosen one."""
    out = []
    for number, candidates in enumerate(lists):
        designs = [[*choice[:number], c, *choice[number + 1 :]] for c in candidates if c is not present[number]]
        out += sorted(designs, key=lambda design: _loss(design, target))[:RUNNERS_UP]
    return out


def _rehearsed(planned: Sequence[PlannedStage], nominal: Nominal, number: int) -> Pinned:
    """Return the worst of the rehearsals of one design."""
    runs = [rehearse(planned, nominal, np.random.default_rng((seed, number))) for seed in range(REHEARSALS)]
    return max(runs, key=lambda pins: pins.worst)


def _exchange(choice: list[_Judged], lists: Sequence[Sequence[_Judged]], target: str) -> list[_Judged]:
    """Exchange one stage's candidate at a time as long as that narrows the target's interval."""
    best = _loss(choice, target)
    improved = True
    while improved:
        improved = False
        for number, candidates in enumerate(lists):
            for candidate in candidates:
                trial = [*choice[:number], candidate, *choice[number + 1 :]]
                loss = _loss(trial, target)
                if loss < best:
                    choice, best, improved = trial, loss, True
    return choice


def _pins(choice: Sequence[_Judged]) -> Pinned:
    return pinned([c.information for c in choice], any(c.excitation.weight > 0.0 for c in choice))


def _merit(pins: Pinned, target: str) -> float:
    """Return the target's relative half width, more where another parameter's is beyond use; the less the better."""
    return pins.half_widths[target] * max(1.0, pins.worst / max(_USELESS, pins.half_widths[target]))


def _loss(choice: Sequence[_Judged], target: str) -> tuple[float, float]:
    """Return the merit, and the sum of the intervals that are finite, which decides where it is equal."""
    pins = _pins(choice)
    return _merit(pins, target), sum(w if math.isfinite(w) else 1e3 for w in pins.half_widths.values())


@dataclass
class _Judge:
    """Simulates excitations and keeps those within the limits."""

    nominal: Nominal
    bounds: Bounds
    count: int = 0

    def of(self, frame: Frame, excitation: Excitation, within: bool = True) -> _Judged | None:
        """Return an excitation with its information, or None where it breaks a limit (``within``)."""
        b = self.bounds
        stage = PlannedStage(frame.render(excitation), excitation.weight)
        if within:
            middle = 0.5 * (b.angle_max + b.angle_min)
            reach = float(np.max(np.abs(stage.command - middle)))
            fastest = float(np.max(np.abs(np.diff(stage.command)))) / self.nominal.sensors.period
            if reach > 0.5 * _MARGIN * (b.angle_max - b.angle_min) or fastest > _MARGIN * b.speed:
                return None
        self.count += 1
        response = stage_response(stage, self.nominal)
        if within and not (
            response.peak_speed < _MARGIN * b.speed
            and response.peak_torque < _MARGIN * b.torque
            and response.peak_following < _FOLLOWING_MARGIN * b.following
        ):
            return None
        return _Judged(excitation, stage_information(stage, self.nominal, response))


def _random(frame: Frame, bounds: Bounds, rng: np.random.Generator) -> Excitation:
    """Return one or two sines, logarithmically uniform in frequency and peak speed, under one of the weights."""
    reach = 0.5 * _MARGIN * (bounds.angle_max - bounds.angle_min)
    tones: list[Tone] = []
    for _ in range(int(rng.integers(1, 3))):
        frequency = float(np.exp(rng.uniform(np.log(_SLOWEST_HZ), np.log(min(_FASTEST_HZ, bounds.highest_Hz)))))
        speed = bounds.speed * float(np.exp(rng.uniform(np.log(_SLOWEST_SPEED), np.log(_MARGIN))))
        tones.append((max(min(reach, speed / (2.0 * math.pi * frequency)), _LEAST_ANGLE), frequency))
    weight = float(rng.choice(bounds.weights)) if frame.loaded else 0.0
    return Excitation(tuple(tones), weight)


def _changed(excitation: Excitation, frame: Frame, bounds: Bounds, rng: np.random.Generator) -> Excitation:
    """Return a small change of amplitudes and frequencies, and now and then the next weight up or down."""
    factors = np.exp(_SPREAD * rng.standard_normal((len(excitation.tones), 2)))
    tones = tuple(
        (max(a * float(wider), _LEAST_ANGLE), min(f * float(faster), bounds.highest_Hz))
        for (a, f), (wider, faster) in zip(excitation.tones, factors, strict=True)
    )
    weight = excitation.weight
    if frame.loaded and rng.random() < 0.5:
        ladder = sorted({*bounds.weights, weight})
        place = ladder.index(weight) + int(rng.choice([-1, 1]))
        weight = ladder[min(max(place, 0), len(ladder) - 1)]
    return dataclasses.replace(excitation, tones=tones, weight=weight)
