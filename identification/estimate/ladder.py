"""Fits every friction model of the ladder to one dataset and scores it on validation recordings.

A rung is one friction model of the ladder. Intervals are computed by a bootstrap over recordings:
recordings to fit and recordings to score are drawn with replacement, with the same draws for every
rung (Efron and Tibshirani, An Introduction to the Bootstrap, ch. 8). Whole recordings are drawn,
because samples within a recording are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.estimate.bandwidth import choose_bandwidth
from identification.estimate.default import identify
from identification.estimate.equation_error import Floor, Stage, noise_floor, unloaded_stage
from identification.estimate.parameter_table import fit_of
from identification.model.parameters import LADDER, LOAD_PARAMETERS, bears_load
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.compiled import each
from identification.numerics.least_squares import Design, bounded_least_squares
from identification.numerics.spread import CONFIDENCE
from identification.prepare import Prepared, prepare
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.result import Fit, Identification, Parameter
from identification.simulation.closed_loop import Sums, compare, compare_angle, pooled, replay

COARSE, FINE, NEAR = 12, 17, 1.8
"""Trial Stribeck speeds over the range, and near that of the fit; greatest factor of these."""
STEP_S = 1e-3
"""Integration step, s: its error is 0.04 mrad rms, of angle errors of 20 mrad and more."""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Score:
    """Errors of a friction model in one bootstrap draw."""

    train: float  # torque error on the drawn recordings to fit, in the unit of the fit
    torque: float  # torque error on the drawn recordings to score
    # Rms angle error of the simulated loop on the drawn recordings to score, rad (m); None if the
    # loop is not simulated.
    angle: float | None
    # Mean absolute angle error on the drawn recordings to score, rad (m), or None if the loop is
    # not simulated.
    angle_mae: float | None


class Redraw:
    """Fits one rung by the equation error to a draw of recordings and scores it on another draw.

    Each recording is reduced once, at every trial Stribeck speed, to the triangular factor of its
    QR decomposition; a draw is then fitted to the stacked triangular factors. Between the trial
    Stribeck speeds omega_s the cost is interpolated by a parabola in log omega_s.

    Args:
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
        """Fit and score recordings by their numbers, which may repeat."""
        values = self._solve(to_fit)
        angles = self._angles(to_score, values) if self._simulated else None
        return Score(
            train=fit_of([self._fitted[k] for k in to_fit], values, self._alpha).train_rms,
            torque=fit_of([self._scored[k] for k in to_score], values, self._alpha).train_rms,
            angle=None if angles is None else angles.angle_rms,
            angle_mae=None if angles is None else angles.angle_mae,
        )

    def _angles(self, drawn: Indices, values: Mapping[str, float]) -> Sums:
        def of(k: int) -> Sums:
            recording = self._scored[k].recording
            return compare_angle(recording, replay(recording, values, self._alpha, STEP_S))

        numbers = np.unique(drawn).tolist()
        sums = dict(zip(numbers, each(of, numbers), strict=True))
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
    """Return the minimum of the parabola through three points, within their range."""
    first, second = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = (second - first) / (x[2] - x[0])
    if not curvature > 0.0:
        return float(x[1])
    return float(np.clip(0.5 * (x[0] + x[1]) - 0.5 * first / curvature, x[0], x[2]))


def _triangle(stage: Stage, omega_s: float) -> Array:
    design = stage.design(omega_s)
    return np.asarray(np.linalg.qr(np.column_stack([design.columns, design.target]), mode="r"))


REPLICATES = 100  # number of bootstrap draws


