"""Where a diagnosis begins: the nominal parameters as the default estimator has them, fitted to all
equations.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.contest import broken
from identification.diagnosis.joint import Joint, fit
from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View, views
from identification.estimate.default import free_names, solve_stages
from identification.model.ladder import LADDER, bears_load
from identification.prepare import default_bandwidth, prepare, torque_unit
from identification.recording import Dataset, Model, Recording

FALLING, FALLS = (0.02, 0.3), 3
"""Quantiles of the speed between which friction's fall is tried, and how many."""
WORTH_RAISING = 0.7
"""Squares left over those from the estimate's own start, below which a supposed fall is taken.

On simulated rigs whose fall was hidden it was 0.06 to 0.6; a few per cent can be had by a wrong
one.
"""
GREATEST_BANDWIDTH_HZ = 25.0
"""Above this hardly any effect of the catalogue adds to what is below, and noise does."""
UNBURDENED: Mapping[str, str] = {
    "load_dependent": "coulomb_viscous",
    "stribeck_load_dependent": "stribeck",
}
"""Rung of friction under a load to what is left of it where no load is declared."""
NEAR_FLOOR = 1.5
"""Mean square of the mismatch over that of the noise, below which it counts as explained."""


def common_bandwidth(recordings: Sequence[Recording]) -> float:
    """Return the bandwidth of every error, Hz: the least of what each recording bears."""
    return min(GREATEST_BANDWIDTH_HZ, *(default_bandwidth(r) for r in recordings))


def begun(dataset: Dataset, bandwidth_Hz: float) -> tuple[tuple[View, ...], Joint]:
    """Return views of the recordings to fit, and the nominal model's fit of them.

    Raises:
        RecordingError: The recordings cannot pin the nominal model, or a declared term cannot be
            granted.
    """
    fitted = dataset.part("fit")
    start = estimated(dataset, fitted, bandwidth_Hz)
    here = views(fitted, bandwidth_Hz, campaign=dataset.recordings)
    return here, started(here, torque_unit(fitted[0]), start, dataset.model)


def started(here: Sequence[View], unit: str, start: Nominal, model: Model) -> Joint:
    """Fit the nominal model from the estimate and, where that leaves more than noise, from rises of
    friction as well.

    What is missing can hide the fall of friction from an estimate, and no step of a fit brings it
    back.
    """
    return or_raised(here, unit, fit(here, unit, start), start, model.fixed)


def or_raised(
    here: Sequence[View], unit: str, first: Joint, start: Nominal, fixed: Collection[str]
) -> Joint:
    """Return a fit, or one with the same effects that began from a supposed fall of friction and
    leaves far less.

    Args:
        here: Recordings.
        unit: Of the torque.
        first: The fit; where it leaves no more than noise nothing else is tried.
        start: Nominal values that it began from.
        fixed: Names of nominal parameters that are not asked for.
    """
    if _squares(first) < NEAR_FLOOR:
        return first
    raised = [start.raised(omega, fixed) for omega in _falls(here)]
    other = min((fit(here, unit, r, first.effects, first) for r in raised), key=_squares)
    return other if _squares(other) < WORTH_RAISING * _squares(first) else first


def or_kept(here: Sequence[View], unit: str, first: Joint) -> Joint:
    """Return a fit, or one begun anew from a supposed fall of friction whose constants keep what
    the first's do not.

    A rise under load that falls to nothing on the way, where hardly any row is slow enough to tell,
    never comes back.

    Args:
        here: Recordings.
        unit: Of the torque.
        first: The fit; where its constants keep what it promises nothing else is tried.
    """
    if not broken(first):
        return first
    held = first.nominal.values.keys() - set(first.nominal.free)
    again = fit(
        here, unit, first.nominal.raised(_falls(here)[FALLS // 2], held), first.effects, first
    )
    return first if broken(again) else again


def _falls(here: Sequence[View]) -> list[float]:
    """Return speeds that friction is tried to fall by, rad/s."""
    speed = np.concatenate([np.abs(v.low_pass(v.velocity))[v.moving] for v in here])
    low, high = np.quantile(speed, FALLING)
    return [float(omega) for omega in np.geomspace(low, high, FALLS)]


def _squares(joint: Joint) -> float:
    """Return the mean square of the torque's mismatch over the noise's; 0 without a row of it."""
    rows = joint.residual[joint.stack.part("torque")]
    return float(np.mean(rows**2)) if len(rows) else 0.0


def estimated(dataset: Dataset, recordings: Sequence[Recording], bandwidth: float) -> Nominal:
    """Return the nominal parameters of some of a dataset's recordings by variable projection.

    Raises:
        RecordingError: A stage without motion, or loaded recordings alone.
    """
    prepared = [prepare(r, bandwidth) for r in recordings]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    model = dataset.model
    unknown = bears_load(model.friction) and all(r.pendulum is None for r in recordings)
    if unknown:
        model = replace(model, friction=UNBURDENED[model.friction])
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
