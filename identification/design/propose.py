"""Proposes an excitation that minimises the interval of the least determined parameter, within the
limits of a bench and with the duration of the given excitation.

The information of stages is additive and proportional to time. Therefore many sines and ramps are
each judged once on a short stage, and a convex problem shares the time among them
(:mod:`identification.design.search`). The few excitations that get a share of the time replace the
present stages. From one sine alone the estimates of some parameters would be correlated; a slow and
a fast sine, or a light and a heavy weight, reduce this correlation. Each excitation is also judged
with softer and stiffer drives, since stick-slip depends on the loop. The best few designs are then
simulated with these drives and with noise. The proposal is the best design from which the default
method identifies the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.design.search import (
    Bounds,
    Design,
    Frame,
    Part,
    Search,
    halved,
    planned,
    predicted,
)
from identification.design.simulated import (
    NAMES,
    Intervals,
    PlannedModel,
    PlannedStage,
    at_the_truth,
    likelihood_slope,
    recorded,
    with_drives,
)
from identification.estimate.covariance import covariances, rise_to_static
from identification.estimate.default import identify
from identification.model.parameters import SYSTEM_PARAMETERS
from identification.numerics.arrays import Progress, silent
from identification.numerics.spread import Spread
from identification.recording import Dataset, RecordingError


def attained(
    stages: Sequence[PlannedStage], nominal: PlannedModel, rng: np.random.Generator
) -> Intervals:
    """Return the relative half widths that the default method attains on one simulated run.

    If an estimate is farther from the simulated value than its half width, the interval is too
    narrow or the estimate is in a wrong basin; the distance then replaces the half width. The half
    width is infinite for a parameter that is not identifiable, and for all parameters if the
    refined values are not accepted, because the design was optimised for the refined values.
    """
    names = NAMES if any(s.weight > 0.0 for s in stages) else SYSTEM_PARAMETERS
    nothing = Intervals(dict.fromkeys(names, math.inf))
    try:
        result = identify(
            Dataset(tuple(recorded(k, s, nominal, rng) for k, s in enumerate(stages))), rng=rng
        )
    except RecordingError:
        return nothing
    if all(p.floor is None for p in result.parameters.values()):
        return nothing
    widths = dict(nothing.half_widths)
    truth = nominal.values
    for name, p in result.parameters.items():
        if name in widths and p.value and p.low is not None and p.high is not None:
            widths[name] = max(0.5 * (p.high - p.low), abs(p.value - truth[name])) / abs(p.value)
    return Intervals(widths)


def expected(
    stages: Sequence[PlannedStage], nominals: Sequence[PlannedModel]
) -> tuple[Intervals, float]:
    """Return the relative half widths that the joint fit would state at the simulated values, and
    the steepness of the likelihood there.

    The steepness is stated relative to its value with noise alone, and is at least 1; the fit would
    end about so many standard deviations from the simulated values. Half widths and steepness are
    medians over the runs, and infinite if the filter diverges in one run.

    Args:
        stages: The design.
        nominals: Model of each run, three at least; each run has its own noise.
    """
    names = NAMES if any(s.weight > 0.0 for s in stages) else SYSTEM_PARAMETERS
    nothing = Intervals(dict.fromkeys(names, math.inf)), math.inf
    runs = []
    for number, nominal in enumerate(nominals):
        run = at_the_truth(stages, nominal, names, number)
        if run is None:
            return nothing
        runs.append(run)
    turn = rise_to_static(names)
    found = []
    for run in runs:
        try:
            achieved = covariances(
                run.point, [other for other in runs if other is not run]
            ).achieved
        except np.linalg.LinAlgError:
            return nothing
        spread = Spread(names, turn @ achieved @ turn.T, math.inf)
        found.append([spread.half_width(n) / nominals[0].values[n] for n in names])
    widths = np.where(np.all(np.isfinite(found), axis=0), np.median(found, axis=0), np.inf)
    slopes = [math.sqrt(max(likelihood_slope(run.point), 1.0)) for run in runs]
    return Intervals(dict(zip(names, widths.tolist(), strict=True))), float(np.median(slopes))


CANDIDATES = (60, 200)
"""Number of random excitations that are judged: for unloaded stages, and for loaded stages, for
which a weight is drawn too.
"""
REFINEMENTS, TOGETHER = 24, 10
"""Number of rounds in which the selected excitations are changed a little, and number of changes
per round.
"""
TRIALS = 3
"""Greatest number of designs that are simulated and identified before designs in half of the time
are tried.
"""
CONFIRMED = 2.0
"""Ratio of the attained to the expected merit (relative half width of the target parameter) below
which a design is confirmed and no further design is simulated.
"""
NOISES = 3
"""Number of noise series with which a design is simulated and identified; the worst result
counts.
"""
WHOLE_SEED = 100
"""First seed of the noise series with which whole designs are simulated; the seeds for different
drives start at 0.
"""


@dataclass(frozen=True)
class Proposal:
    """A proposed excitation, with the intervals of the present and of the proposed excitation.

    Attributes:
        weakest: The target parameter, whose interval is to be narrowed.
        present: Intervals of the present excitation, by simulation.
        stages: The proposal; the present excitation if nothing better was found.
        proposed: Intervals of the proposal, from simulation and identification by the default
            method.
        predicted: Intervals of the proposal, from its Fisher information.
        judged: Number of excitations simulated.
        identified: Number of whole experiments simulated and identified by the default method.
    """

    weakest: str
    present: Intervals
    stages: tuple[Part, ...]
    proposed: Intervals
    predicted: Intervals
    judged: int
    identified: int


def propose(
    frames: Sequence[Frame],
    nominal: PlannedModel,
    bounds: Bounds,
    rng: np.random.Generator,
    progress: Progress | None = None,
    weakest: str | None = None,
) -> Proposal:
    """Search for the excitation that narrows one parameter's relative interval most.

    Args:
        frames: The present stages; the proposal has the same total time and the same load
            conditions.
        nominal: The model.
        bounds: Limits of the bench.
        rng: Source of all randomness.
        progress: Called with the label of a step and the share that is done.
        weakest: The target parameter; if None, or if these stages do not depend on it, the
            parameter with the widest relative interval.
    """
    report = progress or silent
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
        # An identification cannot start from any drawn excitation, but from the present
        # excitations.
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
    designs: Iterable[Design], search: Search, now: Intervals, report: Progress
) -> tuple[Intervals, Design | None, int]:
    """Return intervals and design of the first confirmed or best trial, and their number."""
    frames, nominals = search.frames, search.nominals
    judged = [(*expected(_stages(frames, design.parts), nominals), design) for design in designs]
    # If the likelihood is steep at the simulated values, the estimate ends far from these values;
    # therefore the expected half widths are multiplied by the steepness.
    ranked = sorted(
        (p for p in judged if search.merit(p[0]) < search.merit(now)),
        key=lambda p: search.merit(p[0]) * p[1],
    )
    best: tuple[Intervals, Design | None] = now, None
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


def _worst(stages: Sequence[PlannedStage], search: Search) -> Intervals:
    """Return the intervals of the worst simulated trial; none follows one that fails."""
    found = []
    for seed in range(WHOLE_SEED, WHOLE_SEED + NOISES):
        found.append(attained(stages, search.nominals[0], np.random.default_rng(seed)))
        if math.isinf(search.merit(found[-1])):
            break
    return max(found, key=search.merit)


def _stages(frames: Sequence[Frame], parts: Sequence[Part]) -> list[PlannedStage]:
    return [planned(frames[p.frame], p.excitation) for p in parts]
