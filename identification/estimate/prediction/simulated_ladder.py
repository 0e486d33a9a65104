"""Fits the ladder of friction models to the simulated angle of recordings (M48-M51)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.default import by_load, solve_stages
from identification.estimate.equation_error import common_bandwidth
from identification.estimate.ladder import REPLICATES, Interval
from identification.estimate.prediction.loop_fit import (
    FOLDS,
    LATENESS,
    Constant,
    Coordinates,
    LoopFit,
    Piece,
    Scales,
    constants,
    coordinates,
    drawn,
    errors,
    fit_loop,
    pieces_of,
    pulls,
    refit,
)
from identification.model.ladder import DIRECTIONAL, SIMULATED, bears_load
from identification.model.parameters import DRIVE_SHARE
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.spread import CONFIDENCE
from identification.prepare import Prepared, joint_angle, prepare
from identification.recording import Dataset, Recording

ONE_SIDED = 1.645
"""Number of standard errors by which a cross-validated error must exceed the least cross-validated
error to count as greater.
"""
STARTS = (0.08, 0.2)
"""Further start values of the Stribeck speed, relative to the greatest speed. Several start values
are needed, because stick-slip makes the cost irregular, with local minima at low Stribeck speeds.
"""


@dataclass(frozen=True)
class SimulatedRung:
    """One friction model, fitted to the simulated angle.

    Attributes:
        friction: Name of the rung, of :data:`identification.model.ladder.SIMULATED`.
        free: Whether the motor constants were free within their priors.
        alpha: Stribeck exponent.
        fitted: Parameters by name, SI; ``lateness`` of the command, s.
        train: Mean absolute angle error on the fitted recordings, rad (m).
        crossed: Cross-validated error: mean absolute angle error on each third of the fitted
            recordings, predicted with a fit to the other two thirds, rad (m). NaN for a single
            recording; then no rung is chosen.
        scored: Mean absolute angle error on the recordings with role ``validate``, rad (m), or None
            without such recordings.
        constants: Motor constants and their changes; empty if they were fixed.
        horizon_s: Longest prediction, s.
        best: Share of the draws in which this fit has the least error on the scored recordings.
        chosen: Whether the fit has the least cross-validated error of all fits of equal ``free``.
        tied: Whether the cross-validated error exceeds the least cross-validated error by no more
            than the uncertainty of the difference.
        ends: Cost at the end of the search from each start point.
    """

    friction: str
    free: bool
    alpha: float
    fitted: Mapping[str, float]
    train: Interval
    crossed: float
    scored: Interval | None
    constants: tuple[Constant, ...]
    horizon_s: float
    best: float
    chosen: bool
    tied: bool
    ends: tuple[float, ...]


@dataclass(frozen=True)
class _Problem:
    """Data of all rungs: pieces of the recordings to fit and to score, and draws of these
    recordings.
    """

    dataset: Dataset
    fitted: Sequence[Piece]
    scored: Sequence[Piece]
    scales: Scales
    values: Mapping[str, Mapping[str, float]]
    draws: Sequence[tuple[Array, Array]]


@dataclass(frozen=True)
class _Case:
    """One fit with its bootstrap draws: coordinates of each draw, and errors on fitted and on
    scored recordings.

    ``crossed`` contains the sum of absolute errors and the number of samples of each fitted
    recording, which is predicted with a fit to other recordings, shape (m, 2).
    """

    found: LoopFit
    crossed: Array
    points: Array
    train: tuple[float, Array]
    scored: tuple[float, Array]


def climb_simulated(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None,
    rng: np.random.Generator,
    replicates: int = REPLICATES,
    progress: Progress | None = None,
) -> tuple[SimulatedRung, ...]:
    """Fit every rung to the simulated angle, with fixed and with free motor constants, and score
    the fits.

    Args:
        dataset: Unloaded recordings with an angle, and a controller or a measured drive.
        bandwidth_Hz: Bandwidth of the equation error, which gives the start values of the searches.
        rng: Random generator for the drawn recordings.
        replicates: Number of draws.
        progress: Called with the name of the step and the share done.

    Returns:
        One record for each fit. The list is empty unless each recording is unloaded and has an
        angle and, in addition, either a declared controller and a ``command`` channel, or a motor
        voltage without torque and current. For recordings with torque or current the equation error
        is sufficient.

    Raises:
        RecordingError: A recording cannot be simulated, or cannot be fitted.
    """
    tell = progress or silent
    if not all(map(predictable, dataset.recordings)):
        return ()
    problem = _problem(dataset, bandwidth_Hz, rng, replicates)
    hanging = any(p.recording.pendulum is not None for p in problem.fitted)
    rungs = [r for r in SIMULATED if hanging or not bears_load(r)]
    plan = [(rung, free) for rung in rungs for free in (False, True)]
    cases: dict[tuple[str, bool], _Case] = {}
    for k, (rung, free) in enumerate(plan):
        which = "free" if free else "declared"
        tell(f"{rung}, {which} constants", k / len(plan))
        axes = coordinates(rung, dataset.model, problem.fitted, problem.scales, free=free)
        if free and not axes.prior:
            continue
        ends = {key: case.found for key, case in cases.items()}
        cases[rung, free] = _case(problem, axes, _starts(problem, axes, free, ends))
    tell("simulated ladder", 1.0)
    return tuple(_rungs(problem, cases))


def predictable(recording: Recording) -> bool:
    """Return whether a fit of the predicted angle is useful for a recording: the control loop is
    known, or a motor voltage but neither torque nor current was measured.
    """
    channels, bench = recording.channels, recording.bench
    if joint_angle(recording) is None or recording.stage == "loaded":
        return False
    if recording.controller is not None and "command" in channels:
        return True
    constants = (bench.torque_constant, bench.back_emf_constant, bench.resistance)
    return (
        "voltage" in channels
        and not {"torque", "current"} & channels.keys()
        and None not in constants
    )


def _problem(
    dataset: Dataset, bandwidth_Hz: float | None, rng: np.random.Generator, replicates: int
) -> _Problem:
    to_fit = dataset.part("fit")
    to_score = dataset.part("validate") or to_fit
    if bandwidth_Hz is None:
        bandwidth_Hz = common_bandwidth(to_fit)
    active = [prepare(r, bandwidth_Hz) for r in to_fit]
    aside = [prepare(r, bandwidth_Hz) for r in to_score]
    values = {
        rung: solve_stages(
            *by_load(active), replace(dataset.model, friction=rung), lambda *_: None
        )[0]
        for rung in ("stribeck", "stribeck_load_dependent")
        if not bears_load(rung) or any(r.pendulum is not None for r in to_fit)
    }
    return _Problem(
        dataset=dataset,
        fitted=[piece for p in active for piece in pieces_of(p)],
        scored=[piece for p in aside for piece in pieces_of(p)],
        scales=_scales(active, values["stribeck"]["J"]),
        values=values,
        draws=[(_counts(rng, len(to_fit)), _counts(rng, len(to_score))) for _ in range(replicates)],
    )


def _scales(prepared: Sequence[Prepared], inertia: float) -> Scales:
    recordings = [p.recording for p in prepared]
    hung = [r.known_inertia for r in recordings if r.known_inertia]
    return Scales(
        torque=max(float(np.max(np.abs(p.drive_torque))) for p in prepared),
        speed=max(float(np.max(np.abs(p.velocity))) for p in prepared),
        inertia=max(inertia, 0.1 * min(hung, default=0.0), 1e-12),
        period=float(np.median([r.period for r in recordings])),
    )


def _starts(
    problem: _Problem,
    axes: Coordinates,
    free: bool,
    ends: Mapping[tuple[str, bool], LoopFit],
) -> list[Array]:
    """Return the start points of a search: solutions of the equation error at several Stribeck
    speeds, and the search ends of the simpler models that are special cases of this model.
    """
    values = problem.values["stribeck_load_dependent" if bears_load(axes.rung) else "stribeck"]
    starts = [axes.start(values)]
    contained = [axes.rung] if free else []
    if axes.rung == DIRECTIONAL:
        contained = [r for r in SIMULATED if bears_load(r) and r != DIRECTIONAL] + contained
    starts += [
        _carried(end, axes)
        for (rung, moved), end in ends.items()
        if rung in contained and (moved == free or rung == axes.rung)
    ]
    if axes.rung != DIRECTIONAL:
        for share in STARTS:
            speed = {"omega_sf": share * problem.scales.speed}
            starts.append(axes.start({**values, **speed}))
    return starts


def _carried(end: LoopFit, axes: Coordinates) -> Array:
    """Return the end of another fit in the coordinates of this model, shape (p,)."""
    found = dict(zip(end.coordinates.names, end.x, strict=True))
    share = end.point.values.get(DRIVE_SHARE, 0.0)
    found.setdefault(DRIVE_SHARE, share)
    return axes.box.clip(np.array([found.get(n, 0.0) for n in axes.names]))


def _case(problem: _Problem, axes: Coordinates, starts: Sequence[Array]) -> _Case:
    found = fit_loop(problem.fitted, axes, starts)
    crossed = _crossed(problem, found)
    normals, gradients = pulls(problem.fitted, found)
    points = np.array([drawn(found, normals, gradients, counts) for counts, _ in problem.draws])
    train = _by_recording(problem.fitted, found, found.x)
    scored = _by_recording(problem.scored, found, found.x)
    trained, tested = [], []
    for x, (fit, score) in zip(points, problem.draws, strict=True):
        trained.append(_mean(_by_recording(problem.fitted, found, x), fit))
        tested.append(_mean(_by_recording(problem.scored, found, x), score))
    return _Case(
        found,
        crossed,
        points,
        (_mean(train, np.ones(len(train))), np.array(trained)),
        (_mean(scored, np.ones(len(scored))), np.array(tested)),
    )


def _crossed(problem: _Problem, found: LoopFit) -> Array:
    """Return sum of absolute errors and number of samples of each fitted recording, which is
    predicted with a fit to the other folds, shape (m, 2).
    """
    sums: list[Array] = []
    for names in _folds([p.recording for p in problem.fitted]):
        own = [p for p in problem.fitted if p.recording.name in names]
        others = [p for p in problem.fitted if p.recording.name not in names]
        if others:
            part = refit(others, found)
            sums.append(_by_recording(own, part, part.x))
    return np.concatenate(sums) if sums else np.full((1, 2), math.nan)


def _folds(recordings: Sequence[Recording]) -> Iterator[set[str]]:
    """Yield the names of the recordings in each fold of the cross-validation; recordings with one
    load are in one fold if there are enough different loads.
    """
    loads = {
        r.name: (
            0.0 if r.pendulum is None else r.pendulum.mass * r.pendulum.length,
            r.steady_torque,
        )
        for r in recordings
    }
    levels = sorted(set(loads.values()))
    if len(levels) >= FOLDS:
        group = {name: levels.index(load) for name, load in loads.items()}
    else:
        group = {name: k for k, name in enumerate(loads)}
    for k in range(FOLDS):
        if names := {name for name, index in group.items() if index % FOLDS == k}:
            yield names


def _by_recording(pieces: Sequence[Piece], found: LoopFit, x: Array) -> Array:
    """Return sum of absolute errors and number of samples of each recording, shape (m, 2)."""
    c = found.coordinates
    sums: dict[str, Array] = {}
    for piece, error in zip(pieces, errors(pieces, c.point(x), c.model.alpha), strict=True):
        own = np.array([float(np.sum(np.abs(error))), float(len(error))])
        sums[piece.recording.name] = sums.get(piece.recording.name, 0.0) + own
    return np.array(list(sums.values()))


def _mean(sums: Array, counts: Array) -> float:
    total, samples = counts @ sums
    return float(total / samples)


def _counts(rng: np.random.Generator, size: int) -> Array:
    return np.bincount(rng.integers(0, size, size=size), minlength=size).astype(np.float64)


def _rungs(problem: _Problem, cases: Mapping[tuple[str, bool], _Case]) -> Iterator[SimulatedRung]:
    aside = bool(problem.dataset.part("validate"))
    table = np.array([case.scored[1] for case in cases.values()])
    winners = np.argmin(table, axis=0) if table.size else np.array([])
    for k, ((rung, free), case) in enumerate(cases.items()):
        rivals = [c for (_, other), c in cases.items() if other == free]
        least = min(rivals, key=lambda c: _crossed_error(c.crossed))
        point = case.found.point
        yield SimulatedRung(
            friction=rung,
            free=free,
            alpha=problem.dataset.model.alpha,
            fitted={**point.values, LATENESS: point.lateness},
            train=_interval(*case.train),
            crossed=_crossed_error(case.crossed),
            scored=_interval(*case.scored) if aside else None,
            constants=constants(problem.fitted, case.found, case.points),
            horizon_s=max(float(p.inputs.time[-1] - p.inputs.time[0]) for p in problem.fitted),
            best=float(np.mean(winners == k)),
            chosen=case is least and math.isfinite(_crossed_error(case.crossed)),
            tied=_tied(case.crossed, least.crossed),
            ends=case.found.ends,
        )


def _crossed_error(sums: Array) -> float:
    return float(np.sum(sums[:, 0]) / np.sum(sums[:, 1]))


def _tied(sums: Array, least: Array) -> bool:
    """Return whether the sum of the errors exceeds that of the best model by no more than 1.645
    standard errors, which are computed from the differences for each recording.
    """
    apart = sums[:, 0] / sums[:, 1] - least[:, 0] / least[:, 1]
    if not np.all(np.isfinite(apart)):
        return False
    if len(apart) < 2:
        return not np.any(apart > 0.0)
    deviation = float(np.std(apart, ddof=1)) / math.sqrt(len(apart))
    return bool(np.mean(apart) <= ONE_SIDED * deviation)


def _interval(value: float, draws: Array) -> Interval:
    low, high = np.quantile(draws, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return Interval(value, float(low), float(high))
