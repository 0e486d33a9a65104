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

from identification.diagnosis.held_out import validation_rms
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.significance import trial_candidates
from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Context
from identification.prepare import torque_unit
from identification.recording import Dataset
from identification.views.view import views


@dataclass(frozen=True)
class HeldOut:
    """Rms errors on recordings set aside, in the equation in which the true effects help most."""

    equation: str  # name of the equation
    baseline_rms: float  # error of the nominal model alone, in the unit of the equation
    oracle_rms: float  # error with the true effects, in the unit of the equation
    noise_rms: float  # noise of one row, in the unit of the equation
    # Name of each effect to its remaining strength: the error that the effect would cause after a
    # new fit of all other parameters without the effect, over the noise of a row, in the equation
    # in which this ratio is greatest.
    remaining_strength: Mapping[str, float]


def oracle(
    dataset: Dataset, first: Joint, names: Sequence[str], bandwidth_Hz: float
) -> HeldOut | None:
    """Fit the effects with the given names, and compute the errors on the recordings set aside.

    The result is None if these recordings have no row of any equation, or if an effect is collinear
    with the nominal model or its fitted coefficient has an unphysical sign.
    """
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not held:
        return None
    gives = any(EFFECTS[name].flexible for name in names)
    here = views(fitted, bandwidth_Hz, gives, dataset.recordings)
    baseline = fit(here, torque_unit(fitted[0]), first.nominal)
    left = {
        t.name: t for t in (e.on_the_joint() if gives else e for e in MOTION) if t.name in names
    }
    joint = baseline
    while left:
        trials = trial_candidates(
            joint.stack, Context(joint.views, joint.nominal), list(left.values())
        )
        best = max(trials, key=lambda c: c.score, default=None)
        if best is None:
            return None
        added = Added(left.pop(best.name), best.shape, tuple(float(c) for c in best.coefficients))
        joint = baseline.again(joint.nominal, (*joint.effects, added))
    aside = views((*fitted, *held), bandwidth_Hz, gives, dataset.recordings)[len(fitted) :]
    before, after = validation_rms(baseline, aside), validation_rms(joint, aside)
    noise = {e.name: e.sigma for e in baseline.equations if e.name in before and e.judges}
    if not noise:
        return None
    where = max(noise, key=lambda name: (before[name] ** 2 - after[name] ** 2) / noise[name] ** 2)
    remaining_strength = {}
    for effect in joint.effects:
        rest = tuple(e for e in joint.effects if e is not effect)
        without = baseline.again(joint.nominal, rest) if rest else baseline
        beyond = [
            float(np.mean(without.residual[rows] ** 2 - joint.residual[rows] ** 2))
            for rows in map(joint.stack.part, noise)
        ]
        remaining_strength[effect.term.name] = math.sqrt(max(0.0, *beyond))
    return HeldOut(where, before[where], after[where], noise[where], remaining_strength)
