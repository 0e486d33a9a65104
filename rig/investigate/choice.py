"""Chooses the next experiment: the parts, simulated under every hypothesis, whose sum lowers the
bound of the error probability most per minute of the bench.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Literal

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from identification.design.separation import (
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
from identification.effects.model import CorrectedModel
from identification.recording import RecordingError
from rig.common.errors import InputError
from rig.config.configuration import Document
from rig.config.sequence import Sequence as Stages
from rig.investigate.experiments import (
    Part,
    SimulatedBench,
    as_document,
    bench_seconds,
    family,
    in_order,
    weight_changes,
)

MOST_HYPOTHESES = 4
"""Greatest number of hypotheses that are simulated, the most likely ones."""
REJECTED = 3.0
"""Preference, in standard errors, from which a hypothesis is separated: it is wrong by chance in
one of 700 comparisons.
"""
WORTH_WHILE = 1.0
"""Least separation of an experiment, in standard errors, of one pair at least."""
TARGET_BOUND = 1e-3
"""Bound of the error probability below which a further decrease has no worth."""
OF_CONSTANTS = 0.01
"""Worth of a nat of information on the constants, over that of a factor e of the error bound."""
MOST_PARTS = 4
MOST_VISIBLE = math.log(100.0)
"""Greatest worth of the visibility of one effect that the recordings so far hardly show."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Proposal:
    """The next experiment.

    Attributes:
        purpose: Whether it separates hypotheses, or shows what no recording has shown.
        parts: Its parts in the order of the run.
        sequence: The sequence.
        reason: One sentence with numbers.
        seconds: Time of the bench and its operator, s.
        weight_changes: How often a weight is hung or taken off.
        apart: Pair of hypotheses to the expected preference, standard errors.
        judged: Number of parts that were simulated.
        refused: Part to the limit that a hypothesis would come too near to.
    """

    purpose: Literal["separate", "cover"]
    parts: tuple[Part, ...]
    sequence: Document[Stages]
    reason: str
    seconds: float
    weight_changes: int
    apart: Mapping[tuple[str, str], float]
    judged: int
    refused: Mapping[str, str]


@dataclass
class _Judged:
    """A part that no hypothesis brings too near to a limit, with what it would show."""

    part: Part
    evidence: dict[Pair, Evidence] = field(default_factory=dict)


@dataclass(frozen=True)
class _Design:
    """Simulated hypotheses, and the parts to choose from."""

    bench: SimulatedBench
    hypotheses: tuple[Hypothesis, ...]
    before: tuple[Evidence, ...]
    odds: tuple[float, ...]
    judged: tuple[_Judged, ...]
    refused: Mapping[str, str]
    visible: np.ndarray

    def models(self) -> list[CorrectedModel]:
        return [h.model for h in self.hypotheses]

    def added(self, chosen: Sequence[_Judged]) -> dict[Pair, Evidence]:
        """Return what several parts show together."""
        return {
            pair: reduce(lambda a, b: a + b, (one.evidence[pair] for one in chosen))
            for pair in chosen[0].evidence
        }

    def worth(self, chosen: Sequence[_Judged]) -> float:
        """Return the worth of an experiment, in factors e of the error bound."""
        added = self.added(chosen)
        constants = OF_CONSTANTS * information(self.before[0], added[0, 0])
        if len(self.hypotheses) < 2:
            after = visibility(self.before[0] + added[0, 0])
            ratio = np.maximum(after, 1e-30) / np.maximum(self.visible, 1e-30)
            gain = np.where(after > 0.0, np.minimum(np.log(ratio), MOST_VISIBLE), 0.0)
            return float(np.sum(np.maximum(gain, 0.0))) + constants
        apart = separations(self.before, added)
        bounds = [
            max(error_bound(self.odds, z), TARGET_BOUND) for z in (dict.fromkeys(apart, 0.0), apart)
        ]
        return math.log(bounds[0] / bounds[1]) + constants

    def seconds(self, chosen: Sequence[_Judged]) -> float:
        """Return the time of the bench that an experiment takes, s."""
        return bench_seconds(self.bench.plan(as_document("x", [c.part for c in chosen]), ()))


def propose(
    bench: SimulatedBench,
    weighed: Weighed,
    bandwidth_Hz: float,
    rng: np.random.Generator,
    progress: Progress,
    name: str,
    most_s: float = math.inf,
    avoided: Collection[str] = (),
    cover: bool = False,
) -> Proposal | None:
    """Return the next experiment, or None if no experiment separates the hypotheses enough.

    Args:
        bench: The bench.
        weighed: Hypotheses of the recordings so far.
        bandwidth_Hz: Bandwidth of the diagnosis.
        rng: Random generator of the parts.
        progress: Called with the present step and the share that is done.
        name: Name of the sequence.
        most_s: Longest time that the experiment may take, s.
        avoided: Names of parts that have tripped.
        cover: Whether to show what no recording has shown, instead of separating hypotheses.
    """
    design = _simulated(bench, weighed, bandwidth_Hz, rng, progress, avoided, cover)
    if design is None or not design.judged or (len(design.hypotheses) < 2 and not cover):
        return None
    chosen = _best(design, most_s, progress)
    if not chosen:
        return None
    apart = separations(design.before, design.added(chosen)) if not cover else {}
    if not cover and max(apart.values()) < WORTH_WHILE:
        return None
    parts = tuple(in_order([c.part for c in chosen]))
    named = {
        (design.hypotheses[a].name, design.hypotheses[b].name): z for (a, b), z in apart.items()
    }
    seconds = design.seconds(chosen)
    changes = weight_changes([s for p in parts for s in p.stages])
    reason = _reason(design, chosen, named, seconds, changes)
    return Proposal(
        "cover" if cover else "separate",
        parts,
        as_document(name, parts, f"# {reason}\n"),
        reason,
        seconds,
        changes,
        named,
        len(design.judged) + len(design.refused),
        design.refused,
    )


