"""Chooses the next experiment: the parts, simulated under the likeliest hypotheses, whose sum
lowers the bound of the error probability most per minute of the bench.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import NamedTuple

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from identification.design.separation import (
    REJECTED,
    Evidence,
    Hypothesis,
    Pair,
    Weighed,
    error_bound,
    evidence,
    experiment_views,
    information,
    present,
    separations,
    visibility,
)
from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Separation, title
from identification.recording import RecordingError
from identification.views.view import LEAST_REST_S, View
from rig.common.errors import InputError
from rig.config.bench import LimitsSection
from rig.config.configuration import Document
from rig.config.sequence import Sequence as Stages
from rig.investigate.experiments import (
    Part,
    SimulatedBench,
    as_document,
    bench_seconds,
    family,
    weight_changes,
)

MOST_HYPOTHESES = 4
"""Greatest number of hypotheses that are simulated, the most likely ones."""
WORTH_WHILE = 1.0
"""Least separation of an experiment, in standard errors, of one pair at least."""
TARGET_BOUND = 1e-3
"""Bound of the error probability below which a further decrease has no worth."""
OF_CONSTANTS = 0.01
"""Worth of a nat of information on the constants, over that of a factor e of the error bound."""
MOST_PARTS = 4
MOST_VISIBLE, TINY = math.log(100.0), 1e-30
"""Greatest worth of the visibility of one effect that the recordings so far hardly show; least
visibility.
"""
TRAVEL_REGIONS, SLOWEST, VISIT_S = 16, 2.0**-8, 0.05
"""Number of regions of the permitted travel, least speed of a region over the speed limit, and
least time in a region, s.
"""
Region = tuple[str, int | None, float, float]
"""Coordinate, load, direction, and place of a range that a recording visits."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Proposal:
    """The next experiment.

    Attributes:
        purpose: ``separate`` hypotheses, ``cover`` what no recording has shown, or ``repeat``.
        sequence: The sequence.
        reason: One sentence with numbers.
        seconds: Time of the bench and its operator, s.
        weight_changes: How often a weight is hung or taken off.
        apart: Pair of hypotheses to the expected preference, standard errors.
        refused: Part to the limit that a hypothesis would come too near to.
        repeats: Run that is repeated, or empty.
    """

    purpose: str
    sequence: Document[Stages]
    reason: str
    seconds: float
    weight_changes: int
    apart: Mapping[tuple[str, str], float]
    refused: Mapping[str, str]
    repeats: str = ""


class Choice(NamedTuple):
    """The next experiment, or None if none is worth while, and what no experiment separates: pair
    to the expected preference, standard errors, of all parts together, if it is below
    :data:`WORTH_WHILE`.
    """

    proposal: Proposal | None
    indistinct: Mapping[tuple[str, str], float]
    late: bool = False  # whether the time is too short for a part


class _Judged(NamedTuple):
    """A part that no hypothesis brings too near to a limit, with what it would show, and the
    regions that it visits.
    """

    part: Part
    evidence: Mapping[Pair, Evidence]
    regions: frozenset[Region]


@dataclass(frozen=True)
class _Design:
    """Simulated hypotheses, and the parts to choose from."""

    bench: SimulatedBench
    hypotheses: Sequence[Hypothesis]
    cover: bool
    before: Sequence[Evidence]
    judged: Sequence[_Judged]
    refused: Mapping[str, str]
    visited: frozenset[Region]
    lost: frozenset[Pair] = frozenset()

    def added(self, chosen: Sequence[_Judged]) -> dict[Pair, Evidence]:
        """Return what several parts show together."""
        return {
            pair: reduce(add, (one.evidence[pair] for one in chosen)) for pair in chosen[0].evidence
        }

    def apart(self, chosen: Sequence[_Judged]) -> dict[Pair, float]:
        """Return how far an experiment separates each pair that some experiment separates."""
        found = separations(self.before, self.added(chosen))
        return {pair: z for pair, z in found.items() if pair not in self.lost}

    def shown(self, chosen: Sequence[_Judged]) -> np.ndarray:
        """Return the visibility of each effect with an experiment, over that without it."""
        after = visibility(self.before[0] + self.added(chosen)[0, 0])
        return np.asarray(np.maximum(after, TINY) / np.maximum(visibility(self.before[0]), TINY))

    def new(self, chosen: Sequence[_Judged]) -> frozenset[Region]:
        """Return the regions that an experiment visits and no recording so far has visited."""
        return frozenset[Region]().union(*(one.regions for one in chosen)) - self.visited

    def _covered(self, chosen: Sequence[_Judged]) -> tuple[float, float, float]:
        """Return gains: of the visibility of the catalogue's effects, of regions, of information on
        the constants.
        """
        gains = np.clip(np.log(self.shown(chosen)), 0.0, MOST_VISIBLE)
        told = information(self.before[0], self.added(chosen)[0, 0])
        return float(np.sum(gains)), float(len(self.new(chosen))), told

    @cached_property
    def _attainable(self) -> tuple[float, float, float]:
        return self._covered(self.judged)

    def worth(self, chosen: Sequence[_Judged]) -> float:
        """Return the worth of an experiment: in factors e of the error bound, or, to cover, as a
        share of what all parts together would show, of the catalogue and of regions alike.
        """
        if self.cover:
            pairs = zip(self._covered(chosen), self._attainable, strict=True)
            effects, regions, constants = (own / most if most > 0.0 else 0.0 for own, most in pairs)
            return effects + regions + OF_CONSTANTS * constants
        constants = OF_CONSTANTS * information(self.before[0], self.added(chosen)[0, 0])
        odds = [h.weight for h in self.hypotheses]
        apart = self.apart(chosen)
        now, then = (
            max(error_bound(odds, z) / sum(odds), TARGET_BOUND)
            for z in (dict.fromkeys(apart, 0.0), apart)
        )
        return math.log(now / then) + constants

    def seconds(self, chosen: Sequence[_Judged]) -> float:
        """Return the time of the bench that an experiment takes, s."""
        return bench_seconds(self.bench.plan(as_document("x", [c.part for c in chosen]), ()))


