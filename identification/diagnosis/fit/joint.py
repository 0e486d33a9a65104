"""Nominal parameters and named effects fitted together, with intervals by blocks of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identification.diagnosis.fit.feasibility import predicted_and_attained
from identification.diagnosis.fit.linear import (
    STEP,
    Solved,
    directions,
    displaced,
    sized,
    solve,
    wide,
)
from identification.diagnosis.fit.linear import Added as Added
from identification.diagnosis.fit.stack import Stack, granting, stacked, tied
from identification.diagnosis.rows.equations import Equation, equations
from identification.diagnosis.rows.nominal import STATICS, Nominal
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.term import Shape
from identification.numerics.least_squares import least_squares
from identification.recording import Array, RecordingError

ROUNDS = 12
"""Most Gauss-Newton rounds of one joint fit."""
LARGEST_SHIFT = 0.3
"""Greatest step of a shape's entry in one round, over its reach."""
SETTLED = 1e-4
"""Relative change of the cost at which it ends."""
LAST_STEPS, UNSETTLED = 3, 0.02
"""Most steps after it ended, and the share by which the torque's mismatch is larger with its
constants as they are, from which on they are taken.
"""
LAST_SHARES = (1.0, 0.5)
"""Shares of such a step that are tried: the whole of one of static friction may be more than
breakaways bear.
"""
WORTH_A_STEP = 0.1
"""Share of what the constants do not keep that such a step must mend."""
DAMPING = 0.3
"""Share of a step that is taken where the whole of it made things worse..."""
MOST_FAILURES = 2
"""... and how often that is tried."""
REACHES = (1.0, 0.2)
"""How far continuous shapes are sought in the first rounds, over their full reach."""
TRIALS = 9
ZOOMS = 3
POLISHES, SHORTEST = 4, 1.0 / 64.0
"""Most steps of a shape beyond the grid in one round, and the least share of one that is tried."""


@dataclass(frozen=True)
class Joint:
    """A model fitted to all equations.

    Attributes:
        nominal: Nominal values.
        effects: In the order they were added.
        equations: At these nominal values; effects not taken off.
        residual: Whitened rows less everything, shape (n,).
        stack: With the effects, and the directions of their shapes, granted.
    """

    nominal: Nominal
    effects: tuple[Added, ...]
    equations: tuple[Equation, ...]
    residual: Array
    stack: Stack

    @property
    def cost(self) -> float:
        """Sum of whitened squares."""
        return float(self.residual @ self.residual)


def fit(
    views: Sequence[View],
    unit: str,
    start: Nominal,
    effects: Sequence[Added] = (),
    before: Joint | None = None,
) -> Joint:
    """Fit nominal parameters, coefficients and continuous shapes together.

    Args:
        views: Recordings to fit.
        unit: Of the torque.
        start: Nominal values to start from.
        effects: With their trial shapes; coefficients are found.
        before: A fit of the same recordings, whose noise and blocks are kept.

    Raises:
        RecordingError: Nowhere in the recordings is the joint in steady motion.
    """
    nominal, effects = begun(start.limited(views), effects)
    best: Joint | None = None
    least, share, failures = math.inf, 1.0, 0
    stack = None if before is None else before.stack
    for k in range(ROUNDS):
        rows = equations(views, nominal, unit, () if stack is None else stack.equations)
        _require_motion(rows)
        here = stack = stacked(rows, nominal, stack)
        effects = _shaped(here, effects, k)
        solved = solve(here, effects)
        effects = solved.effects
        settled = solved.cost >= (1.0 - SETTLED) * least
        if solved.cost < (1.0 + SETTLED) * least:
            best = Joint(nominal, effects, here.equations, solved.residual, here)
            step, share, least = solved, min(1.0, 2.0 * share), min(least, solved.cost)
            if settled:
                break
        else:
            failures, share = failures + 1, DAMPING * share
            if failures > MOST_FAILURES:
                break
        assert best is not None
        # Regressors that follow the nominal values make a step of these more than linear.
        follow = share if any(e.term.follows for e in best.effects) else 1.0
        nominal = best.nominal.moved(follow * step.straight, step.bend, share)
        effects = (
            _shifted(best.effects, share * step.shapes) if k + 1 >= len(REACHES) else best.effects
        )
        nominal, effects = begun(told(nominal, best.effects), effects)
    assert best is not None
    best = _kept(views, unit, best, step)
    # The stack's own residual still holds what effects of a known size, which are no direction,
    # contribute.
    left = replace(best.stack, residual=best.residual)
    return replace(best, stack=granting(left, directions(left, best.effects)))


