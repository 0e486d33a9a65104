"""Fits every friction model of the ladder to one dataset and scores it on validation recordings.

A rung is one friction model of the ladder. Intervals are computed by a bootstrap over recordings:
recordings to fit and recordings to score are drawn with replacement, with the same draws for every
rung (Efron and Tibshirani, An Introduction to the Bootstrap, ch. 8). Whole recordings are drawn,
because samples within a recording are correlated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.default import identify
from identification.estimate.equation_error.bandwidth import common_bandwidth
from identification.estimate.ladder_bootstrap import Indices, Redraw, Score
from identification.model.ladder import LADDER, bears_load
from identification.numerics.progress import Progress, silent
from identification.numerics.spread import CONFIDENCE
from identification.prepare import Prepared, prepare
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification
from identification.simulate.closed_loop import replay
from identification.simulate.score import Sums, compare, pooled

REPLICATES = 100
"""Number of bootstrap draws."""


@dataclass(frozen=True)
class Interval:
    """A value and its 90 % interval, by a bootstrap over recordings."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        friction: Name of the rung.
        result: The fit to all recordings with role ``fit``.
        train: Torque error on the fitted recordings, in the unit of the fit.
        scored: Torque error on the recordings with role ``validate``, or None without such
            recordings.
        angle: Rms angle error of the simulated control loop, rad (m), on the validation recordings,
            or on the fitted recordings if there are no validation recordings; None without a
            controller.
        angle_mae: Mean absolute angle error on the recordings of ``angle``, rad (m).
        best: Share of the bootstrap draws in which this rung has the least torque error on the
            scored recordings.
    """

    friction: str
    result: Identification
    train: Interval
    scored: Interval | None
    angle: Interval | None
    angle_mae: Interval | None
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

    Args:
        dataset: Unloaded recordings; rungs with load-dependent friction need a pendulum.
        bandwidth_Hz: Bandwidth of torque and regressors, or None for the bandwidth that
            :func:`identification.estimate.default.identify` chooses.
        rng: Random generator for the drawn recordings and the simulated replicates.
        replicates: Number of bootstrap draws.
        progress: Called with the name of the step and the share done.

    Raises:
        RecordingError: A recording is loaded, or cannot be fitted.
    """
    tell = progress or silent
    to_fit = _to_fit(dataset)
    to_score = dataset.part("validate") or to_fit
    if bandwidth_Hz is None:
        bandwidth_Hz = common_bandwidth(to_fit)
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
            train=_interval(result.fit.train_rms, [s.train for s in scores]),
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
    """Return the recordings to fit.

    Raises:
        RecordingError: A recording is loaded, or none has role ``fit``.
    """
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
    return None if value is None else _interval(value, [s.torque for s in scores])


def _angles(result: Identification, prepared: Sequence[Prepared]) -> Sums:
    return pooled(compare(p, replay(p.recording, result.fitted, result.alpha)) for p in prepared)


def _angle(
    sums: Sums | None, measure: Callable[[Sums], float], draws: Sequence[float | None]
) -> Interval | None:
    if sums is None:
        return None
    return _interval(measure(sums), [drawn for drawn in draws if drawn is not None])


def _draw(rng: np.random.Generator, count: int) -> Indices:
    return np.asarray(rng.integers(0, count, size=count), dtype=np.int64)


def _interval(value: float, draws: Sequence[float]) -> Interval:
    low, high = np.quantile(draws, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return Interval(value, float(low), float(high))
