"""Starts a diagnosis: fits the nominal model to all equations, starting from the values of the
equation error and from assumed falls of friction with speed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.diagnosis.fit.joint import Joint, fit
from identification.diagnosis.fit.within_limits import infeasible_as_fitted
from identification.diagnosis.rules import RULES
from identification.estimate.default import free_names, solve_stages
from identification.estimate.equation_error import LEAST_MOTION, common_bandwidth, samples_in_motion
from identification.model.ladder import LADDER, bears_load
from identification.prepare import prepare, torque_unit
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.views.nominal import Nominal
from identification.views.view import View, views

SPEED_QUANTILES, TRIAL_SPEEDS = (0.02, 0.3), 3
"""Quantiles of the speed between which trial Stribeck speeds are placed, and number of trial
Stribeck speeds.
"""
ACCEPTED_RATIO = 0.7
"""Greatest ratio of the sum of squares of a fit from an assumed fall of friction to that of the
fit from the estimate, for which the assumed fall is accepted.

In simulated trials in which an injected effect masked the fall of friction the ratio was 0.06 to
0.6; a wrong fall lowers the sum of squares by a few per cent.
"""
GREATEST_BANDWIDTH_HZ = 25.0
"""Greatest bandwidth, unless too few samples are in motion at this bandwidth. A higher bandwidth
adds noise and hardly any contribution of the effects.
"""
RUNG_WITHOUT_LOAD: Mapping[str, str] = {
    "load_dependent": "coulomb_viscous",
    "stribeck_load_dependent": "stribeck",
}
"""Rung with load-dependent friction to the rung without load-dependent friction, which replaces it
if no load is declared.
"""


def bandwidth_of(recordings: Sequence[Recording]) -> float:
    """Return the common bandwidth of all errors, Hz."""
    return common_bandwidth(recordings, GREATEST_BANDWIDTH_HZ)


def views_and_fit(dataset: Dataset, bandwidth_Hz: float) -> tuple[tuple[View, ...], Joint]:
    """Return views of the recordings to fit, and the fit of the nominal model to these recordings.

    Raises:
        RecordingError: The recordings do not determine the nominal model, or do not support a
            declared term.
    """
    fitted = dataset.part("fit")
    start = estimated_nominal(dataset, fitted, bandwidth_Hz)
    here = views(fitted, bandwidth_Hz, campaign=dataset.recordings)
    return here, fit_from_estimate(here, torque_unit(fitted[0]), start, dataset.model)


def fit_from_estimate(here: Sequence[View], unit: str, start: Nominal, model: Model) -> Joint:
    """Fit the nominal model, starting from the estimate and, if the mismatch of this fit exceeds
    the noise, from assumed falls of friction with speed too.

    An unmodelled effect can mask the fall of friction with speed in an estimate, so that the
    estimate has no fall; no later step of a fit finds the fall.
    """
    return with_assumed_fall(here, unit, fit(here, unit, start), start, model.fixed)


def with_assumed_fall(
    here: Sequence[View], unit: str, first: Joint, start: Nominal, fixed: Collection[str]
) -> Joint:
    """Return the fit ``first``, or a fit with the same effects that starts from an assumed fall of
    friction with speed, if the mismatch of the latter is far smaller.

    Args:
        here: Recordings.
        unit: Unit of the torque.
        first: The fit; if its mismatch is within the noise, no other fit is tried.
        start: Nominal values from which this fit started.
        fixed: Names of nominal parameters that are not estimated.
    """
    if _mean_square(first) < RULES.excess:
        return first
    raised = [start.raised(omega, fixed) for omega in _trial_stribeck_speeds(here)]
    other = min((fit(here, unit, r, first.effects, first) for r in raised), key=_mean_square)
    return other if _mean_square(other) < ACCEPTED_RATIO * _mean_square(first) else first


def feasible_or_first(here: Sequence[View], unit: str, first: Joint) -> Joint:
    """Return the fit ``first`` or, if it is infeasible, a feasible fit that starts from an assumed
    fall of friction with speed.

    The static friction of the load may become equal to Coulomb friction during a fit, because few
    rows are slow enough to determine the static friction; no later step separates the two levels.

    Args:
        here: Recordings.
        unit: Unit of the torque.
        first: The fit; if it is feasible, no other fit is tried.
    """
    if not infeasible_as_fitted(first):
        return first
    held = first.nominal.values.keys() - set(first.nominal.free)
    again = fit(
        here,
        unit,
        first.nominal.raised(_trial_stribeck_speeds(here)[TRIAL_SPEEDS // 2], held),
        first.effects,
        first,
    )
    return first if infeasible_as_fitted(again) else again


def _trial_stribeck_speeds(here: Sequence[View]) -> list[float]:
    """Return trial Stribeck speeds of the assumed fall of friction, rad/s."""
    speed = np.concatenate([np.abs(v.low_pass(v.velocity))[v.moving] for v in here])
    low, high = np.quantile(speed, SPEED_QUANTILES)
    return [float(omega) for omega in np.geomspace(low, high, TRIAL_SPEEDS)]


def _mean_square(joint: Joint) -> float:
    """Return the mean-square torque mismatch relative to that of the noise; 0 without torque
    rows.
    """
    rows = joint.residual[joint.stack.part("torque")]
    return float(np.mean(rows**2)) if len(rows) else 0.0


def estimated_nominal(
    dataset: Dataset, recordings: Sequence[Recording], bandwidth: float
) -> Nominal:
    """Estimate the nominal parameters from some recordings of a dataset, by variable projection.

    Raises:
        RecordingError: The unloaded or the loaded recordings have no motion, or all recordings are
            loaded.
    """
    prepared = [prepare(r, bandwidth) for r in recordings]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    model = dataset.model
    unknown = bears_load(model.friction) and not any(r.known_load for r in recordings)
    if unknown:
        model = replace(model, friction=RUNG_WITHOUT_LOAD[model.friction])
    values, _ = solve_stages(unloaded, loaded, model, lambda _stage, _share: None)
    free = free_names(values, model)
    if unknown:
        gear = [
            name for name in LADDER[dataset.model.friction] if name not in LADDER[model.friction]
        ]
        values = {**values, **dict.fromkeys(gear, 0.0)}
        free = (
            *free,
            *(
                name
                for name in gear
                if name not in model.fixed and (name == "mu_gc" or "Ms" in free)
            ),
        )
    return Nominal(values, free, model.alpha)


# Chooses the recordings and the bandwidth of a diagnosis.


class Chosen(NamedTuple):
    """Recordings and bandwidth of a diagnosis.

    Attributes:
        dataset: The dataset; recordings that cannot be used have the role ``unused``.
        bandwidth: Bandwidth of all errors, Hz.
        warnings: Texts that state which recordings are not used, and why.
    """

    dataset: Dataset
    bandwidth: float
    warnings: tuple[str, ...] = ()


def choose(dataset: Dataset, bandwidth_Hz: float | None) -> Chosen:
    """Return the recordings to use, and the bandwidth of all errors.

    Loaded recordings in which the joint rests nearly all the time do not determine friction under
    load. Such recordings are not used, and only the unloaded recordings are diagnosed.

    Args:
        dataset: The dataset.
        bandwidth_Hz: Bandwidth of all errors, or None for a bandwidth chosen from the recordings.

    Raises:
        RecordingError: No recording has the role ``fit``.
    """
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError(
            "no recording has the role fit, but a diagnosis needs at least one; set `role: fit` in "
            "the campaign file"
        )
    bandwidth = bandwidth_Hz or bandwidth_of(fitted)
    moving = {
        stage: samples_in_motion([prepare(r, bandwidth) for r in fitted if r.stage == stage])
        for stage in {r.stage for r in fitted}
    }
    rests = moving.get("loaded", LEAST_MOTION) < LEAST_MOTION
    if not rests or moving.get("unloaded", 0) < LEAST_MOTION:
        return Chosen(dataset, bandwidth)
    kept = tuple(
        replace(r, role="unused") if r.stage == "loaded" else r for r in dataset.recordings
    )
    names = ", ".join(r.name for r in dataset.recordings if r.stage == "loaded")
    warning = (
        f"{names}: at a bandwidth of {bandwidth:.3g} Hz these loaded recordings have "
        f"{moving['loaded']} samples in motion, and at least {LEAST_MOTION} are needed. Therefore "
        "no loaded recording is used, and effects of the load are not diagnosed; add recordings in "
        "which the loaded joint moves longer"
    )
    return Chosen(replace(dataset, recordings=kept), bandwidth, (warning,))