def propose(
    bench: SimulatedBench,
    weighed: Weighed,
    bandwidth_Hz: float,
    seed: int,
    number: int,
    progress: Progress,
    most_s: float = math.inf,
    avoided: Collection[str] = (),
    cover: bool = False,
    given_up: Collection[str] = (),
) -> Choice:
    """Return the experiment that separates the open hypotheses or, with ``cover``, one that shows
    what no recording has shown.

    Args:
        bench: The bench.
        weighed: Hypotheses of the recordings so far.
        bandwidth_Hz: Bandwidth of the diagnosis.
        seed: Seed of the investigation.
        number: Number of the experiment, in its name; its parts are drawn by it and the seed.
        progress: Called with the present step and the share that is done.
        most_s: Longest time that the experiment may take, s.
        avoided: Names of stages that have tripped.
        cover: Whether to cover instead of separating.
        given_up: Names of rivals that are not separated any more.
    """
    # The limits hold for what is not separated any more, too.
    also = [h for h in weighed.hypotheses if h.name in given_up and h.preference < REJECTED]
    weighed = weighed._replace(
        hypotheses=tuple(h for h in weighed.hypotheses if h.name not in given_up)
    )
    rng = np.random.default_rng([seed, number])
    design = _simulated(bench, weighed, also, bandwidth_Hz, rng, progress, avoided, cover)
    names = [h.name for h in design.hypotheses]
    indistinct: dict[tuple[str, str], float] = {}
    if not cover and len(names) > 1 and design.judged:
        best = design.apart(design.judged)
        lost = {pair: z for pair, z in best.items() if z < WORTH_WHILE}
        indistinct = {(names[0], names[b]): z for (a, b), z in lost.items() if a == 0}
        design = replace(design, lost=frozenset(lost))
    open_pairs = cover or len(indistinct) < len(names) - 1
    chosen = _best(design, most_s, progress) if open_pairs and design.judged else []
    if not chosen:
        late = open_pairs and any(design.seconds([one]) > most_s for one in design.judged)
        return Choice(None, indistinct, late)
    apart = {} if cover else design.apart(chosen)
    if not cover and max(z for (a, _), z in apart.items() if a == 0) < WORTH_WHILE:
        return Choice(None, indistinct)
    document = as_document(f"experiment-{number}", [c.part for c in chosen])
    seconds, changes = design.seconds(chosen), weight_changes(document.value.stages)
    motion = sum(s.repeats * s.duration_s for s in document.value.stages)
    weights = "no weight" if not changes else f"{changes} weight{'s' if changes > 1 else ''}"
    cost = f"{motion:.0f} s, {weights}, {seconds / 60.0:.1f} min of the bench"
    proposal = Proposal(
        "cover" if cover else "separate",
        document,
        f"{_purpose(design, chosen, apart)}; {cost}",
        seconds,
        changes,
        {(names[a], names[b]): z for (a, b), z in apart.items()},
        design.refused,
    )
    return Choice(proposal, indistinct)


