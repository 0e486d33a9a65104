"""Tries a proposed experiment: simulates it on the nominal model with noise, and identifies the
simulated recordings.

Fisher information is a linearisation at one point. Under a heavy weight the joint breaks away
within one sample, and the predicted information may be ten times the attained information.
Therefore the best few designs, combined with the present excitation, are simulated with a few noise
series and compared by the intervals that the default method states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.design.intervals import NAMES, Intervals, likelihood_slope
from identification.design.simulated import PlannedModel, PlannedStage, at_the_truth, recorded
from identification.estimate.default import identify
from identification.estimate.uncertainty.covariance import covariances, rise_to_static
from identification.model.parameters import SYSTEM_PARAMETERS
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
