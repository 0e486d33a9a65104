"""The excitation, within a bench's limits and in the same time, that leaves the narrowest interval
of the least determined parameter.

Informations of stages add and grow with time. So many sines and ramps are judged once on short
stages, and a convex problem shares the time among them (:mod:`identification.design.shares`). The
few that get a share replace the stages: one sine alone leaves parameters that trade off, which a
slow one beside a fast one, or a light weight beside a heavy one, separates. Each is also judged
with softer and stiffer drives, since stick-slip depends on the loop. The best few designs are then
simulated with those drives and noise, and the best one that the default method identifies is
proposed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.design.excitation import Bounds, Frame, Part
from identification.design.pinning import Pinned
from identification.design.search import Design, Search, halved, planned, predicted
from identification.design.simulated import Nominal, PlannedStage, with_drives
from identification.design.simulated_trial import attained, expected

CANDIDATES = (60, 200)
"""Random excitations judged for unloaded and for loaded stages, which have a weight to choose as
well.
"""
REFINEMENTS, TOGETHER = 24, 10
"""How often small changes of those that get a share are tried afterwards, and how many each
time.
"""
TRIALS = 3
"""Most designs that are simulated and identified before half-time designs are tried."""
CONFIRMED = 2.0
"""Ratio of the attained to the expected merit below which no other design is simulated."""
NOISES = 3
"""Noises with which a design is simulated and identified; the worst result counts."""
WHOLE_SEED = 100
"""First seed of these noises; those of the drives are numbered from 0."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Proposal:
    """The present excitation's intervals, the proposal, and the intervals of the proposal.

    Attributes:
        weakest: The parameter whose interval is to be narrowed.
        present: Intervals of the present excitation, by simulation.
        stages: The proposal; the present excitation where nothing better was found.
        pinned: Intervals of the proposal by simulation, the default method's among them.
        promised: Intervals of the proposal predicted by its Fisher information.
        judged: Excitations simulated.
        identified: Whole experiments that were simulated and identified by the default method.
    """

    weakest: str
    present: Pinned
    stages: tuple[Part, ...]
    pinned: Pinned
    promised: Pinned
    judged: int
    identified: int


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
        frames: The stages; their total time stays, and so do unloaded and loaded ones.
        nominal: The model.
        bounds: Limits of the bench.
        rng: Source of all randomness.
        progress: Called with the label of a step and the share that is done.
        weakest: That parameter; the one with the widest relative interval where it is None or has
            no part in these stages.
    """
    report = progress or (lambda _label, _share: None)
    present = tuple(Part(k, f.present) for k, f in enumerate(frames))
    nominals = with_drives(nominal)
    now, _ = expected(_stages(frames, present), nominals)
    target = weakest if weakest is not None and weakest in now.half_widths else now.weakest
    search = Search(frames, nominals, bounds, rng, target, now.half_widths[target])
    kinds = sorted({f.loaded for f in frames})
    for number, loaded in enumerate(kinds):
        wanted = CANDIDATES[loaded]
        for k in range(wanted):
            search.add(search.draws.random(loaded))
            report("candidates", (number + (k + 1) / wanted) / len(kinds))
    if not search.complete:
        # An identification cannot start from any of the draws; it can from the present excitations.
        for part in present:
            search.add(part)
    for k in range(REFINEMENTS):
        for part in search.changed(TOGETHER):
            search.add(part)
        report("refinement", (k + 1) / REFINEMENTS)
    best, chosen, tried = now, Design(present, predicted(frames, present, nominals, target)), 0
    designs = search.designs()
    for step in (designs, (halved(d, frames, nominals, target) for d in designs)):
        found, design, simulated = _best_confirmed(step, search, now, report)
        tried += simulated
        if design is not None and search.merit(found) < search.merit(best):
            best, chosen = found, design
            break
    return Proposal(target, now, chosen.parts, best, chosen.predicted, search.count, tried)


def _best_confirmed(
    designs: Iterable[Design], search: Search, now: Pinned, report: Progress
) -> tuple[Pinned, Design | None, int]:
    """Return the best of some designs that the default method identifies, its intervals, and how
    many were simulated.

    It is the first whose simulated trials confirm the expected intervals; where none does, the one
    with the best attained intervals.
    """
    frames, nominals = search.frames, search.nominals
    judged = [(*expected(_stages(frames, design.parts), nominals), design) for design in designs]
    # Where the likelihood is steep at the simulated values the estimate ends beside them, so such
    # widths are multiplied by the steepness.
    ranked = sorted(
        (p for p in judged if search.merit(p[0]) < search.merit(now)),
        key=lambda p: search.merit(p[0]) * p[1],
    )
    best: tuple[Pinned, Design | None] = now, None
    for tried, (found, _, design) in enumerate(ranked[:TRIALS], 1):
        stages = _stages(frames, design.parts)
        whole = _worst(stages, search)
        report("simulated trials", tried / len(ranked))
        worse = max(found, whole, key=search.merit)
        if search.merit(worse) < search.merit(best[0]):
            best = worse, design
        if best[1] is not None and search.merit(whole) < CONFIRMED * search.merit(found):
            return *best, tried
    return *best, min(len(ranked), TRIALS)


def _worst(stages: Sequence[PlannedStage], search: Search) -> Pinned:
    """Return the intervals of the worst of a few simulated trials, up to the first that fails."""
    found = []
    for seed in range(WHOLE_SEED, WHOLE_SEED + NOISES):
        found.append(attained(stages, search.nominals[0], np.random.default_rng(seed)))
        if math.isinf(search.merit(found[-1])):
            break
    return max(found, key=search.merit)


def _stages(frames: Sequence[Frame], parts: Sequence[Part]) -> list[PlannedStage]:
    return [planned(frames[p.frame], p.excitation) for p in parts]
