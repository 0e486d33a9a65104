"""Which excitation, within a bench's limits and in the same time, would pin the weakest parameter best.

Informations of stages add, so each stage gets a list of candidates that are judged once; stages then exchange their
candidate for a better one in turn until none is better (Fedorov, Theory of Optimal Experiments, 1972, ch. 3). The best
is refined by small random changes. What is minimised is the greatest relative interval of the nine (a minimax design).
In the end the best few designs are rehearsed, and the rehearsal decides.
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
_SLOWEST_HZ, _FASTEST_HZ = 0.1, 5.0
_SLOWEST_SPEED = 0.04
"""Least peak speed of a random sine, over the speed limit: slower ones creep."""
_LEAST_ANGLE = math.radians(1.0)
"""Least amplitude: smaller swings rest on what no nominal model knows (play, presliding)."""
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
        present: By the rehearsal of the present excitation.
        stages: The proposal; the present excitation where nothing better was found.
        pinned: By its rehearsal.
        promised: By its Fisher information.
        judged: Excitations simulated.
        rehearsed: Whole experiments rehearsed.
    """

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
) -> Proposal:
    """Search for the excitation that narrows the widest relative interval most.

    Args:
        frames: The stages; number, duration and load state of each stay.
        nominal: The model.
        bounds: Limits of the bench.
        rng: Source of all randomness.
        progress: Called with what is done and its share.
    """
    tell = progress or (lambda _label, _share: None)
    judge = _Judge(nominal, bounds)
    lists: list[list[_Judged]] = []
    for number, frame in enumerate(frames):
        present = judge.of(frame, frame.present, within=False)
        lists.append([] if present is None else [present])
        for k in range(CANDIDATES):
            found = judge.of(frame, _random(frame, bounds, rng))
            lists[-1] += [] if found is None else [found]
            tell("candidates", (number + (k + 1) / CANDIDATES) / len(frames))
    present_choice = [each[0] for each in lists]
    choice = _exchange(present_choice, lists)
    designs = [present_choice, choice]
    for k in range(REFINEMENTS):
        for number, frame in enumerate(frames):
            found = judge.of(frame, _changed(choice[number].excitation, frame, bounds, rng))
            if found is not None:
                choice = _exchange(choice, [[found] if j == number else [] for j in range(len(frames))])
        tell("refinement", (k + 1) / REFINEMENTS)
    designs += [choice, *_others(present_choice, choice, lists)]
    rehearsed: list[Pinned] = []
    for k, design in enumerate(designs):
        planned = [
            PlannedStage(f.render(c.excitation), c.excitation.weight) for f, c in zip(frames, design, strict=True)
        ]
        runs = [rehearse(planned, nominal, np.random.default_rng((seed, k))) for seed in range(REHEARSALS)]
        rehearsed.append(max(runs, key=lambda pins: pins.worst))
        tell("rehearsal", (k + 1) / len(designs))
    best = min(range(len(designs)), key=lambda k: rehearsed[k].worst)
    return Proposal(
        present=rehearsed[0],
        stages=tuple(c.excitation for c in designs[best]),
        pinned=rehearsed[best],
        promised=_pins(designs[best]),
        judged=judge.count,
        rehearsed=len(designs),
    )


def _others(
    present: Sequence[_Judged], choice: Sequence[_Judged], lists: Sequence[Sequence[_Judged]]
) -> list[list[_Judged]]:
    """Return the designs that come next: for each stage alone, the best few candidates in place of the chosen one."""
    out = []
    for number, candidates in enumerate(lists):
        designs = [[*choice[:number], c, *choice[number + 1 :]] for c in candidates if c is not present[number]]
        out += sorted(designs, key=_loss)[:RUNNERS_UP]
    return out


def _exchange(choice: list[_Judged], lists: Sequence[Sequence[_Judged]]) -> list[_Judged]:
    """Exchange one stage's candidate at a time as long as that narrows the widest interval."""
    best = _loss(choice)
    improved = True
    while improved:
        improved = False
        for number, candidates in enumerate(lists):
            for candidate in candidates:
                trial = [*choice[:number], candidate, *choice[number + 1 :]]
                loss = _loss(trial)
                if loss < best:
                    choice, best, improved = trial, loss, True
    return choice


def _pins(choice: Sequence[_Judged]) -> Pinned:
    return pinned([c.information for c in choice], any(c.excitation.weight > 0.0 for c in choice))


def _loss(choice: Sequence[_Judged]) -> tuple[float, float]:
    """Return the widest relative interval, and the sum of those that are finite, which decides where it is equal."""
    widths = _pins(choice).half_widths.values()
    return max(widths), sum(w if math.isfinite(w) else 1e3 for w in widths)


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
