"""Every rung of the friction ladder on one dataset: fitted, then scored on what was set aside.

Intervals are over recordings: the recordings to fit and those to score are drawn anew with replacement, the same draws
for every rung, each rung is fitted to its draw and scored on the other (Efron and Tibshirani, An Introduction to the
Bootstrap, ch. 8). Samples within a recording hang together far too much to count as independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.estimate.assemble import fit_of
from identification.estimate.default import identify
from identification.estimate.regression import Stage, unloaded_stage
from identification.estimate.result import Identification
from identification.estimate.uncertainty import CONFIDENCE
from identification.estimate.varpro import GRID, Design, bounded_least_squares
from identification.model.ladder import LADDER, bears_load
from identification.prepare import Prepared, prepare
from identification.recording import Array, Dataset, Model, Recording, RecordingError
from identification.simulate.closed_loop import replay
from identification.simulate.score import Sums, compare, pooled

REPLICATES = 100
"""Draws of the bootstrap."""
STEP_S = 1e-3
"""Integration step within the bootstrap: it costs 0.04 mrad rms on errors of 20 mrad and more."""

Progress = Callable[[str, float], None]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Interval:
    """A figure and its 90 % interval over recordings."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        friction: Its name.
        result: The fit to all recordings to fit.
        train: Torque error on them, in the fit's unit.
        scored: Torque error on the recordings set aside; None without any.
        angle: Angle error of the simulated loop there (or on the fitted ones), rad (m); None without a controller.
        best: Share of the draws in which this rung has the least torque error on what was scored.
    """

    friction: str
    result: Identification
    train: Interval
    scored: Interval | None
    angle: Interval | None
    best: float


def climb(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    progress: Progress | None = None,
) -> tuple[Rung, ...]:
    """Fit and score every rung that the recordings can bear.

    Args:
        dataset: Unloaded recordings; rungs that bear a load need a pendulum.
        bandwidth_Hz: Of torque and regressors; None chooses as the identification does.
        rng: Draws the recordings.
        replicates: Draws.
        progress: Called with what is being done and the share done.

    Raises:
        RecordingError: A recording is loaded, or cannot be fitted.
    """
    tell = progress or (lambda _what, _share: None)
    loaded = [r.name for r in dataset.recordings if r.stage == "loaded"]
    if loaded:
        raise RecordingError(f"{loaded[0]}: the ladder is of the unloaded friction; take loaded recordings out")
    fitted = dataset.part("fit")
    hanging = any(r.pendulum is not None for r in fitted)
    names = [name for name in LADDER if hanging or not bears_load(name)]
    scored = dataset.part("validate") or fitted
    simulated = all(r.controller is not None and "command" in r.channels for r in scored)
    draws = [(_draw(rng, len(fitted)), _draw(rng, len(scored))) for _ in range(replicates)]
    results, errors, angles = [], [], []
    for k, name in enumerate(names):
        tell(f"{name}: fit", k / len(names))
        model = replace(dataset.model, friction=name)
        result = identify(replace(dataset, model=model), bandwidth_Hz=bandwidth_Hz)
        bandwidth_Hz = result.fit.bandwidth_Hz
        done = (k / len(names), 1.0 / len(names))
        replica = _Replica(model, fitted, scored, bandwidth_Hz, simulated)
        pairs = []
        for n, (to_fit, to_score) in enumerate(draws):
            tell(f"{name}: draw {n + 1} of {replicates}", done[0] + done[1] * n / replicates)
            pairs.append(replica(to_fit, to_score))
        results.append(result)
        errors.append([(train, score) for train, score, _ in pairs])
        angles.append([angle for _, _, angle in pairs if angle is not None])
    spread = np.array(errors)  # rung, draw, (train, scored)
    winners = np.argmin(spread[:, :, 1], axis=0)
    rungs = []
    for k, (name, result) in enumerate(zip(names, results, strict=True)):
        fit = result.fit
        angle = None
        if simulated:
            value = pooled(_simulate(p, result.fitted, result.alpha) for p in _prepared(scored, fit.bandwidth_Hz))
            angle = _interval(value.angle_rms, angles[k])
        rungs.append(
            Rung(
                friction=name,
                result=result,
                train=_interval(fit.train_rms, spread[k, :, 0]),
                scored=None if fit.validate_rms is None else _interval(fit.validate_rms, spread[k, :, 1]),
                angle=angle,
                best=float(np.mean(winners == k)),
            )
        )
    tell("ladder", 1.0)
    return tuple(rungs)


class _Replica:
    """Fits one rung to a draw of recordings and scores it on another draw.

    Each recording is reduced once, at every trial Stribeck speed, to the triangle of its QR decomposition; a draw is
    then fitted from the stacked triangles. The Stribeck speed is searched on the grid alone.
    """

    def __init__(
        self,
        model: Model,
        fitted: Sequence[Recording],
        scored: Sequence[Recording],
        bandwidth_Hz: float,
        simulated: bool,
    ) -> None:
        self._model = model
        self._fitted = _prepared(fitted, bandwidth_Hz)
        self._scored = _prepared(scored, bandwidth_Hz)
        self._simulated = simulated
        self._stage = unloaded_stage(self._fitted, model)
        low, high = self._stage.speed_range()
        self._speeds = np.geomspace(low, high, GRID) if low < high else np.array([low])
        alone = [replace(self._stage, prepared=(p,)) for p in self._fitted]
        self._triangles = [[_triangle(stage, float(w)) for stage in alone] for w in self._speeds]

    def __call__(self, to_fit: Indices, to_score: Indices) -> tuple[float, float, float | None]:
        """Return train and scored torque error in the fit's unit, and the angle error in rad."""
        values = self._solve(to_fit)
        alpha = self._model.alpha
        train = fit_of([self._fitted[k] for k in to_fit], values, alpha).train_rms
        score = fit_of([self._scored[k] for k in to_score], values, alpha).train_rms
        if not self._simulated:
            return train, score, None
        sums: dict[int, Sums] = {}
        for k in to_score.tolist():
            if k not in sums:
                sums[k] = _simulate(self._scored[k], values, alpha, STEP_S)
        return train, score, pooled(sums[k] for k in to_score.tolist()).angle_rms

    def _solve(self, drawn: Indices) -> dict[str, float]:
        low, high = self._stage.bounds()
        best: tuple[float, dict[str, float]] = (math.inf, {})
        for omega_s, triangles in zip(self._speeds, self._triangles, strict=True):
            stacked = np.concatenate([triangles[k] for k in drawn])
            coefficients, cost = bounded_least_squares(Design(stacked[:, :-1], stacked[:, -1], low, high))
            if cost < best[0]:
                best = (cost, self._stage.named(float(omega_s), coefficients))
        return best[1]


def _triangle(stage: Stage, omega_s: float) -> Array:
    design = stage.design(omega_s)
    return np.asarray(np.linalg.qr(np.column_stack([design.columns, design.target]), mode="r"))


def _simulate(p: Prepared, values: Mapping[str, float], alpha: float, step: float | None = None) -> Sums:
    response = replay(p.recording, values, alpha) if step is None else replay(p.recording, values, alpha, step)
    return compare(p, response)


def _prepared(recordings: Sequence[Recording], bandwidth_Hz: float) -> tuple[Prepared, ...]:
    return tuple(prepare(r, bandwidth_Hz) for r in recordings)


def _draw(rng: np.random.Generator, count: int) -> Indices:
    return np.asarray(rng.integers(0, count, size=count), dtype=np.int64)


def _interval(value: float, draws: Sequence[float] | Array) -> Interval:
    low, high = np.quantile(draws, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return Interval(value, float(low), float(high))
