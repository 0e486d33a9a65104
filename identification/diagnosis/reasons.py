"""Reasons why effects do not explain a mismatch, or why *nothing missing* stands beside one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from identification.diagnosis.joint import Joint
from identification.diagnosis.linear import contribution
from identification.diagnosis.result import Fit
from identification.diagnosis.rows import AT_INSTANTS, Equation, families
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.diagnosis.significance import greatest_mean_square, level
from identification.diagnosis.within_limits import infeasible

# Tests whether the remaining torque mismatch is hysteretic, in which case the identified effect is
# wrong.
#
# Between reversals a hysteretic torque is a function of the angle, so that the torque of a weight
# or a spring explains most of the mismatch. But the remaining mismatch depends on the travel since
# the last reversal.

SINCE_REVERSAL = ("travel since reversal", "time since reversal")
"""Coordinates of a hysteretic mismatch; in the motion of a single sine the two are equivalent."""


def is_hysteretic(joint: Joint) -> bool:
    """Whether the torque mismatch exceeds the noise and depends on travel or time since reversal
    more than on any other coordinate.

    In contrast, unmodelled friction at the lowest speeds of real machines depends most on torque,
    speed or rest time.
    """
    torque = _torque_beyond_noise(joint)
    if torque is None:
        return False
    rows, gains = joint.residual[joint.stack.part("torque")], {}
    for name, columns in families(torque):
        scored = joint.stack.independent(name, "torque", columns)
        gains[name] = 0.0 if scored is None else scored.gain
    most = max(gains, key=lambda name: gains[name], default="")
    return most in SINCE_REVERSAL and gains[most] >= RULES.hysteretic_share * (
        float(rows @ rows) - len(rows)
    )


def _torque_beyond_noise(joint: Joint) -> Equation | None:
    """Return the torque equation if its mismatch is beyond the noise, else None."""
    rows = joint.residual[joint.stack.part("torque")]
    torque = next((e for e in joint.equations if e.name == "torque"), None)
    if torque is None or float(rows @ rows) <= RULES.excess * level(torque) * len(rows):
        return None
    return torque


# Compares the mismatch of each equation by the nominal and by the corrected model, and judges
# whether the effects explain enough of the mismatch.


@dataclass(frozen=True)
class Excess:
    """Mean square of an equation's whitened mismatch, by the nominal and by the corrected model."""

    equation: str
    before: float
    after: float

    @property
    def explained(self) -> float:
        """Share of the power beyond the noise that the effects explain."""
        beyond = max(self.before - 1.0, 1e-12)
        return min(1.0, max(0.0, (self.before - max(self.after, 1.0)) / beyond))


def excess_of(found: Search) -> list[Excess]:
    """Return each equation's mean-square mismatch by the nominal and by the corrected model."""
    stack = found.baseline.stack
    out = []
    for equation in found.baseline.equations:
        rows = stack.part(equation.name)
        before, after = (
            float(np.mean(j.residual[rows] ** 2)) for j in (found.baseline, found.final)
        )
        out.append(Excess(equation.name, before, after))
    return out


def explains_nearly_all(found: Search) -> bool:
    """Whether the effects explain the share of the mismatch that right effects explain."""
    return judged_equation(found).explained >= RULES.nearly_complete


def equations_of_effects(found: Search) -> set[str]:
    """Return the names of the equations in which the accepted effects appear."""
    return {name for effect in found.final.effects for name in effect.term.columns}


def judged_equation(found: Search) -> Excess:
    """Return the equation with the greatest mismatch beyond the noise.

    Only the torque equation and the equations in which an accepted effect appears are compared, if
    one of them has a mismatch. A mismatch in any other equation has another cause, and is reported
    in addition to the identified effects.
    """
    judges = [e for e in excess_of(found) if e.equation not in AT_INSTANTS]
    acting = equations_of_effects(found) | {"torque"}
    judges = [e for e in judges if e.equation in acting] or judges
    sizes = {e.name: len(e.residual) for e in found.baseline.equations}
    return max(judges, key=lambda e: (e.before - 1.0) * sizes[e.equation])


def adequate(found: Search) -> float:
    """Return the share of the mismatch beyond the noise that the effects must explain."""
    name = judged_equation(found).equation
    white = next(e for e in found.final.equations if e.name == name).white
    return RULES.adequate_white if white else RULES.adequate


def insufficient(found: Search, share: float) -> bool:
    """Whether the effects explain less than ``share`` of a mismatch beyond the noise."""
    worst = judged_equation(found)
    equation = next(e for e in found.final.equations if e.name == worst.equation)
    left = (
        worst.after > RULES.excess * level(equation)
        or greatest_mean_square(found.final, equation) > RULES.excess_of_one
        or (equation.white and found.p_after <= RULES.level)
    )
    return worst.explained < share and left


def hysteretic_remainder(found: Search) -> bool:
    """Whether the effects explain less of the torque mismatch than right effects would
    (`nearly_complete`), and the remaining mismatch is hysteretic.
    """
    torque = next((e for e in excess_of(found) if e.equation == "torque"), None)
    return (
        torque is not None
        and torque.explained < RULES.nearly_complete
        and is_hysteretic(found.final)
    )


# Tests whether two identified effects nearly cancel each other, so that their small sum resembles
# a third effect.
#
# For example, the torques of a linear spring and of a weight of opposite sign add to the torque of
# a hardening spring. Each of the two torques is then many times greater than their sum, and the
# machine has neither the linear spring nor the weight.


