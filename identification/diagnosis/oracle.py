"""Computes the oracle of a proof: the error, on recordings set aside, of a model with the true
effects, whose names are given and whose parameters are fitted to the recordings of the diagnosis.

Sizes and nonlinear parameters of the effects, and the nominal parameters, are estimated from the
fitted recordings alone, as in a diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.fit.joint import Added, Joint, fit
from identification.diagnosis.fit.stack import Candidate
from identification.diagnosis.score.significance import trial_candidates
from identification.diagnosis.selection.unseen import validation_rms
from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Context, Effect
from identification.prepare import torque_unit
from identification.recording import Dataset
from identification.views.view import views


@dataclass(frozen=True)
class HeldOut:
    """Rms errors on recordings set aside, in the equation in which the true effects reduce the
    error most.

    Attributes:
        equation: Name of the equation.
        baseline_rms: Error of the nominal model alone, in the unit of the equation.
        oracle_rms: Error with the true effects, in the unit of the equation.
        noise_rms: Noise of one row, in the unit of the equation.
        remaining_strength: Name of each effect to its remaining strength: the error that the effect
            would cause after a new fit of all other parameters without the effect, over the noise
            of a row, in the equation in which this ratio is greatest.
    """

    equation: str
    baseline_rms: float
    oracle_rms: float
    noise_rms: float
    remaining_strength: Mapping[str, float]


def oracle(
    dataset: Dataset, first: Joint, names: Sequence[str], bandwidth_Hz: float
) -> HeldOut | None:
    """Fit the effects with the given names, and compute the errors on the recordings set aside.

    Args:
        dataset: Dataset of the diagnosis.
        first: Fit of the nominal model to the fitted recordings.
        names: Names of the true effects in the catalogue.
        bandwidth_Hz: Bandwidth of all errors.

    Returns:
        The errors; None if the recordings set aside have no row of any equation, or if an effect is
        collinear with the nominal model or its fitted coefficient has an unphysical sign.
    """
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not held:
        return None
    unit = torque_unit(fitted[0])
    gives = any(EFFECTS[name].flexible for name in names)
    here = views(fitted, bandwidth_Hz, gives, dataset.recordings)
    baseline = fit(here, unit, first.nominal)
    left = {
        t.name: t for t in (e.on_the_joint() if gives else e for e in MOTION) if t.name in names
    }
    joint = baseline
    while left:
        best = _best_candidate(joint, list(left.values()))
        if best is None:
            return None
        added = Added(left.pop(best.name), best.shape, tuple(float(c) for c in best.coefficients))
        joint = fit(here, unit, joint.nominal, (*joint.effects, added), baseline)
    aside = views((*fitted, *held), bandwidth_Hz, gives, dataset.recordings)[len(fitted) :]
    before, after = validation_rms(baseline, aside, unit), validation_rms(joint, aside, unit)
    noise = {e.name: e.sigma for e in baseline.equations if e.name in before and e.judges}
    if not noise:
        return None
    where = max(noise, key=lambda name: (before[name] ** 2 - after[name] ** 2) / noise[name] ** 2)
    remaining_strength = {}
    for effect in joint.effects:
        rest = tuple(e for e in joint.effects if e is not effect)
        without = fit(here, unit, joint.nominal, rest, baseline) if rest else baseline
        remaining_strength[effect.term.name] = _remaining_strength(without, joint, list(noise))
    return HeldOut(where, before[where], after[where], noise[where], remaining_strength)


def _remaining_strength(without: Joint, joint: Joint, equations: Sequence[str]) -> float:
    """Return the rms by which the mismatch without an effect exceeds the mismatch with the effect,
    over the noise, in the equation in which this ratio is greatest.
    """
    beyond = []
    for name in equations:
        rows = joint.stack.part(name)
        beyond.append(float(np.mean(without.residual[rows] ** 2 - joint.residual[rows] ** 2)))
    return math.sqrt(max(0.0, *beyond))


def _best_candidate(joint: Joint, terms: Sequence[Effect]) -> Candidate | None:
    """Return the effect, at one set of trial parameters, that explains most of the remaining
    mismatch.
    """
    context = Context(joint.equations[0].views, joint.nominal)
    return max(trial_candidates(joint.stack, context, terms), key=lambda c: c.score, default=None)