@dataclass(frozen=True)
class Interval:
    """A value and its 90 % interval, by a bootstrap over recordings."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Rung:
    """One model of the ladder."""

    friction: str
    result: Identification
    train: Interval  # torque error on the fitted recordings, in the unit of the fit
    # Torque error on the recordings with role `validate`, or None without such recordings.
    scored: Interval | None
    # Rms angle error of the simulated control loop, rad (m), on the validation recordings, or on
    # the fitted recordings if there are no validation recordings; None without a controller.
    angle: Interval | None
    angle_mae: Interval | None  # mean absolute angle error on the recordings of `angle`, rad (m)
    # Share of the bootstrap draws in which this rung has the least torque error on the scored
    # recordings.
    best: float


def climb(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    progress: Progress | None = None,
) -> tuple[Rung, ...]:
    """Fit and score every rung for which the recordings have the necessary channels and loads.

    ``dataset``: unloaded recordings; rungs with load-dependent friction need a pendulum.
    ``bandwidth_Hz``: bandwidth of torque and regressors, or None for the bandwidth that
    :func:`identification.estimate.default.identify` chooses. ``rng``: random generator for the
    drawn recordings and the simulated replicates. ``replicates``: number of bootstrap draws.
    """
    tell = progress or silent
    chosen, bandwidth_Hz, _ = choose_bandwidth(dataset, bandwidth_Hz)
    to_fit = _to_fit(chosen)
    to_score = chosen.part("validate") or to_fit
    fitted, scored = ([prepare(r, bandwidth_Hz) for r in part] for part in (to_fit, to_score))
    simulated = all(r.controller is not None and "command" in r.channels for r in to_score)
    draws = [(_draw(rng, len(fitted)), _draw(rng, len(scored))) for _ in range(replicates)]
    hanging = any(r.known_load for r in to_fit)
    names = [name for name in LADDER if hanging or not bears_load(name)]
    results: list[Identification] = []
    found: list[list[Score]] = []
    for k, name in enumerate(names):
        model = replace(dataset.model, friction=name)
        tell(f"{name}: fit", k / len(names))
        one = replace(dataset, model=model)
        results.append(identify(one, bandwidth_Hz=bandwidth_Hz, rng=rng))
        redraw = Redraw(model, fitted, scored, results[-1].fitted.get("omega_sf", 1.0), simulated)
        found.append([])
        for n, draw in enumerate(draws):
            tell(f"{name}: draw {n + 1} of {replicates}", (k + n / replicates) / len(names))
            found[-1].append(redraw(*draw))
    angles = [_angles(r, scored) if simulated else None for r in results]
    winners = np.argmin([[score.torque for score in scores] for scores in found], axis=0)
    tell("ladder", 1.0)
    return tuple(
        Rung(
            friction=name,
            result=result,
            train=draw_interval(result.fit.train_rms, [s.train for s in scores]),
            scored=_scored(result, scores),
            angle=_angle(sums, lambda s: s.angle_rms, [s.angle for s in scores]),
            angle_mae=_angle(sums, lambda s: s.angle_mae, [s.angle_mae for s in scores]),
            best=float(np.mean(winners == k)),
        )
        for k, (name, result, scores, sums) in enumerate(
            zip(names, results, found, angles, strict=True)
        )
    )


def _to_fit(dataset: Dataset) -> tuple[Recording, ...]:
    """Return the recordings to fit; raise RecordingError if none, or if one is loaded."""
    loaded = [r.name for r in dataset.recordings if r.stage == "loaded"]
    if loaded:
        raise RecordingError(
            f"{loaded[0]}: the recording is loaded, but the friction ladder describes friction "
            "without load; remove all loaded recordings"
        )
    to_fit = dataset.part("fit")
    if not to_fit:
        raise RecordingError("no recording has role 'fit'; at least one is needed")
    return to_fit


def _scored(result: Identification, scores: Sequence[Score]) -> Interval | None:
    value = result.fit.validate_rms
    return None if value is None else draw_interval(value, [s.torque for s in scores])


def _angles(result: Identification, prepared: Sequence[Prepared]) -> Sums:
    return pooled(compare(p, replay(p.recording, result.fitted, result.alpha)) for p in prepared)


def _angle(
    sums: Sums | None, measure: Callable[[Sums], float], draws: Sequence[float | None]
) -> Interval | None:
    if sums is None:
        return None
    return draw_interval(measure(sums), [drawn for drawn in draws if drawn is not None])


def _draw(rng: np.random.Generator, count: int) -> Indices:
    return np.asarray(rng.integers(0, count, size=count), dtype=np.int64)


def draw_interval(value: float, draws: Array | Sequence[float]) -> Interval:
    """Return a value with the central 90 % of its bootstrap draws."""
    low, high = np.quantile(draws, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return Interval(value, float(low), float(high))


@dataclass(frozen=True)
class Moved:
    """Comparison of two estimates of one parameter, from two groups of recordings."""

    name: str
    unit: str
    first: Parameter
    second: Parameter
    # Second estimate less first estimate, or None if the parameter is not identifiable from the
    # first or from the other recordings.
    difference: float | None
    # Half width of the 90 % interval of the difference, for independent estimates.
    joint: float | None
    moved: bool | None  # whether the difference exceeds this half width


@dataclass(frozen=True)
class Transfer:
    """Result of applying a fitted model to other recordings."""

    fit: Fit  # torque error of the transferred model on the other recordings
    own: Fit  # torque error of the model identified on the other recordings
    # Noise floor of the other recordings, or None if they contain no repeated motion.
    floor: Floor | None
    by_recording: Mapping[str, Fit]  # torque error of the transferred model on each recording
    parameters: tuple[Moved, ...]
    other: Identification


def transfer(
    first: Identification, dataset: Dataset, other: Dataset, rng: np.random.Generator | None = None
) -> Transfer:
    """Score a fitted model on other recordings, and compare it with an identification of the other
    recordings.

    The other recordings are identified with the model and bandwidth of the first fit; those with
    role ``validate`` are not fitted.

    ``first``: the fit to transfer. ``dataset``: dataset of the fit to transfer; its declared model
    applies to both datasets. ``rng``: random generator for the identification of the other
    recordings, or None for seed 0.
    """
    seen = {r.sha256 for r in dataset.part("fit") if r.sha256}
    recordings = other.part("fit")
    known = [r.name for r in recordings if r.sha256 in seen]
    if known:
        raise RecordingError(
            f"{known[0]}: the model was fitted to this recording; a score needs other recordings"
        )
    loaded = [r.name for r in recordings if r.stage == "loaded"]
    if loaded and not set(LOAD_PARAMETERS) & first.fitted.keys():
        raise RecordingError(
            f"{loaded[0]}: the recording is loaded, but the model to score was fitted to unloaded "
            "recordings only"
        )
    mine, theirs = dataset.recordings[0].bench.motion, other.recordings[0].bench.motion
    if mine != theirs:
        raise RecordingError(
            f"a model of a {mine} bench cannot be scored on recordings of a {theirs} bench"
        )
    bandwidth_Hz = first.fit.bandwidth_Hz
    own = identify(Dataset(recordings, dataset.model), bandwidth_Hz=bandwidth_Hz, rng=rng)
    prepared = [prepare(r, bandwidth_Hz) for r in recordings]
    names = [
        name
        for name in first.parameters
        if name in own.parameters and name not in dataset.model.fixed
    ]
    return Transfer(
        fit=fit_of(prepared, first.fitted, first.alpha),
        own=own.fit,
        floor=noise_floor(prepared, own.fitted, own.alpha),
        by_recording={p.recording.name: fit_of([p], first.fitted, first.alpha) for p in prepared},
        parameters=tuple(moved(first.parameters[name], own.parameters[name]) for name in names),
        other=own,
    )


def moved(first: Parameter, second: Parameter) -> Moved:
    """Compare two estimates of one parameter."""
    halves = (_half_width(first), _half_width(second))
    if first.value is None or second.value is None or halves[0] is None or halves[1] is None:
        return Moved(first.name, first.unit, first, second, None, None, None)
    difference = second.value - first.value
    joint = math.hypot(halves[0], halves[1])
    return Moved(first.name, first.unit, first, second, difference, joint, abs(difference) > joint)


def _half_width(parameter: Parameter) -> float | None:
    if parameter.low is None or parameter.high is None:
        return None
    return 0.5 * (parameter.high - parameter.low)