def _simulated(
    bench: SimulatedBench,
    weighed: Weighed,
    also: Sequence[Hypothesis],
    bandwidth_Hz: float,
    rng: np.random.Generator,
    progress: Progress,
    avoided: Collection[str],
    cover: bool,
) -> _Design:
    """Simulate every part under every hypothesis that is not rejected; to cover, under any one
    rather than none. The limits hold under these hypotheses and those in ``also``.
    """
    hypotheses: list[Hypothesis] = []
    machines: list[Machine] = []
    refusing: list[Hypothesis] = []
    for h in weighed.hypotheses:
        wanted = h.preference < REJECTED or (cover and not hypotheses)
        if wanted and len(hypotheses) < MOST_HYPOTHESES:
            refusing.append(h)
            with suppress(InputError):  # an effect that the simulated machine cannot have
                machines.append(bench.machine(h.model))
                hypotheses.append(h)
    refusing += also[:MOST_HYPOTHESES]
    guards = [(h, m) for h in also[:MOST_HYPOTHESES] for m in bench.machines([h.model]).values()]
    # Under a load whose friction is not known, the machine has the paper's as well.
    unknown = [h for h in refusing if not bench.knows_load(h.model)]
    under_load = [(h, m) for h in unknown for m in bench.machines([bench.loaded(h.model)]).values()]
    terms = MOTION if cover else ()
    judged: list[_Judged] = []
    refused: dict[str, str] = {}
    drifts = any(EFFECTS[n].separation is Separation.SESSION for h in hypotheses for n in h.names)
    limits = bench.document.value.limits
    parts = [
        part
        for part in family(bench.document.value, rng, drifts)
        if not {stage.name for stage in part.stages} & {*avoided}
    ]
    models = [h.model for h in refusing]
    for k, part in enumerate(parts if hypotheses else ()):
        progress("simulating experiments", k / len(parts))
        try:
            plan = bench.plan(as_document("x", [part]), models)
            runs = [bench.simulate(plan, machine) for machine in machines]
            near = [
                f"{h.name}: {r.problem}" for h, r in zip(hypotheses, runs, strict=True) if r.problem
            ]
            for h, machine in (*guards, *under_load) if part.weight_kg else guards:
                if not near and (problem := bench.simulate(plan, machine).problem):
                    near.append(f"{h.name}: {problem}")
            if near:
                refused[part.name] = near[0]
                continue
            found: dict[Pair, Evidence] = {}
            for truth, run in enumerate(runs[:1] if cover else runs):
                here = experiment_views(run.recordings, hypotheses[0].joint, bandwidth_Hz)
                for model, h in enumerate(hypotheses[:1] if cover else hypotheses):
                    found[truth, model] = evidence(h.joint, here, terms)
            judged.append(_Judged(part, found, regions(here, limits)))
        except (InputError, RecordingError) as error:
            refused[part.name] = str(error)
    before = [present(h.joint, terms) for h in hypotheses]
    visited = regions(weighed.hypotheses[0].joint.views, limits)
    return _Design(bench, hypotheses, cover, before, judged, refused, visited)


def regions(recordings: Sequence[View], limits: LimitsSection) -> frozenset[Region]:
    """Return the regions that recordings visit: under each load (in factors of sqrt(2) of its
    mass), sixteenths of the permitted travel by direction, and factors of two of the speed by
    direction and of the duration of rests.
    """
    width = (limits.angle_max_deg - limits.angle_min_deg) / TRAVEL_REGIONS
    found: Counter[Region] = Counter()
    for view in recordings:
        mass = view.recording.weight_mass
        load = round(2.0 * math.log2(mass)) if mass > 0.0 else None
        moves, direction = ~view.still, np.sign(view.velocity)
        pace = np.maximum(np.abs(np.rad2deg(view.velocity)) / limits.speed_deg_s, SLOWEST)
        rest = np.maximum(view.rest_time, LEAST_REST_S)
        for name, at, signs, where in (
            ("angle", np.rad2deg(view.angle) / width, direction, moves),
            ("speed", np.log2(pace), direction, moves),
            ("rest", np.log2(rest), np.zeros_like(rest), view.still),
        ):
            cells = np.stack([signs, np.floor(at)])[:, where]
            each, counts = np.unique(cells, axis=1, return_counts=True)
            for (sign, cell), n in zip(each.T.tolist(), counts.tolist(), strict=True):
                found[name, load, sign, cell] += n * view.step
    return frozenset(region for region, seconds in found.items() if seconds >= VISIT_S)


def _best(design: _Design, most_s: float, progress: Progress) -> list[_Judged]:
    """Return the parts with the greatest worth per minute: the best part, and further parts while
    they increase it.
    """
    chosen: list[_Judged] = []
    rate = 0.0
    for count in range(MOST_PARTS):
        progress("composing the experiment", count / MOST_PARTS)
        used = {one.part.name for one in chosen}
        trials = [[*chosen, one] for one in design.judged if one.part.name not in used]
        rated = [
            (design.worth(trial) / seconds, k)
            for k, trial in enumerate(trials)
            if (seconds := design.seconds(trial)) <= most_s
        ]
        if not rated or max(rated)[0] <= rate:
            break
        rate, best = max(rated)
        chosen = trials[best]
    return chosen


def _purpose(design: _Design, chosen: Sequence[_Judged], apart: Mapping[Pair, float]) -> str:
    """Return what an experiment is for, with numbers."""
    if design.cover:
        order = np.argsort(-design.shown(chosen), kind="stable")[:3]
        least = ", ".join(title(MOTION[k].name) for k in order)
        new, all_new = len(design.new(chosen)), len(design.new(design.judged))
        return (
            f"shows what the recordings so far show least: {least}, and visits {new} of {all_new} "
            "ranges of angle, speed, rest and load that they have not visited"
        )
    rivals = design.hypotheses
    against = [
        f"from {spoken(rivals[b].name)} by {z:.1f} sigma (the recordings so far: "
        f"{rivals[b].preference:.1f})"
        for (a, b), z in apart.items()
        if a == 0
    ]
    return f"separates {spoken(rivals[0].name)} {', '.join(against)}"


def spoken(name: str) -> str:
    """Return the name of a hypothesis as words."""
    return " with ".join(title(n) if n in EFFECTS else n for n in name.split(" + "))
