"""Comparison of fits: which of two the data prefer, how many parameters each has, and which are
plausible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.diagnosis.catalogue import ENTRIES
from identification.diagnosis.fit.joint import Added, Joint
from identification.diagnosis.fit.within_limits import infeasible
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.term import Context
from identification.model.units import LINEAR, PHASES, parameter_title

REJECTED = 1.645
"""Standard errors by which a rival must be worse to be rejected (5 %, one-sided)."""
SIMPLER_IF = 1.0
"""Standard errors of preference below which the effect with fewer parameters is taken."""
SAME = 0.01
"""Square of the difference of two fits over the square of their mismatch, below which they are the
same.
"""
USUAL_TORQUE_N_M, USUAL_SPEED_RAD_S, USUAL_TRAVEL_RAD = 40.0, 0.5, 0.8
"""Greatest torque and speed, and the travel, on the practical bench, which the catalogue's ranges
suit.
"""


@dataclass(frozen=True)
class Contender:
    """An effect fitted jointly, and how far the data prefer the chosen one to it.

    ``preference`` is the studentised difference of squared residuals by blocks (Vuong, Econometrica
    57 (1989) 307). ``beyond`` says which parameter would have to be beyond its plausible range;
    empty where none.
    """

    name: str
    joint: Joint
    preference: float
    beyond: str


@dataclass(frozen=True)
class Round:
    """An accepted effect, and the rivals that it was preferred to, best first."""

    name: str
    rivals: tuple[Contender, ...]


def preference(chosen: Joint, rival: Joint) -> float:
    """Return how far the data prefer ``chosen``, in standard errors of the difference by blocks."""
    stack = chosen.stack
    loss = stack.sums((rival.residual**2 - chosen.residual**2)[:, None])[:, 0]
    spread = float(np.std(loss, ddof=1)) * math.sqrt(len(loss))
    return float(np.sum(loss)) / spread if spread > 0.0 else 0.0


def probability(preferred: float) -> float:
    """Return the probability that goes with a preference."""
    return float(stats.norm.cdf(preferred))


def implausible(joint: Joint) -> str:
    """Say what makes a fit no model of a bench, empty where nothing does.

    The cause is a parameter of the last effect beyond its range in the catalogue, at the scale of
    this bench; or a fit that is infeasible (:func:`infeasible`), such as friction that would have
    to rise with speed where it falls.
    """
    if infeasible(joint):
        return "constants that no bench has"
    last = joint.effects[-1]
    views = joint.equations[0].views
    found = last.parameters(Context(views, joint.nominal))
    scales = _scales(views)
    motion = views[0].recording.bench.motion
    for q in ENTRIES[last.term.name].parameters:
        scale = scales.get(q.unit, 1.0)
        low = q.low * (max(1.0, scale) if q.low < 0.0 else min(1.0, scale))
        high = q.high * max(1.0, scale)
        if motion == LINEAR and q.unit == "rad" and not q.name.startswith(PHASES):
            # Metres, of which a radian says nothing: as far in travels as the range is on the usual
            # bench.
            low, high = (limit * _travels(views) for limit in (q.low, q.high))
        if not low <= found[q.name] <= high:
            name = parameter_title(motion, q.name)
            return f"{name} {found[q.name]:.3g}, beyond what is plausible ({low:.3g} to {high:.3g})"
    return ""


def _scales(views: Sequence[View]) -> dict[str, float]:
    """Return by unit how much larger this bench is than the one that the catalogue's ranges were
    written for.
    """
    torque = max(float(np.max(np.abs(v.torque))) for v in views) / USUAL_TORQUE_N_M
    speed = max(float(np.max(np.abs(v.velocity))) for v in views) / USUAL_SPEED_RAD_S
    angle = _travels(views)
    return {
        "N m": torque,
        "N m/s": torque,
        "N m/rad": torque / angle,
        "N m s/rad": torque / speed,
        "N m s^2/rad^2": torque / speed**2,
        "kg m^2": torque * angle / speed**2,
    }


def _travels(views: Sequence[View]) -> float:
    """Return the travel over that of the bench that the catalogue's ranges were written for."""
    return max(float(np.ptp(v.angle)) for v in views) / USUAL_TRAVEL_RAD


def simplest(joints: Sequence[Joint], sizes: Sequence[int]) -> int:
    """Return the fit with the fewest parameters among those that are less than
    :data:`SIMPLER_IF` standard errors worse than the best; ``joints`` are sorted, best first.
    """
    near = [
        k for k in range(len(joints)) if k == 0 or preference(joints[0], joints[k]) < SIMPLER_IF
    ]
    return min(near, key=lambda k: (sizes[k], k))


def numbers(effect: Added) -> int:
    """Return the number of an effect's parameters that are fitted."""
    return effect.term.freedom + len(effect.coefficients)


def again(rival: Added, its: Joint, chosen: Added, best: Joint) -> bool:
    """Whether a rival contains the chosen effect as a special case: it has more parameters and the
    same fit. Such a rival is no alias.
    """
    difference = its.residual - best.residual
    return numbers(rival) > numbers(chosen) and float(difference @ difference) < SAME * best.cost
