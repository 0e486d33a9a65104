"""Re-estimation of the noise after an effect is identified, since fast unexplained effects were
counted as noise.

A torque with seven periods per motor turn, or a hundred per turn of the joint, differs from row to
row as noise does. With a noise five times too large no other effect can be detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from identification.diagnosis.fit.joint import Joint, fit
from identification.diagnosis.rows.equations import Equation, least_noise, noise, without_tones
from identification.diagnosis.rows.view import View
from identification.recording import Array

QUICK = ("cogging", "torque_ripple", "gear_mesh_ripple")
"""Effects that may vary by their full amplitude from row to row."""
QUIETER = 0.5
"""Ratio of new to old noise estimate, below which the new one is used.

On simulated benches strong waves gave 0.13 to 0.2. On a single turn of a real motor it was 0.55
after its cogging, and the rest was outside the catalogue.
"""


def quieter(views: Sequence[View], unit: str, baseline: Joint, joint: Joint) -> tuple[Joint, Joint]:
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
    if joint.effects[-1].term.name not in QUICK:
        return baseline, joint
    found = tuple(
        _measured(e, joint.residual[joint.stack.part(e.name)] * e.sigma) for e in joint.equations
    )
    shares = {e.name: now / e.sigma for e, now in zip(joint.equations, found, strict=True)}
    if min(shares.values()) >= QUIETER:
        return baseline, joint
    before = _over(baseline, shares)
    return before, fit(views, unit, joint.nominal, joint.effects, before)


def _measured(equation: Equation, left: Array) -> float:
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


def _over(baseline: Joint, shares: dict[str, float]) -> Joint:
    """Return the fit of the nominal model with the noise of each equation multiplied by its share;
    the equations have no common parameters.
    """
    residual = baseline.residual.copy()
    for name, share in shares.items():
        residual[baseline.stack.part(name)] /= share
    equations = tuple(replace(e, sigma=e.sigma * shares[e.name]) for e in baseline.equations)
    stack = replace(baseline.stack, equations=equations, residual=residual)
    return replace(baseline, equations=equations, residual=residual, stack=stack)
