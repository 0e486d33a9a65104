"""Fits every friction model of the ladder to one dataset, and applies a model to other recordings.

A rung is one friction model of the ladder; its errors are stated on the recordings fitted and on
those set aside.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.bandwidth import choose_bandwidth
from identification.estimate.default import identify
from identification.estimate.equation_error import Floor, noise_floor
from identification.estimate.parameter_table import fit_of
from identification.model.parameters import LADDER, LOAD_PARAMETERS, bears_load
from identification.numerics.arrays import Progress, silent
from identification.prepare import prepare
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Fit, Identification, Parameter
from identification.simulation.closed_loop import Sums, compare_angle, pooled, replay


@dataclass(frozen=True)
class Rung:
    """One model of the ladder."""

    friction: str
    result: Identification  # its `fit` has the torque errors
    # Errors of the angle of the simulated control loop on the recordings with role `validate`, or
    # on the fitted recordings if there are none; None without a controller.
    angle: Sums | None


def climb(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> tuple[Rung, ...]:
    """Fit and score every rung for which the recordings have the necessary channels and loads.

    ``dataset``: unloaded recordings; rungs with load-dependent friction need a pendulum.
    ``bandwidth_Hz``: bandwidth of torque and regressors, or None for the bandwidth that
    :func:`identification.estimate.default.identify` chooses. ``rng``: random generator for the
    simulated replicates.
    """
    tell = progress or silent
    chosen, bandwidth_Hz, _ = choose_bandwidth(dataset, bandwidth_Hz)
    loaded = [r.name for r in chosen.recordings if r.stage == "loaded"]
    if loaded:
        raise RecordingError(
            f"{loaded[0]}: the recording is loaded, but the friction ladder describes friction "
            "without load; remove all loaded recordings"
        )
    to_fit = chosen.part("fit")
    to_score = chosen.part("validate") or to_fit
    simulated = all(r.controller is not None and "command" in r.channels for r in to_score)
    hanging = any(r.known_load for r in to_fit)
    names = [name for name in LADDER if hanging or not bears_load(name)]
    rungs = []
    for k, name in enumerate(names):
        tell(f"{name}: fit", k / len(names))
        one = replace(dataset, model=replace(dataset.model, friction=name))
        result = identify(one, bandwidth_Hz=bandwidth_Hz, rng=rng)
        rungs.append(Rung(name, result, _angle(result, to_score) if simulated else None))
    tell("ladder", 1.0)
    return tuple(rungs)


def _angle(result: Identification, recordings: tuple[Recording, ...]) -> Sums:
    return pooled(compare_angle(r, replay(r, result.fitted, result.alpha)) for r in recordings)


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
