"""Linear least squares within a joint fit: coefficients, steps of all other parameters."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Stack, view_regressors
from identification.effects.effect import Context, Effect, Shape
from identification.model.parameters import STRIBECK_TERMS
from identification.numerics.least_squares import scaled_least_squares
from identification.recording import Array
from identification.views.nominal import SPEEDS

SCALE_FACTOR = 4.0
"""Factor that is the half width of the search of a parameter with a logarithmic scale."""
DERIVATIVE_STEP = 1e-3
"""Step of numerical derivatives in a nonlinear parameter, relative to the width of its search."""


@dataclass(frozen=True)
class Added:
    """One effect in the model: its term, nonlinear parameters and coefficients."""

    term: Effect
    shape: Shape
    coefficients: tuple[float, ...]

    def parameters(self, context: Context) -> dict[str, float]:
        """Return the parameters of the effect by the names of the catalogue."""
        return dict(self.term.read(np.array(self.coefficients), self.shape, context))


def size_entries(effect: Added) -> Mapping[int, float]:
    """Return the indices of the nonlinear parameters that determine the effect's size, each with
    the half width of its search; empty for an effect with free coefficients.
    """
    return effect.term.refine if effect.term.size is not None else {}


def moved_parameters(shape: Shape, index: int, reach: float, share: float) -> Shape:
    """Return nonlinear parameters, one of them changed by a share of half its search's width."""
    entry = (
        shape[index] * float(SCALE_FACTOR**share) if reach == 0.0 else shape[index] + reach * share
    )
    return (*shape[:index], entry, *shape[index + 1 :])


def effect_columns(stack: Stack, effects: Sequence[Added]) -> tuple[Array, Array]:
    """Return whitened columns of free coefficients, and the contribution of known coefficients."""
    free: list[Array] = []
    known = np.zeros(len(stack.residual))
    for effect in effects:
        columns = stack.whitened(stack.columns(effect.term, effect.shape))
        if effect.term.size is None:
            free.append(columns)
        else:
            known = known + effect.term.size * columns[:, 0]
    return (np.concatenate(free, axis=1) if free else np.zeros((len(known), 0))), known


def contribution(stack: Stack, effect: Added) -> Array:
    """Return the whitened contribution of an effect, shape (n,)."""
    columns = stack.whitened(stack.columns(effect.term, effect.shape))
    return np.asarray(columns @ np.array(effect.coefficients))


def effect_derivatives(stack: Stack, effects: Sequence[Added]) -> Array:
    """Return whitened derivatives by every coefficient and nonlinear parameter, shape (n, g)."""
    parts = [np.zeros((len(stack.residual), 0))]
    for effect in effects:
        here = stack.whitened(stack.columns(effect.term, effect.shape))
        if effect.term.size is None:
            parts.append(here)
        coefficients = np.array(effect.coefficients)
        for index, reach in effect.term.refine.items():
            there = stack.whitened(
                stack.columns(
                    effect.term, moved_parameters(effect.shape, index, reach, DERIVATIVE_STEP)
                )
            )
            parts.append((((there - here) @ coefficients) / DERIVATIVE_STEP)[:, None])
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class Solution:
    """Solution of the linear problem at one point."""

    # Step of the nominal parameters in which the torque is linear, with fixed Stribeck speeds.
    linear_step: Array
    # Step of all nominal parameters, with the Stribeck speeds free to first order; only the steps
    # of the Stribeck speeds are used.
    speed_step: Array
    # Step of the nonlinear parameters that determine an effect's size, relative to the half widths
    # of their search.
    shapes: Array
    effects: tuple[Added, ...]
    residual: Array  # whitened residual with the Stribeck speeds free to first order
    # Sum of whitened squares with fixed Stribeck speeds, by which points are compared: the
    # first-order prediction is not attained by a large step of a Stribeck speed.
    cost: float


def solve(stack: Stack, effects: Sequence[Added], held: Collection[str] = ()) -> Solution:
    """Solve for coefficients, and for steps of the nominal parameters and of nonlinear parameters
    that determine a size; static levels stay within their limits.
    """
    stack = stack.without(held) if held else stack
    target = stack.measured
    free, known = effect_columns(stack, effects)
    unbent = stack.without(SPEEDS)
    linear_step, rest = _projected_least_squares(unbent, target - known, free)
    without = {*SPEEDS, *held}
    following = [
        e
        for e in _with_coefficients(stack, effects, linear_step)
        if e.term.follows and "torque" in e.term.columns
    ]
    if following:
        step = _step_with_following(stack, target - known - free @ linear_step, following, without)
    else:
        step = _nominal_step(stack, target - known - free @ linear_step, without)
    beyond = stack.nominal.at_most(step)
    if beyond - set(held):
        return solve(stack, effects, beyond | set(held))
    found, residual = _projected_least_squares(stack, target - known, free)
    shifts = _size_derivatives(stack, effects)
    every = np.concatenate([free, shifts], axis=1)
    moved = _projected_least_squares(stack, target - known, every)[0] if shifts.shape[1] else found
    speed_step = _nominal_step(stack, target - known - every @ moved, held)
    placed = _with_coefficients(stack, effects, found)
    return Solution(step, speed_step, moved[free.shape[1] :], placed, residual, float(rest @ rest))


