"""Bootstrap of the friction ladder: fits a friction model to drawn recordings, and computes its
errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.estimate.equation_error.regression import Stage, unloaded_stage
from identification.estimate.uncertainty.parameter_table import fit_of
from identification.numerics.arrays import Array
from identification.numerics.bounded_least_squares import Design, bounded_least_squares
from identification.prepare import Prepared
from identification.recording import Model
from identification.simulate.closed_loop import replay
from identification.simulate.score import Sums, compare, pooled

COARSE, FINE, NEAR = 12, 17, 1.8
"""Number of trial Stribeck speeds over the whole range; number of trial Stribeck speeds near that
of the fit to all recordings; and greatest factor between these two.
"""
STEP_S = 1e-3
"""Integration step, s; the step causes an error of 0.04 mrad rms in angle errors of 20 mrad and
more.
"""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Score:
    """Errors of a friction model in one bootstrap draw.

    Attributes:
        train: Torque error on the drawn recordings to fit, in the unit of the fit.
        torque: Torque error on the drawn recordings to score.
        angle: Rms angle error of the simulated loop on the drawn recordings to score, rad (m); None
            if the loop is not simulated.
        angle_mae: Mean absolute angle error on the drawn recordings to score, rad (m), or None if
            the loop is not simulated.
    """

    train: float
    torque: float
    angle: float | None
    angle_mae: float | None


class Redraw:
    """Fits one rung by the equation error to a draw of recordings and scores it on another draw.

    Each recording is reduced once, at every trial Stribeck speed, to the triangular factor of its
    QR decomposition; a draw is then fitted to the stacked triangular factors. Between the trial
    Stribeck speeds omega_s the cost is interpolated by a parabola in log omega_s.

    Args:
        model: Model with the friction of the rung.
        fitted: Recordings to fit.
        scored: Recordings to score, at the same bandwidth.
        centre: Stribeck speed of the fit to all recordings, rad/s.
        simulated: Whether to simulate the control loop too.
    """

    def __init__(
        self,
        model: Model,
        fitted: Sequence[Prepared],
        scored: Sequence[Prepared],
        centre: float,
        simulated: bool,
    ) -> None:
        self._alpha = model.alpha
        self._fitted, self._scored = fitted, scored
        self._simulated = simulated
        self._stage = unloaded_stage(fitted, model)
        self._speeds = _trial_speeds(*self._stage.speed_range(), centre)
        self._alone = [replace(self._stage, prepared=(p,)) for p in fitted]
        self._triangles = [
            [_triangle(stage, float(w)) for stage in self._alone] for w in self._speeds
        ]

    def __call__(self, to_fit: Indices, to_score: Indices) -> Score:
        """Fit the recordings ``to_fit`` and score the recordings ``to_score``; each list may
        contain a recording more than once.
        """
        values = self._solve(to_fit)
        angles = self._angles(to_score, values) if self._simulated else None
        return Score(
            train=fit_of([self._fitted[k] for k in to_fit], values, self._alpha).train_rms,
            torque=fit_of([self._scored[k] for k in to_score], values, self._alpha).train_rms,
            angle=None if angles is None else angles.angle_rms,
            angle_mae=None if angles is None else angles.angle_mae,
        )

    def _angles(self, drawn: Indices, values: Mapping[str, float]) -> Sums:
        sums: dict[int, Sums] = {}
        for k in np.unique(drawn).tolist():
            p = self._scored[k]
            sums[k] = compare(p, replay(p.recording, values, self._alpha, STEP_S))
        return pooled(sums[k] for k in drawn.tolist())

    def _solve(self, drawn: Indices) -> dict[str, float]:
        bounds = self._stage.bounds()
        tried = [_solved([triangles[k] for k in drawn], *bounds) for triangles in self._triangles]
        costs = np.array([cost for _, cost in tried])
        best = int(np.argmin(costs))
        omega_s, coefficients = float(self._speeds[best]), tried[best][0]
        if 0 < best < len(costs) - 1:
            between = _vertex(np.log(self._speeds[best - 1 : best + 2]), costs[best - 1 : best + 2])
            triangles = {
                int(k): _triangle(self._alone[k], math.exp(between)) for k in np.unique(drawn)
            }
            finer, cost = _solved([triangles[int(k)] for k in drawn], *bounds)
            if cost < costs[best]:
                omega_s, coefficients = math.exp(between), finer
        return self._stage.named(omega_s, coefficients)


def _trial_speeds(low: float, high: float, centre: float) -> Array:
    """Return trial Stribeck speeds, rad/s: a few over the whole range, the rest near ``centre``."""
    if low == high:
        return np.array([low])
    near = np.geomspace(centre / NEAR, centre * NEAR, FINE)
    return np.unique(np.concatenate([np.geomspace(low, high, COARSE), np.clip(near, low, high)]))


def _solved(triangles: Sequence[Array], low: Array, high: Array) -> tuple[Array, float]:
    stacked = np.concatenate(triangles)
    return bounded_least_squares(Design(stacked[:, :-1], stacked[:, -1], low, high))


def _vertex(x: Array, y: Array) -> float:
    """Return the x at which the parabola through three points has its minimum, within the range of
    the points.
    """
    first, second = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = (second - first) / (x[2] - x[0])
    if not curvature > 0.0:
        return float(x[1])
    return float(np.clip(0.5 * (x[0] + x[1]) - 0.5 * first / curvature, x[0], x[2]))


def _triangle(stage: Stage, omega_s: float) -> Array:
    design = stage.design(omega_s)
    return np.asarray(np.linalg.qr(np.column_stack([design.columns, design.target]), mode="r"))
