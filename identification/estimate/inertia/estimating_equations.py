"""Solves the estimating equations, which state that the prediction errors are uncorrelated with the
instruments (M27, M29).

Least squares and maximum likelihood of the prediction errors give a biased inertia. The cause is
the drive: the current loop transmits noise of the current sensor to the true torque, and the
velocity loop reacts to the motion due to this noise. The difference between measured and true
torque is therefore correlated with both torques. The solution of the estimating equations is
unbiased if the prediction errors have zero mean and the instruments of a segment do not contain the
noise of that segment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate.inertia.inertia_equation import influence_on_inertia
from identification.estimate.inertia.instruments import instruments
from identification.estimate.inertia.variance_inflation import inflation_factors
from identification.filter.experiment import Experiment
from identification.filter.likelihood import Point, Searched
from identification.filter.noise_level import HUBER_THRESHOLD, likeliest_noise
from identification.model.parameters import INERTIA, LOGARITHMIC
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber_weight

SOLVED = 3.0
"""Chi-square below which the estimating equations count as solved (M29)."""
ROUNDS = 6
"""Greatest number of rounds; in each round instruments, weights and derivatives are computed
anew.
"""
_LEVEL_ROUNDS = (0, 2)
_CHORDS = 8
_HALVINGS = 5
_LONGEST_LOG = 0.4
_LONGEST_SHIFT = 2.0
_SETTLED = 0.05
_TURNS = 8
_MOST = 3.0
"""Information of a segment, relative to the median of its recording's segments, above which the
variance of the segment is inflated (M13).
"""
_CHORD_SETTLED = 0.02


def solve(point: Point) -> Point:
    """Return the solution of the estimating equations, by a search that starts from ``point``.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not determine the parameters.
    """
    count = len(point.free)
    for turn in range(ROUNDS):
        if turn in _LEVEL_ROUNDS:
            point = replace(point, noise=likeliest_noise(point))
        begun = point.origin()[:count]
        point, deviation = _round(point)
        moved = np.abs(point.origin()[:count] - begun) / deviation
        if turn >= _LEVEL_ROUNDS[-1] and float(np.max(moved)) < _SETTLED:
            break
    return point


def _round(point: Point) -> tuple[Point, Array]:
    """Solve the equations with fixed instruments by chord steps; return the solution and the
    standard deviations of the parameters.
    """
    held = point.weighted()
    x = point.origin()
    residual = held.residuals(x)
    jacobian = held.jacobian(x, residual)
    z = instruments(point, jacobian)
    count = len(point.free)
    bread = np.linalg.inv(z.product(huber_weight(residual, HUBER_THRESHOLD), jacobian))
    power = z.product()
    metric = np.linalg.pinv(power, hermitian=True)
    deviation = np.sqrt(np.abs(np.diag(bread @ power @ bread.T)))[:count]
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    for _ in range(_CHORDS):
        step = -bread @ score
        logs = [abs(s) for s, k in zip(step, point.free, strict=False) if k in LOGARITHMIC]
        share = min(
            1.0,
            _LONGEST_LOG / max([*logs, 1e-9]),
            _LONGEST_SHIFT / float(np.max(np.abs(step[count:]))),
        )
        for _ in range(_HALVINGS):
            there = held.residuals(x + share * step)
            then = z.back(there * huber_weight(there, HUBER_THRESHOLD))
            if then @ metric @ then < score @ metric @ score:
                break
            share *= 0.5
        else:
            break
        x, score = x + share * step, then
        if float(np.max(np.abs(step[:count]) / deviation)) < _CHORD_SETTLED:
            break
    return point.moved(x), np.asarray(deviation)


def equations_chi2(point: Point) -> float:
    """Return the chi-square of the estimating equations at a point (M29)."""
    held = point.weighted()
    x = point.origin()
    residual = held.residuals(x)
    z = instruments(point, held.jacobian(x, residual))
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    return float(score @ np.linalg.pinv(z.product(), hermitian=True) @ score)


def fit_beside_inertia(point: Point, refine: Callable[[Point], Searched]) -> Searched:
    """Fit the inertia by its estimating equation and all other parameters by likelihood, in turn.

    Maximum likelihood is strongly biased in the inertia only. For all other parameters it is more
    precise than estimating equations with instruments that are means over a few segments, and its
    search stays in its basin. In the estimating equation of the inertia all other unknowns are
    eliminated, so that errors of these unknowns have an effect of second order only (M30, M31).

    Args:
        point: Point at the end of the unloaded and loaded fits.
        refine: Function that maximises the likelihood over the free parameters from a point.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not determine the parameters.
    """
    free = point.free
    others = tuple(k for k in free if k != INERTIA)
    low, high = (-np.inf, 0.0), (np.inf, 0.0)
    iterations = 0
    for _ in range(_TURNS):
        if others:
            found = refine(_inflated(point, others))
            point, iterations = found.point.freeing(free), iterations + found.iterations
        if others == free:
            break
        point = replace(point, noise=likeliest_noise(point))
        step, deviation = _inertia_step(point)
        if not math.isfinite(step):
            raise np.linalg.LinAlgError("the estimating equation does not determine the inertia")
        here = float(np.log(point.vector[INERTIA]))
        low, high = ((here, step), high) if step > 0.0 else (low, (here, step))
        there = here + float(np.clip(step, -_LONGEST_LOG, _LONGEST_LOG))
        if not low[0] < there < high[0]:
            there = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        vector = point.vector.copy()
        vector[INERTIA] = np.exp(there)
        point, iterations = replace(point, vector=vector), iterations + 1
        if abs(there - here) < _SETTLED * deviation:
            break
    # Variance inflation depends on the parameters; therefore it is computed anew at the end of the
    # fit.
    return Searched(_inflated(point, others).freeing(free), iterations)


def _inflated(point: Point, others: tuple[int, ...]) -> Point:
    """Return the point with the parameters ``others`` free, and with the variance inflation for
    these parameters.
    """
    return replace(point.freeing(others), inflation=segment_inflation(point, others))


def _inertia_step(point: Point) -> tuple[float, float]:
    """Return the step in the logarithm of the inertia that solves the linearised estimating
    equation, and the standard deviation of the step.
    """
    held = point.weighted()
    x = point.origin()
    residual = held.residuals(x)
    jacobian = held.jacobian(x, residual)
    influence = influence_on_inertia(point, instruments(point, jacobian), jacobian, residual)
    return -float(influence @ (residual * huber_weight(residual, HUBER_THRESHOLD))), float(
        np.linalg.norm(influence)
    )


def segment_inflation(point: Point, others: Sequence[int]) -> Array:
    """Return the variance inflation of each segment at a point for the estimation of ``others``
    among its free parameters, shape (m,) (M13); the inflation stored in the point is ignored.
    """
    held = replace(point, inflation=np.ones(point.breakaways)).weighted()
    x = point.origin()
    # Derivatives with respect to all free parameters are computed, because the callers need them
    # next.
    jacobian = held.jacobian(x, held.residuals(x))
    for j in reversed([j for j, k in enumerate(point.free) if k not in others]):
        jacobian = jacobian.without(j)
    return inflation_by(point.experiment, jacobian)


def inflation_by(experiment: Experiment, jacobian: BlockArrow) -> Array:
    """Return the variance inflation computed from sensitivities without inflation, shape (m,)."""
    information = jacobian.information_by_block()
    numbers = np.arange(len(experiment.motions), dtype=np.int64)
    recordings = np.repeat(numbers, [len(m.table) for m in experiment.motions])
    return inflation_factors(information, experiment.lengths, recordings, _MOST)
