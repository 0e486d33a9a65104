"""The noise measured again once an effect is named: what moves quickly passed for noise while
nothing explained it.

A torque that swings seven times a motor turn, a hundred times a turn of the joint, differs from row
to row as noise does. With the noise five times too large nothing else is ever missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from identification.diagnosis.equations import Equation, least_noise, noise, without_tones
from identification.diagnosis.joint import Joint, fit
from identification.diagnosis.rows.view import View
from identification.recording import Array

QUICK = ("cogging", "torque_ripple", "gear_mesh_ripple")
"""Effects that swing from row to row as far as they swing at all."""
QUIETER = 0.5
"""Noise over what it was taken for, below which it is taken anew.

On simulated benches strong waves leave 0.13 to 0.2. On a real motor's single turn it was 0.55 after
its cogging, and what stood out of it was in no catalogue.
"""


def quieter(views: Sequence[View], unit: str, baseline: Joint, joint: Joint) -> tuple[Joint, Joint]:
    """Return the nominal model's fit and one with effects, both over the noise that the latter
    leaves if that is less.

    Asked after a quick effect alone: what moves slowly was never in the differences that the noise
    is measured by.

    Args:
        views: Recordings.
        unit: Of the torque.
        baseline: The nominal model's fit.
        joint: With every effect named so far.
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
    """Return the noise of an equation's rows as what is left of them has it, no more than it was
    taken for.
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
    """Return the nominal model's fit, whose equations share nothing, over noise that is these
    shares of what it was.
    """
    residual = baseline.residual.copy()
    for name, share in shares.items():
        residual[baseline.stack.part(name)] /= share
    equations = tuple(replace(e, sigma=e.sigma * shares[e.name]) for e in baseline.equations)
    stack = replace(baseline.stack, equations=equations, residual=residual)
    return replace(baseline, equations=equations, residual=residual, stack=stack)