def _shaped(stack: Stack, effects: tuple[Added, ...], round_: int) -> tuple[Added, ...]:
    """Return effects with their shapes sought, one after the other: on a grid in the first rounds,
    by Gauss-Newton steps after them.
    """
    for place in range(len(effects)):
        if round_ < len(REACHES):
            shaped = _reshaped(stack, effects, place, REACHES[round_])
        else:
            shaped = _polished(stack, effects, place)
        effects = (*effects[:place], shaped, *effects[place + 1 :])
    return effects


def _require_motion(rows: Sequence[Equation]) -> None:
    if not any(equation.name == "torque" for equation in rows):
        raise RecordingError(
            "no sample of the recordings to fit is in steady motion, so that they determine no "
            "friction and no inertia; add a recording in which the joint moves on for longer than "
            "the errors' bandwidth resolves (see --bandwidth)"
        )


def _kept(views: Sequence[View], unit: str, best: Joint, solved: Solved) -> Joint:
    """Return a fit whose constants keep what it is worth: the step that it ended with taken, where
    that brings more.

    Static friction under a load that hardly any row is slow enough to tell moves by half of itself
    in such a step. Where that spoils it, the step without static friction is taken, which has the
    other constants right.
    """
    for _ in range(LAST_STEPS):
        promised, kept = predicted_and_attained(best.stack, best.effects, best.residual)
        if kept <= (1.0 + UNSETTLED) * promised:
            break
        enough = kept - WORTH_A_STEP * (kept - promised)
        steps = [share * solved.straight for share in LAST_SHARES]
        after = next(
            (a for step in steps if (a := _stepped(views, unit, best, step, enough)) is not None),
            None,
        )
        if after is None:
            without = solve(best.stack, best.effects, STATICS).straight
            after = _stepped(views, unit, best, without, enough)
        if after is None:
            break
        best, solved = after
    return best


def _stepped(
    views: Sequence[View], unit: str, best: Joint, step: Array, enough: float
) -> tuple[Joint, Solved] | None:
    """Return the fit after a step of its constants, or None where it leaves more than enough, or is
    worth less.
    """
    nominal = best.nominal.moved(step, np.zeros(len(step)))
    stack = stacked(equations(views, nominal, unit, best.stack.equations), nominal, best.stack)
    solved = solve(stack, best.effects)
    there = predicted_and_attained(stack, solved.effects, solved.residual)[1]
    if there >= enough or solved.cost > (1.0 + UNSETTLED) * best.cost:
        return None
    return Joint(nominal, solved.effects, stack.equations, solved.residual, stack), solved


def begun(nominal: Nominal, effects: Sequence[Added]) -> tuple[Nominal, tuple[Added, ...]]:
    """Return nominal values and effects as a fit begins with them."""
    placed, nominal = [], replace(nominal, bent=None, bristles=0.0, late_s=0.0)
    for effect in effects:
        nominal, shape = effect.term.begin(nominal, effect.shape)
        placed.append(replace(effect, shape=shape))
    return nominal, tuple(placed)


def _shifted(effects: Sequence[Added], steps: Array) -> tuple[Added, ...]:
    """Return effects whose size is their shape after a step, within limits, of each of its
    entries.
    """
    left, placed = list(steps), []
    for effect in effects:
        shape = effect.shape
        for index, reach in sized(effect).items():
            step = max(-LARGEST_SHIFT, min(LARGEST_SHIFT, float(left.pop(0))))
            trial = displaced(shape, index, reach, step)
            shape = trial if effect.term.physical(trial) else shape
        placed.append(replace(effect, shape=shape))
    return tuple(placed)


def told(nominal: Nominal, effects: Sequence[Added]) -> Nominal:
    """Return nominal values with what the effects so far say that others, or they themselves, are
    built from.
    """
    ripple = next(
        ((e.shape, e.coefficients) for e in effects if e.term.name == "torque_ripple"), ()
    )
    return replace(
        nominal,
        hidden=hidden_load(effects),
        zero_A=current_zero(effects),
        ripple=ripple,
        efficiency=1.0 / (1.0 + gear_loss(effects)),
    )


def hidden_load(effects: Sequence[Added]) -> tuple[float, float, float, float]:
    """Return what the effects so far say of undeclared torque that turns with the joint
    (:class:`Nominal`).
    """
    found = {e.term.name: e.coefficients for e in effects}
    sine, cosine = found.get("gravity_imbalance", (0.0, 0.0))
    slope, constant = found.get("return_spring", (0.0, 0.0))
    return sine, -cosine, slope, -constant


def gear_loss(effects: Sequence[Added]) -> float:
    """Return by what share more torque is asked for than the transmission passes on, as the effects
    so far say.
    """
    return sum(
        max(e.coefficients[0], 0.0)
        for e in effects
        if e.term.name == "transmission_efficiency" and e.coefficients
    )


def current_zero(effects: Sequence[Added]) -> float:
    """Return what the logged current reads without any, as the effects so far say, A."""
    return sum(
        e.coefficients[0] for e in effects if e.term.name == "current_offset" and e.coefficients
    )


