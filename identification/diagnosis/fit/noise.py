"""Estimates the noise again after an effect is identified, since fast unexplained effects were
counted as noise.

A torque with seven periods per motor turn, or a hundred per turn of the joint, differs from row to
row as noise does. With a noise estimate that is five times too large no other effect can be
detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from identification.diagnosis.fit.joint import Joint, fit
from identification.diagnosis.rows.equations import Equation, least_noise
from identification.diagnosis.rows.row_noise import noise, without_tones
from identification.diagnosis.rows.view import View
from identification.recording import Array

FAST_EFFECTS = ("cogging", "torque_ripple", "gear_mesh_ripple")
"""Effects that may vary by their full amplitude from row to row."""
LOWER_NOISE_RATIO = 0.5
"""Ratio of the new to the old noise estimate, below which the new one is used.

On simulated benches with strong waves the ratio was 0.13 to 0.2. On a real motor with cogging and a
mismatch outside the catalogue it was 0.55.
"""


def with_lower_noise(
    views: Sequence[View], unit: str, baseline: Joint, joint: Joint
) -> tuple[Joint, Joint]:
    """Return the fits of the nominal model and with effects, both with the noise estimated from the
    latter if that is lower.

    Used only after a fast effect: slow ones do not affect the differences from which the noise is
    estimated.

    Args:
        views: Recordings.
        unit: Unit of the torque.
        baseline: Fit of the nominal model.
        joint: Fit with every effect identified so far.
    """
    if joint.effects[-1].term.name not in FAST_EFFECTS:
        return baseline, joint
    found = tuple(
        _noise_estimate(e, joint.residual[joint.stack.part(e.name)] * e.sigma)
        for e in joint.equations
    )
    shares = {e.name: now / e.sigma for e, now in zip(joint.equations, found, strict=True)}
    if min(shares.values()) >= LOWER_NOISE_RATIO:
        return baseline, joint
    before = _with_scaled_noise(baseline, shares)
    return before, fit(views, unit, joint.nominal, joint.effects, before)


def _noise_estimate(equation: Equation, left: Array) -> float:
    """Return the noise of an equation estimated from its remaining mismatch, at most the present
    estimate.
    """
    if equation.name == "breakaway":
        return equation.sigma
    found = noise(
        without_tones(left, equation.owner, equation.time),
        equation.owner,
        equation.views[0].low_pass,
    )
    return min(equation.sigma, max(found, least_noise(equation)))


def _with_scaled_noise(baseline: Joint, shares: dict[str, float]) -> Joint:
    """Return the fit of the nominal model with the noise of each equation multiplied by its share;
    the equations have no common parameters.
    """
    residual = baseline.residual.copy()
    for name, share in shares.items():
        residual[baseline.stack.part(name)] /= share
    equations = tuple(replace(e, sigma=e.sigma * shares[e.name]) for e in baseline.equations)
    stack = replace(baseline.stack, equations=equations, residual=residual)
    return replace(baseline, equations=equations, residual=residual, stack=stack)