def _with_coefficients(stack: Stack, effects: Sequence[Added], found: Array) -> tuple[Added, ...]:
    """Return the effects with their coefficients; free coefficients are those in ``found``."""
    placed, at = [], 0
    for effect in effects:
        if effect.term.size is not None:
            placed.append(replace(effect, coefficients=(effect.term.size,)))
            continue
        width = next(iter(stack.columns(effect.term, effect.shape).values())).shape[1]
        placed.append(replace(effect, coefficients=tuple(float(c) for c in found[at : at + width])))
        at += width
    return tuple(placed)


def _step_with_following(
    stack: Stack, whitened: Array, following: Sequence[Added], without: Collection[str]
) -> Array:
    """Return the step of :func:`_nominal_step` for effects whose regressors depend on the nominal
    values.

    The coefficients of these effects change with the step: for example, the coefficient of a ripple
    relative to the current falls if the current rises.
    """
    nominal, step = stack.nominal, np.zeros(len(stack.nominal.free))
    equation = next(e for e in stack.equations if e.name == "torque")
    use = [k for k, name in enumerate(nominal.free) if name not in without]
    columns = [equation.tangent[:, use]]
    for k, column in zip(use, columns[0].T.copy(), strict=True):
        # The step changes the torque by an amount of the size of its noise, because regressors may
        # depend on the sign of nominal values.
        length = equation.sigma * len(column) ** 0.5 / max(float(np.linalg.norm(column)), 1e-300)
        unit = np.zeros(len(nominal.free))
        unit[k] = length
        there = nominal.moved(unit, np.zeros(len(nominal.free)))
        for e in following:
            rows = equation.rows(view_regressors(e.term, "torque", there, e.shape))
            change = rows - stack.columns(e.term, e.shape)["torque"]
            columns[0][:, use.index(k)] += change @ np.array(e.coefficients) / length
    columns += [stack.columns(e.term, e.shape)["torque"] for e in following]
    target = whitened[stack.part("torque")] * equation.sigma
    found = scaled_least_squares(np.concatenate(columns, axis=1), target, 1e-8)
    step[use] = found[: len(use)]
    return step


def _size_derivatives(stack: Stack, effects: Sequence[Added]) -> Array:
    """Return whitened derivatives with respect to parameters that determine a size, (n, g)."""
    parts = [np.zeros((len(stack.residual), 0))]
    for effect in effects:
        for index, reach in size_entries(effect).items():
            shapes = effect.shape, moved_parameters(effect.shape, index, reach, DERIVATIVE_STEP)
            here, there = (stack.whitened(stack.columns(effect.term, shape)) for shape in shapes)
            assert effect.term.size is not None
            parts.append((there - here) * (effect.term.size / DERIVATIVE_STEP))
    return np.concatenate(parts, axis=1)


def _projected_least_squares(stack: Stack, target: Array, free: Array) -> tuple[Array, Array]:
    """Return coefficients of projected columns, and the residual."""
    left = stack.projected(target[:, None])[:, 0]
    columns = stack.projected(free)
    found = scaled_least_squares(columns, left)
    return found, left - columns @ found


def _nominal_step(stack: Stack, whitened: Array, without: Collection[str]) -> Array:
    """Return the least-squares step of the nominal parameters; zero for names in ``without``."""
    free = stack.nominal.free
    step = np.zeros(len(free))
    for equation in stack.equations:
        if equation.name == "torque":
            use = [k for k, name in enumerate(equation.names) if name not in without]
            target = whitened[stack.part("torque")] * equation.sigma
            found = scaled_least_squares(equation.tangent[:, use], target, 1e-8)
            for k, change in zip(use, found, strict=True):
                if k < len(free):
                    step[k] = change
    return step


def predicted_and_attained(
    stack: Stack, effects: Sequence[Added], residual: Array
) -> tuple[float, float]:
    """Return the predicted and the attained mean-square torque mismatch over that of the noise."""
    equation = next(e for e in stack.equations if e.name == "torque")
    rest = equation.residual.copy()
    for effect in effects:
        columns = stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            rest -= columns @ np.array(effect.coefficients)
    # The rotor's share of the inertia is not a nominal parameter.
    other = equation.tangent[:, [name not in stack.nominal.free for name in equation.names]]
    rest -= other @ np.linalg.lstsq(other, rest, rcond=None)[0]
    return float(np.mean(residual[stack.part("torque")] ** 2)), float(
        np.mean(rest**2)
    ) / equation.sigma**2


def with_rises_held(stack: Stack, effects: Sequence[Added]) -> float:
    """Return the mean-square torque mismatch, relative to the mean square of the noise, of a fit
    with fixed rises of static over Coulomb friction.

    All other parameters in which the torque is linear are free. The rises are fixed, because the
    friction of real machines at the slowest speeds may require rises below zero, whatever effects
    are identified.
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    columns = {name: equation.tangent[:, k] for k, name in enumerate(equation.names)}
    for coulomb, static, speed in STRIBECK_TERMS:
        level, rise = columns.get(coulomb), columns.pop(static, None)
        if level is not None and rise is not None:
            columns[coulomb] = level + rise
        columns.pop(speed, None)
    own = [stack.columns(e.term, e.shape).get("torque") for e in effects]
    design = np.column_stack([*columns.values(), *(c for c in own if c is not None)])
    left = equation.residual - design @ np.linalg.lstsq(design, equation.residual, rcond=None)[0]
    return float(np.mean(left**2)) / equation.sigma**2


def is_infeasible(predicted: float, attained: float) -> bool:
    """Whether a fit is infeasible: the attained mean-square mismatch is more than `infeasible`
    times the predicted mean-square mismatch, and more than `infeasible` times that of the noise.
    """
    return attained > RULES.infeasible * max(predicted, 1.0)