def _simulated(
    bench: SimulatedBench,
    weighed: Weighed,
    bandwidth_Hz: float,
    rng: np.random.Generator,
    progress: Progress,
    avoided: Collection[str],
    cover: bool,
) -> _Design | None:
    """Simulate every part under every hypothesis."""
    hypotheses: list[Hypothesis] = []
    machines: list[Machine] = []
    for h in weighed.hypotheses:
        if len(hypotheses) == (1 if cover else MOST_HYPOTHESES):
            break
        if h.preference >= REJECTED and not cover:
            continue
        try:
            machines.append(bench.machine(h.model))
        except InputError:
            continue
        hypotheses.append(h)
    if not hypotheses:
        return None
    terms = MOTION if cover else ()
    before = tuple(present(h.joint, terms) for h in hypotheses)
    total = sum(h.weight for h in hypotheses)
    judged: list[_Judged] = []
    refused: dict[str, str] = {}
    drifts = any(EFFECTS[n].separation is Separation.SESSION for h in hypotheses for n in h.names)
    parts = [p for p in family(bench.document.value, rng, drifts) if p.name not in avoided]
    models = [h.model for h in hypotheses]
    for k, part in enumerate(parts):
        progress("simulating experiments", k / len(parts))
        try:
            plan = bench.plan(as_document("x", [part]), models)
            found = _Judged(part)
            for truth, machine in enumerate(machines):
                simulated = bench.simulate(plan, machine)
                if simulated.problem:
                    refused[part.name] = f"{hypotheses[truth].name}: {simulated.problem}"
                    break
                here = experiment_views(simulated.recordings, hypotheses[0].joint, bandwidth_Hz)
                for model, h in enumerate(hypotheses):
                    found.evidence[truth, model] = evidence(h.joint, here, terms)
            else:
                judged.append(found)
        except (InputError, RecordingError) as error:
            refused[part.name] = str(error)
    return _Design(
        bench,
        tuple(hypotheses),
        before,
        tuple(h.weight / total for h in hypotheses),
        tuple(judged),
        refused,
        visibility(before[0]) if cover else np.zeros(0),
    )


def _best(design: _Design, most_s: float, progress: Progress) -> list[_Judged]:
    """Return the parts with the greatest worth per minute: the best part, and further parts while
    they increase it.
    """
    chosen: list[_Judged] = []
    rate = 0.0
    for count in range(MOST_PARTS):
        progress("composing the experiment", count / MOST_PARTS)
        trials = []
        for one in design.judged:
            if one in chosen:
                continue
            together = [*chosen, one]
            seconds = design.seconds(together)
            if seconds <= most_s:
                trials.append((design.worth(together) / seconds, one))
        best = max(trials, key=lambda t: t[0], default=None)
        if best is None or best[0] <= rate:
            break
        rate = best[0]
        chosen.append(best[1])
    return chosen


def _reason(
    design: _Design,
    chosen: Sequence[_Judged],
    apart: Mapping[tuple[str, str], float],
    seconds: float,
    changes: int,
) -> str:
    """Return the sentence that states the purpose of an experiment, with numbers."""
    motion = sum(s.repeats * s.duration_s for c in chosen for s in c.part.stages)
    weights = "no weight" if not changes else f"{changes} weight{'s' if changes > 1 else ''}"
    cost = f"{motion:.0f} s, {weights}, {seconds / 60.0:.1f} min of the bench"
    if not apart:
        shown = visibility(design.before[0] + design.added(chosen)[0, 0])
        gains = shown / np.maximum(design.visible, 1e-30)
        best = sorted(zip(gains.tolist(), MOTION, strict=True), key=lambda g: -g[0])[:3]
        words = ", ".join(title(e.name) for _, e in best)
        return f"shows what the recordings so far show least: {words}; {cost}"
    first, known = design.hypotheses[0], {h.name: h.preference for h in design.hypotheses}
    rivals = [
        (b if a == first.name else a, z) for (a, b), z in apart.items() if first.name in (a, b)
    ]
    against = [
        f"from {spoken(name)} by {z:.1f} sigma (the recordings so far: {known[name]:.1f})"
        for name, z in rivals
    ]
    return f"separates {spoken(first.name)} {', '.join(against)}; {cost}"


def spoken(name: str) -> str:
    """Return the name of a hypothesis as words."""
    return " with ".join(title(n) if n in EFFECTS else n for n in name.split(" + "))
