"""Fits one friction model to the predicted angle by bounded Levenberg-Marquardt (M50, M51)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.prediction.coordinates import Coordinates, Point
from identification.estimate.prediction.pieces import Piece
from identification.numerics.arrays import Array
from identification.numerics.bounded_descent import bounded_step, minimise_within
from identification.numerics.levenberg_marquardt import Minimum, huber_weight
from identification.numerics.spread import correlation_samples

QUADRATIC = 0.2
"""Angle error up to which the cost is quadratic, relative to the median absolute error at the start
of the search. Beyond it the cost is linear, so that a recording that no friction model explains has
a limited influence.
"""
TOLERANCE, MOST_STEPS = 1e-3, 40
"""Decrease of the cost in a step, as a share of the cost, below which a search ends; and greatest
number of steps.
"""
COARSE_TOLERANCE, COARSE_STEPS = 0.02, 12
"""Tolerance and greatest number of steps of the first search from each of several start points;
only the best of these searches is continued.
"""
FOLDS = 3
_RIDGE = 1e-3
"""Damping of the step from the fit to a drawn set of recordings; the damping suppresses changes of
the parameters that hardly change the angle.
"""


@dataclass(frozen=True)
class LoopFit:
    """End of a search.

    Attributes:
        coordinates: Coordinates of the search.
        x: Coordinates, shape (p,).
        cost: Sum of the costs of data and priors.
        ends: Cost at the end of the search from each start point.
        threshold: Angle error up to which the cost is quadratic, rad.
        unit: Angle error that counts as one standard deviation of an independent observation, rad.
    """

    coordinates: Coordinates
    x: Array
    cost: float
    ends: tuple[float, ...]
    threshold: float
    unit: float

    @property
    def point(self) -> Point:
        """The parameters at the end of the search."""
        return self.coordinates.point(self.x)


def errors(pieces: Sequence[Piece], point: Point, alpha: float) -> list[Array]:
    """Return the predicted angle less the measured angle of each piece, rad."""
    return [p.predict(point.values, point.motor, point.lateness, alpha) - p.angle for p in pieces]


def absolute_error(found: Sequence[Array]) -> float:
    """Return the mean absolute error over all samples, rad."""
    return math.fsum(float(np.sum(np.abs(e))) for e in found) / sum(map(len, found))


def fit_loop(pieces: Sequence[Piece], coordinates: Coordinates, starts: Sequence[Array]) -> LoopFit:
    """Search from several start points, and continue the search from the best end.

    Args:
        pieces: Pieces of recordings that are predicted.
        coordinates: Coordinates of the search.
        starts: Start points, each of shape (p,); the errors of the first start determine the first
            threshold.
    """
    alpha = coordinates.model.alpha
    at_start = errors(pieces, coordinates.point(starts[0]), alpha)
    threshold = QUADRATIC * float(np.median(np.abs(np.concatenate(at_start))))
    unit = unit_of(at_start, threshold)
    begun = LoopFit(coordinates, starts[0], math.inf, (), threshold, unit)
    coarse = (COARSE_TOLERANCE, COARSE_STEPS)
    ends = [_searched(pieces, replace(begun, x=x), coarse) for x in starts]
    best = ends[int(np.argmin([e.cost for e in ends]))]
    # The threshold and the weight of the priors are computed from the errors at the end of a
    # search, not at its start.
    left = errors(pieces, coordinates.point(best.x), alpha)
    threshold = QUADRATIC * float(np.median(np.abs(np.concatenate(left))))
    again = LoopFit(coordinates, best.x, math.inf, (), threshold, unit_of(left, threshold))
    last = _searched(pieces, again, (TOLERANCE, MOST_STEPS))
    return replace(again, x=last.x, cost=last.cost, ends=tuple(e.cost for e in ends))


def refit(pieces: Sequence[Piece], found: LoopFit) -> LoopFit:
    """Fit other pieces, starting from the end of an earlier fit, with the threshold and unit of the
    earlier fit.
    """
    end = _searched(pieces, found, (TOLERANCE, MOST_STEPS))
    return replace(found, x=end.x, cost=end.cost)


def unit_of(found: Sequence[Array], threshold: float) -> float:
    """Return the angle error that counts as one standard deviation of an independent observation,
    rad (M51).

    The Huber cost, divided by threshold times mean absolute error, is the negative log likelihood
    of errors with a Laplace distribution. The errors of one simulation are correlated in time;
    therefore the cost is also divided by the correlation time in samples.
    """
    scale = absolute_error(found)
    return math.sqrt(max(threshold * scale * persistence(found), 1e-300))


def persistence(found: Sequence[Array]) -> float:
    """Return the number of samples that count as one independent error: the mean correlation time
    of the errors over the pieces, in samples.
    """
    sizes = [len(error) for error in found]
    return float(np.average([correlation_samples(error) for error in found], weights=sizes))


def pulls(pieces: Sequence[Piece], found: LoopFit) -> tuple[Array, Array]:
    """Return normal matrix and gradient of each recording at the end of a fit, without priors,
    shapes (m, p, p) and (m, p).
    """
    c = found.coordinates
    normals: dict[str, Array] = {}
    gradients: dict[str, Array] = {}
    for piece in pieces:
        error = _errors([piece], c, found.x)
        slope = _slope([piece], c, found.x, error)
        weight = huber_weight(error, found.threshold)
        name = piece.recording.name
        normal, gradient = slope.T @ (slope * weight[:, None]), slope.T @ (weight * error)
        normals[name] = normals.get(name, 0.0) + normal / found.unit**2
        gradients[name] = gradients.get(name, 0.0) + gradient / found.unit**2
    return np.array(list(normals.values())), np.array(list(gradients.values()))


def drawn(found: LoopFit, normals: Array, gradients: Array, counts: Array) -> Array:
    """Return the coordinates after one Gauss-Newton step on drawn recordings, shape (p,).

    Args:
        found: The fit to all recordings.
        normals: Normal matrix of each recording, shape (m, p, p).
        gradients: Gradient of each recording, shape (m, p).
        counts: Number of times that each recording was drawn, shape (m,).
    """
    c = found.coordinates
    prior = np.array([1.0 / c.prior[n] ** 2 if n in c.prior else 0.0 for n in c.names])
    normal = np.tensordot(counts, normals, 1) + np.diag(prior)
    # The sum of all gradients is zero at the minimum, except at bounds and within the tolerance of
    # the search.
    gradient = (counts - 1.0) @ gradients
    return found.x + bounded_step(normal, gradient, _RIDGE, found.x, c.box)


def _searched(pieces: Sequence[Piece], begun: LoopFit, rule: tuple[float, int]) -> Minimum:
    """Search from ``begun``; ``rule`` is the tolerance and the greatest number of steps."""
    c = begun.coordinates
    samples = sum(len(p.angle) for p in pieces)
    threshold = np.concatenate(
        [np.full(samples, begun.threshold / begun.unit), np.full(len(c.prior), math.inf)]
    )

    def residuals(x: Array) -> Array:
        return np.concatenate([_errors(pieces, c, x) / begun.unit, c.prior_rows(x)])

    def jacobian(x: Array, here: Array) -> Array:
        data = _slope(pieces, c, x, here[:samples] * begun.unit) / begun.unit
        prior = [[(n == m) / s for m in c.names] for n, s in c.prior.items()]
        return np.concatenate([data, np.reshape(prior, (len(c.prior), len(x)))])

    return minimise_within(
        residuals,
        jacobian,
        begun.x,
        c.box,
        threshold=threshold,
        tolerance=rule[0],
        most_steps=rule[1],
    )


def _errors(pieces: Sequence[Piece], c: Coordinates, x: Array) -> Array:
    return np.concatenate(errors(pieces, c.point(x), c.model.alpha))


def _slope(pieces: Sequence[Piece], c: Coordinates, x: Array, here: Array) -> Array:
    """Return the derivatives of the errors by finite differences, shape (n, p); at an upper bound
    the step is negative.
    """
    slope = np.empty((len(here), len(x)))
    for k, (step, high) in enumerate(zip(c.steps(), c.box.high, strict=True)):
        other = x.copy()
        other[k] += step if x[k] + step <= high else -step
        slope[:, k] = (_errors(pieces, c, other) - here) / (other[k] - x[k])
    return slope