def cancelling_effects(joint: Joint) -> tuple[str, ...]:
    """Return the names of two effects whose contributions in one equation nearly cancel each other;
    empty if there is no such pair.

    The nominal tangent is projected out of the contributions.
    """
    stack = replace(joint.stack, effect_basis=np.zeros((len(joint.residual), 0)))
    made = [stack.projected(contribution(stack, e)[:, None])[:, 0] for e in joint.effects]
    for equation in joint.equations:
        rows = joint.stack.part(equation.name)
        for k, own in enumerate(made):
            for j in range(k):
                other, one = made[j][rows], own[rows]
                total = one + other
                if float(total @ total) < RULES.cancelled * float(one @ one + other @ other):
                    return joint.effects[j].term.name, joint.effects[k].term.name
    return ()


# Tests whether an identified effect explains the remaining torque mismatch only with a different
# coefficient in each direction of motion.
#
# Every effect of the catalogue has one coefficient for both directions of motion; for asymmetric
# friction this coefficient is half the difference of the friction in the two directions. An effect
# that needs two coefficients is not the true cause, and the verdict is *outside the catalogue*.


def direction_dependent(joint: Joint) -> tuple[str, ...]:
    """Return the effects that, with separate coefficients for the two directions of motion, explain
    nearly all of the remaining torque mismatch.

    The result is empty if the remaining mismatch is within the noise.
    """
    torque = _torque_beyond_noise(joint)
    if torque is None:
        return ()
    rows = joint.residual[joint.stack.part("torque")]
    beyond = float(rows @ rows) - len(rows)
    ahead, found = torque.rows(lambda v: v.sense) > 0.0, []
    for effect in joint.effects:
        columns = joint.stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            each = np.concatenate([columns * ahead, columns * ~ahead], axis=1)
            split = joint.stack.independent(effect.term.name, "torque", each)
            if split is not None and split.gain >= RULES.nearly_all * beyond:
                found.append(effect.term.name)
    return tuple(found)


class Kind(Enum):
    """Kinds of reasons."""

    NO_EFFECT = "no effect was accepted"
    ONE_DIRECTION = "an effect needs a different size in each direction of motion"
    CANCELLING = "two effects nearly cancel"
    INFEASIBLE = "nominal parameters would be outside their physical limits"
    TOO_LITTLE = "the effects explain too little of the mismatch"
    BETWEEN_SAMPLES = "values between the samples may cause the mismatch"
    REVERSALS = "the remaining mismatch depends on travel or time since each reversal"
    MUCH_LEFT = "the effects leave far more than the noise"
    NOT_BETTER = "the corrected model does not lower the error"
    MISFIT = "the nominal model does not describe the recordings"


@dataclass(frozen=True)
class Reason:
    """Reason why the effects of a search do not explain the mismatch, or why the verdict is
    *nothing missing* in spite of a mismatch.
    """

    kind: Kind  # kind of the reason
    search: Search  # the search whose effects the reason concerns
    effects: tuple[str, ...] = ()  # names of the effects; empty if no effect was accepted
    # Share of the mismatch beyond the noise that the effects must explain.
    needed: float = RULES.adequate
    # Greatest ratio of the error with the effects to the noise floor, of fitted and of unused
    # recordings.
    left: float = 0.0


def reason_outside(found: Search, searched: Search) -> Reason | None:
    """Return the first reason why the effects do not explain the mismatch, or None if they explain
    it.

    Args:
        found: The search with its fits within their limits and the accepted effects.
        searched: The search before effects were dropped. The effects before and after dropping must
            explain enough of the mismatch.
    """
    names, before = (tuple(e.term.name for e in s.final.effects) for s in (found, searched))
    if not names:
        return Reason(Kind.NO_EFFECT, found)
    for kind, of in (
        (Kind.ONE_DIRECTION, direction_dependent),
        (Kind.CANCELLING, cancelling_effects),
    ):
        concerned = of(found.final)
        if concerned:
            return Reason(kind, found, concerned)
    if infeasible(searched.final):
        return Reason(Kind.INFEASIBLE, searched, before)
    if insufficient(searched, adequate(searched)):
        return Reason(Kind.TOO_LITTLE, searched, before, adequate(searched))
    least = RULES.adequate_after_removal
    if set(names) != set(before) and insufficient(found, least):
        return Reason(Kind.TOO_LITTLE, found, names, least)
    if hysteretic_remainder(searched):
        return Reason(Kind.REVERSALS, searched, before)
    return None


def floors_left(fit: Fit) -> float:
    """Return the greatest ratio of the error with the effects to the noise floor, of fitted and of
    unused recordings in which the effects explain less than right effects would
    (`nearly_complete`); 0 if there are no such recordings.

    An effect with an approximate regressor leaves a small share of a mismatch, which may be many
    times the noise.
    """
    floor = fit.noise_floor_rms
    pairs = ((fit.baseline_rms, fit.final_rms), (fit.validate_baseline_rms, fit.validate_final_rms))
    ratios = [
        after / floor
        for before, after in pairs
        if before is not None
        and after is not None
        and after**2 - floor**2 > (1.0 - RULES.nearly_complete) * (before**2 - floor**2)
    ]
    return max(ratios, default=0.0)
