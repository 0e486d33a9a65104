"""Estimates the noise again after an effect is identified, because a fast effect counts as noise
before it is identified.

A torque with seven periods per motor turn, or a hundred periods per turn of the joint, varies from
row to row like noise. If the noise estimate is five times too large, no other effect can be
detected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from identification.diagnosis.fit.joint import Joint, fit
from identification.diagnosis.rows.equations import (
    Equation,
    held_voltage,
    least_noise,
    noise,
    own_noise,
    without_tones,
)
from identification.views.view import View

LOWER_NOISE_RATIO = 0.5
"""Ratio of the new to the old noise estimate, below which the new estimate is used.

On simulated benches with strong periodic effects the ratio was 0.13 to 0.2. On a real motor with
cogging and a mismatch outside the catalogue the ratio was 0.55.
"""


def with_lower_noise(
    views: Sequence[View], unit: str, baseline: Joint, joint: Joint
) -> tuple[Joint, Joint]:
    """Return the fit of the nominal model and the fit with effects, both with the noise that is
    estimated from the fit with effects, if this noise is lower.

    The function is called only after a fast effect is identified: slow effects do not change the
    differences from row to row, from which the noise is estimated.

    Args:
        views: Recordings.
        unit: Unit of the torque.
        baseline: Fit of the nominal model.
        joint: Fit with every effect identified so far.
    """
    if not joint.effects[-1].term.fast:
        return baseline, joint
    before = _with_lower(baseline, [_with_noise_of(e, joint) for e in joint.equations])
    if before is baseline:
        return baseline, joint
    return before, fit(views, unit, joint.nominal, joint.effects, before)


def _with_noise_of(equation: Equation, joint: Joint) -> Equation:
    """Return an equation with the noise that is estimated from the residual of a fit, but at most
    the present noise.
    """
    if not equation.judges:
        return equation
    rest = without_tones(
        joint.residual[joint.stack.part(equation.name)], equation.owner, equation.time
    )
    scatter = equation.sigma * noise(rest, equation.owner, equation.views[0].low_pass)
    least = max(math.hypot(scatter, held_voltage(equation)), least_noise(equation))
    sigma = min(equation.sigma, least)
    ratio = equation.sigma / sigma
    return replace(equation, sigma=sigma, own=own_noise(equation, rest * ratio))


def _with_lower(baseline: Joint, equations: Sequence[Equation]) -> Joint:
    """Return the fit of the nominal model with the noise of ``equations``, if in one equation this
    noise is less than `LOWER_NOISE_RATIO` times the present noise. Otherwise, if the own noise of
    one recording is lower by this ratio, return the fit with the own noise of the recordings. The
    equations have no common parameters, so that the fit does not change.
    """
    pairs = list(zip(equations, baseline.equations, strict=True))
    if all(e.sigma >= LOWER_NOISE_RATIO * old.sigma for e, old in pairs):
        pairs = [(_with_noise(e, old.sigma), old) for e, old in pairs]
        if all(
            power >= LOWER_NOISE_RATIO**2 * old.own.get(index, 1.0)
            for e, old in pairs
            for index, power in e.own.items()
        ):
            return baseline
    shares = {e.name: e.sigma / old.sigma for e, old in pairs}
    residual = baseline.residual.copy()
    for name, share in shares.items():
        residual[baseline.stack.part(name)] /= share
    kept = tuple(replace(old, sigma=e.sigma, own=e.own) for e, old in pairs)
    stack = replace(baseline.stack, equations=kept, residual=residual)
    return replace(baseline, equations=kept, residual=residual, stack=stack)


def _with_noise(equation: Equation, sigma: float) -> Equation:
    """Return an equation with another noise; the own noise of each recording, if greater than the
    noise of the equation, does not change.
    """
    ratio = equation.sigma / sigma
    own = {index: max(1.0, power * ratio**2) for index, power in equation.own.items()}
    return replace(equation, sigma=sigma, own=own)