class _Others(NamedTuple):
    """What is left for one effect to explain: rows that it is tied to, the nominal tangent and
    other effects out.
    """

    stack: Stack
    granted: Array
    left: Array

    def columns(self, effect: Added, shape: Shape) -> Array:
        """Return an effect's regressors at a shape, what the others absorb taken out, shape (n,
        k).
        """
        columns = self.stack.projected(self.stack.whitened(self.stack.columns(effect.term, shape)))
        return np.asarray(columns - self.granted @ (self.granted.T @ columns))

    def rest(self, effect: Added, columns: Array) -> Array:
        """Return what an effect leaves with its best coefficients."""
        if effect.term.size is not None:
            return np.asarray(self.left - effect.term.size * columns[:, 0])
        return np.asarray(self.left - columns @ least_squares(columns, self.left))


def _others(stack: Stack, effects: Sequence[Added], k: int) -> _Others:
    # Rows that neither this effect nor what is tied to it touches cost the same whatever its shape.
    stack = stack.only(tied(effects[k].term.columns, [e.term.columns for e in effects]))
    here = {e.name for e in stack.equations}
    target = np.concatenate([e.residual / e.sigma for e in stack.equations])
    others, known = wide(
        stack, [e for j, e in enumerate(effects) if j != k and here & e.term.columns.keys()]
    )
    granted, _ = np.linalg.qr(stack.projected(others)) if others.shape[1] else (others, None)
    left = stack.projected((target - known)[:, None])[:, 0]
    return _Others(stack, granted, left - granted @ (granted.T @ left))


def _reshaped(stack: Stack, effects: Sequence[Added], k: int, share: float) -> Added:
    """Return effect ``k`` with its continuous shape entries refined, the nominal tangent and the
    others free.
    """
    effect = effects[k]
    if not effect.term.refine:
        return effect
    others = _others(stack, effects, k)

    def cost(shape: Shape) -> float:
        rest = others.rest(effect, others.columns(effect, shape))
        return float(rest @ rest)

    return replace(effect, shape=_search(cost, effect, share))


def _polished(stack: Stack, effects: Sequence[Added], k: int) -> Added:
    """Return effect ``k`` with its shape moved by Gauss-Newton steps, coefficients free, from where
    the grid left it.

    The grid's last step is a part in 250 of a frequency or a time, and a swing of many cycles says
    more than that. Shapes that are their effect's size move with the constants instead
    (:func:`_shifted`).
    """
    effect = effects[k]
    if not effect.term.refine or effect.term.size is not None:
        return effect
    others = _others(stack, effects, k)
    reaches = effect.term.refine.items()
    columns = others.columns(effect, effect.shape)
    for _ in range(POLISHES):
        coefficients = least_squares(columns, others.left)
        rest = others.left - columns @ coefficients
        moved = [
            others.columns(effect, displaced(effect.shape, i, reach, STEP)) for i, reach in reaches
        ]
        slopes = np.stack([(m - columns) @ coefficients / STEP for m in moved], axis=1)
        every = np.concatenate([columns, slopes], axis=1)
        scale = np.linalg.norm(every, axis=0)
        scale[scale == 0.0] = 1.0
        step = (least_squares(every / scale, rest) / scale)[columns.shape[1] :]
        shape = _downhill(
            others, effect, np.clip(step, -LARGEST_SHIFT, LARGEST_SHIFT), float(rest @ rest)
        )
        if shape is None:
            break
        effect = replace(effect, shape=shape)
        columns = others.columns(effect, shape)
    return effect


def _downhill(others: _Others, effect: Added, step: Array, least: float) -> Shape | None:
    """Return the shape after as much of a step as makes things better by more than rounding; None
    where none does.
    """
    share = 1.0
    while share >= SHORTEST:
        shape = effect.shape
        for (index, reach), part in zip(effect.term.refine.items(), share * step, strict=True):
            shape = displaced(shape, index, reach, float(part))
        if effect.term.physical(shape):
            rest = others.rest(effect, others.columns(effect, shape))
            if float(rest @ rest) < (1.0 - SETTLED) * least:
                return shape
        share *= DAMPING
    return None


def _search(cost: Callable[[Shape], float], effect: Added, share: float) -> Shape:
    """Return the shape of the least cost, one entry after the other on a grid that closes in."""
    best, least = effect.shape, cost(effect.shape)
    width = share
    for _ in range(ZOOMS):
        for index, reach in effect.term.refine.items():
            centre = best
            for place in np.linspace(-width, width, TRIALS):
                trial = displaced(centre, index, reach, float(place))
                if place != 0.0 and effect.term.physical(trial) and (value := cost(trial)) < least:
                    best, least = trial, value
        width *= 2.0 / (TRIALS - 1)
    return best
