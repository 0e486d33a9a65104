"""The oracle of a proof: held-out error of the true structure, told by name and fitted to the same
data.

Its effects' shapes and sizes, and the nominal parameters, come from the recordings alone, as those
of the diagnosis do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.diagnose import GIVING
from identification.diagnosis.fit.joint import Added, Joint, fit
from identification.diagnosis.fit.stack import Candidate
from identification.diagnosis.rows.view import views
from identification.diagnosis.score.significance import screened
from identification.diagnosis.selection.held_out import held_out
from identification.diagnosis.terms import TERMS
from identification.diagnosis.terms.term import Context, Term
from identification.diagnosis.terms.transmission import on_the_joint
from identification.prepare import torque_unit
from identification.recording import Dataset


@dataclass(frozen=True)
class HeldOut:
    """Errors over recordings set aside in the equation where the true structure gains most.

    Attributes:
        equation: Its name.
        baseline_rms: Of the nominal model alone, in the equation's unit.
        oracle_rms: With the true effects.
        noise_rms: Noise of one row.
        beside: Effect to what the others and a new fit of the constants leave of it, over the noise
            of a row, in the equation that shows it most.
    """

    equation: str
    baseline_rms: float
    oracle_rms: float
    noise_rms: float
    beside: Mapping[str, float]


def oracle(
    dataset: Dataset, first: Joint, names: Sequence[str], bandwidth_Hz: float
) -> HeldOut | None:
    """Fit the effects of these names and score them on the recordings set aside.

    Args:
        dataset: As diagnosed.
        first: The nominal model's fit of its recordings.
        names: True effects, all of the catalogue.
        bandwidth_Hz: Of every error.

    Returns:
        None where nothing was set aside, or where the recordings do not admit one of the effects:
        the nominal model absorbs it, or noise gives it an unphysical sign.
    """
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not held:
        return None
    unit = torque_unit(fitted[0])
    gives = any(name in GIVING for name in names)
    here = views(fitted, bandwidth_Hz, gives, dataset.recordings)
    baseline = fit(here, unit, first.nominal)
    left = {t.name: t for t in (on_the_joint(TERMS) if gives else TERMS) if t.name in names}
    joint = baseline
    while left:
        best = _strongest(joint, list(left.values()))
        if best is None:
            return None
        added = Added(left.pop(best.name), best.shape, tuple(float(c) for c in best.coefficients))
        joint = fit(here, unit, joint.nominal, (*joint.effects, added), baseline)
    aside = views((*fitted, *held), bandwidth_Hz, gives, dataset.recordings)[len(fitted) :]
    before, after = held_out(baseline, aside, unit), held_out(joint, aside, unit)
    # A breakaway is one number for a rest, and its noise that of an instant within a sample: it
    # judges no model.
    noise = {
        e.name: e.sigma for e in baseline.equations if e.name in before and e.name != "breakaway"
    }
    where = max(noise, key=lambda name: (before[name] ** 2 - after[name] ** 2) / noise[name] ** 2)
    beside = {}
    for effect in joint.effects:
        rest = tuple(e for e in joint.effects if e is not effect)
        without = fit(here, unit, joint.nominal, rest, baseline) if rest else baseline
        beside[effect.term.name] = _left(without, joint, list(noise))
    return HeldOut(where, before[where], after[where], noise[where], beside)


def _left(without: Joint, joint: Joint, equations: Sequence[str]) -> float:
    """Return what is left without an effect beyond what is left with it, over the noise, where that
    is most.
    """
    beyond = []
    for name in equations:
        rows = joint.stack.part(name)
        beyond.append(float(np.mean(without.residual[rows] ** 2 - joint.residual[rows] ** 2)))
    return math.sqrt(max(0.0, *beyond))


def _strongest(joint: Joint, terms: Sequence[Term]) -> Candidate | None:
    """Return the effect at the trial shape that explains most of what is left."""
    context = Context(joint.equations[0].views, joint.nominal)
    return max(screened(joint.stack, context, terms), key=lambda c: c.score, default=None)
