"""Computes the errors of an identified model on other recordings (another day, unit or load)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.estimate.default import identify
from identification.estimate.equation_error.noise_floor import Floor, noise_floor
from identification.estimate.uncertainty.parameter_table import fit_of
from identification.model.parameters import LOAD_PARAMETERS
from identification.prepare import prepare
from identification.recording import Dataset, RecordingError
from identification.result import Fit, Identification, Parameter


@dataclass(frozen=True)
class Moved:
    """Comparison of two estimates of one parameter, from two groups of recordings.

    Attributes:
        name: Name of the parameter.
        unit: Unit, SI.
        first: Estimate from the first recordings.
        second: Estimate from the other recordings alone.
        difference: Second estimate less first estimate, or None if the parameter is not
            identifiable from the first or from the other recordings.
        joint: Half width of the 90 % interval of the difference, for independent estimates.
        moved: Whether the difference exceeds this half width.
    """

    name: str
    unit: str
    first: Parameter
    second: Parameter
    difference: float | None
    joint: float | None
    moved: bool | None


@dataclass(frozen=True)
class Transfer:
    """Result of applying a fitted model to other recordings.

    Attributes:
        fit: Torque error of the transferred model on the other recordings.
        own: Torque error of the model identified on the other recordings.
        floor: Noise floor of the other recordings, or None if they contain no repeated motion.
        by_recording: Torque error of the transferred model on each recording.
        parameters: Comparison of each parameter.
        other: The identification of the other recordings.
    """

    fit: Fit
    own: Fit
    floor: Floor | None
    by_recording: Mapping[str, Fit]
    parameters: tuple[Moved, ...]
    other: Identification


def transfer(
    first: Identification,
    dataset: Dataset,
    other: Dataset,
    rng: np.random.Generator | None = None,
) -> Transfer:
    """Score a fitted model on other recordings, and compare it with an identification of the other
    recordings.

    The other recordings are identified with the model and bandwidth of the first fit; those with
    role ``validate`` are not fitted.

    Args:
        first: The fit to transfer.
        dataset: Dataset of the fit to transfer; its declared model applies to both datasets.
        other: Other recordings.
        rng: Random generator for the identification of the other recordings, or None for seed 0.

    Raises:
        RecordingError: The other recordings do not support the model, or include a recording to
            which the model was fitted.
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
