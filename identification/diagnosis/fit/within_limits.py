"""Refines a fit within the limits of its nominal parameters, and computes the residual at the
refined values.

The search compares effects by fits without limits, although friction and inertia of a machine are
not negative. The fit within these limits is reported, and its errors on recordings set aside are
computed (bounded least squares: Stark and Parker, Computational Statistics 10 (1995) 129).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy.optimize import lsq_linear

from identification.diagnosis.fit.feasibility import (
    is_infeasible,
    predicted_and_attained,
    with_rises_held,
)
from identification.diagnosis.fit.joint import Joint, nominal_after_effects, start_fit
from identification.diagnosis.fit.linear import Added, effect_derivatives
from identification.diagnosis.fit.stack import Stack, stack_of, with_effect_basis
from identification.diagnosis.rows.equations import equations
from identification.model.parameters import STRIBECK_TERMS
from identification.recording import Array
from identification.views.nominal import LARGEST_STEP, SPEEDS, Nominal
from identification.views.view import View

ROUNDS = 8
"""Greatest number of steps; several steps are needed because the fall of friction, and regressors
that depend on the nominal values, make the problem nonlinear.
"""
CONVERGED = 1e-5
"""Relative change of the cost below which the refinement ends."""
STEP_SHARES = (1.0, 0.5, 0.2)
"""Shares of a step that are tried."""
RIDGE = 1e-4
"""Weight of a ridge penalty on every parameter, relative to the weight of the rows; of equivalent
solutions the penalty selects the smallest.
"""
_JUDGED: WeakKeyDictionary[Joint, bool] = WeakKeyDictionary()
"""Cache: fit to whether it is infeasible, because several comparisons need the answer for one
fit.
"""
_COULOMB_OF = {static: coulomb for coulomb, static, _ in STRIBECK_TERMS}


@dataclass(frozen=True)
class _Point:
    """Parameters and their residual.

    Attributes:
        nominal: Nominal values within their limits.
        effects: Effects with coefficients.
        stack: Stack at these values.
        left: Whitened residual, shape (n,). In all equations except the torque equation, constants
            that are not reported, such as the zero of an encoder, are projected out.
    """

    nominal: Nominal
    effects: tuple[Added, ...]
    stack: Stack
    left: Array

    @property
    def cost(self) -> float:
        """Sum of whitened squares."""
        return float(self.left @ self.left)


def infeasible(joint: Joint) -> bool:
    """Whether a fit is infeasible: its residual, after refinement within the limits of the
    parameters, is far greater than the fit without limits predicts. Effects of an infeasible fit
    are not accepted.
    """
    if joint not in _JUDGED:
        _JUDGED[joint] = infeasible_as_fitted(joint) and not _attained_within_limits(joint)
    return _JUDGED[joint]


def _attained_within_limits(joint: Joint) -> bool:
    """Whether the residual of a fit, after refinement within the limits of the parameters, is about
    that which the fit predicts.
    """
    promised, _ = predicted_and_attained(joint.stack, joint.effects, joint.residual)
    equation = next(e for e in joint.equations if e.name == "torque")
    limited = within_limits(equation.views, equation.unit, joint)
    rows = limited.residual[limited.stack.part("torque")]
    return not is_infeasible(promised, float(np.mean(rows**2)))


def infeasible_as_fitted(joint: Joint) -> bool:
    """Whether the residual of a fit, with parameters beyond a limit moved to the limit, is far
    greater than the fit predicts.

    A fit whose last effect does not appear in the torque equation counts as feasible, because such
    an effect does not change the friction parameters.
    """
    if joint.effects and "torque" not in joint.effects[-1].term.columns:
        return False
    promised, kept = predicted_and_attained(joint.stack, joint.effects, joint.residual)
    return is_infeasible(promised, kept) and is_infeasible(
        promised, with_rises_held(joint.stack, joint.effects)
    )


def within_limits(views: Sequence[View], unit: str, joint: Joint) -> Joint:
    """Return a fit with its nominal parameters and coefficients refined within their limits.

    The residual of the returned fit is computed at the refined values, not predicted by a linear
    step.

    Args:
        views: Recordings that were fitted.
        unit: Unit of the torque.
        joint: The fit.
    """
    best = _point_at(views, unit, joint.nominal, joint.effects, joint.stack)
    for _ in range(ROUNDS):
        better = None
        for held in ((), SPEEDS):
            step, effects = _bounded_step(best, held)
            trials = (
                _point_after(views, unit, best, share * step, effects, share)
                for share in STEP_SHARES
            )
            better = next((t for t in trials if t.cost < best.cost), None)
            if better is not None:
                break
        if better is None:
            break
        done = better.cost > (1.0 - CONVERGED) * best.cost
        best = better
        if done:
            break
    left = replace(best.stack, residual=best.stack.projected(best.left[:, None])[:, 0])
    effect_basis = with_effect_basis(left, effect_derivatives(left, best.effects))
    return Joint(best.nominal, best.effects, best.stack.equations, best.left, effect_basis)


def parameter_derivatives(joint: Joint) -> Array:
    """Return whitened derivatives of the rows with respect to nominal parameters and coefficients,
    shape (n, k).
    """
    return _bounded_problem(_Point(joint.nominal, joint.effects, joint.stack, joint.residual), ())[
        0
    ]


def cross_validation_residual(joint: Joint, parts: Array) -> Array:
    """Return the whitened residual of each part of the rows, with nominal parameters and
    coefficients fitted to all other parts, shape (n,).

    Args:
        joint: Result of :func:`within_limits`.
        parts: Number of the part to which each row belongs, shape (n,), or -1 for rows in no part,
            whose residual is zero.
    """
    point = _Point(joint.nominal, joint.effects, joint.stack, joint.residual)
    every, begin, limits, drawn = _bounded_problem(point, ())
    out = np.where(parts < 0, 0.0, joint.residual)
    for part in np.unique(parts[parts >= 0]):
        mine = parts == part
        found = _bounded_least_squares(
            every[~mine], point.left[~mine] + every[~mine] @ begin, limits, drawn
        )
        out[mine] += every[mine] @ (begin - found)
    return out


def _point_at(
    views: Sequence[View], unit: str, nominal: Nominal, effects: Sequence[Added], like: Stack
) -> _Point:
    stack = stack_of(equations(views, nominal, unit, like.equations), nominal, like)
    left = np.concatenate([e.residual / e.sigma for e in stack.equations])
    for effect in effects:
        columns = stack.whitened(stack.columns(effect.term, effect.shape))
        left -= columns @ np.array(effect.coefficients)
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        rows = stack.part(equation.name)
        if equation.name == "torque":
            left[rows] -= _nuisance_basis(stack) @ (_nuisance_basis(stack).T @ left[rows])
        else:
            left[rows] -= basis @ (basis.T @ left[rows])
    return _Point(nominal, tuple(effects), stack, left)


def _nuisance_basis(stack: Stack) -> Array:
    """Return orthonormal columns of those derivatives of the torque that belong to no nominal
    parameter: with a flexible transmission, the derivative with respect to the rotor's share of the
    inertia.
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    columns = equation.tangent[:, [n not in stack.nominal.free for n in equation.names]]
    basis, _ = np.linalg.qr(columns)
    return np.asarray(basis)


def _bounded_step(point: _Point, held: Sequence[str]) -> tuple[Array, tuple[Added, ...]]:
    """Return a step of the nominal parameters within their limits, and the effects with the
    coefficients that belong to this step.
    """
    every, begin, limits, drawn = _bounded_problem(point, held)
    found = _bounded_least_squares(every, point.left + every @ begin, limits, drawn)
    effects, at = [], len(point.nominal.free)
    for effect in point.effects:
        if effect.term.size is None:
            width = len(effect.coefficients)
            effect = replace(effect, coefficients=tuple(found[at : at + width].tolist()))
            at += width
        effects.append(effect)
    return found[: len(point.nominal.free)], tuple(effects)


def _bounded_problem(
    point: _Point, held: Sequence[str]
) -> tuple[Array, Array, tuple[Array, Array], Array]:
    """Return the data of the bounded least-squares problem: whitened columns of nominal parameters
    and coefficients, shape (n, k); present values; limits; and centre of the ridge penalty.
    """
    stack, nominal = point.stack, point.nominal
    count = len(nominal.free)
    torque = next(e for e in stack.equations if e.name == "torque")
    own = np.zeros((len(point.left), count))
    own[stack.part("torque")] = torque.tangent[:, :count] / torque.sigma
    own[:, [k for k, name in enumerate(nominal.free) if name in held]] = 0.0
    low, high = _step_limits(nominal)
    columns, begin, lows = [own], [np.zeros(count)], [low]
    for effect in point.effects:
        if effect.term.size is None:
            columns.append(stack.whitened(stack.columns(effect.term, effect.shape)))
            begin.append(np.array(effect.coefficients))
            least = np.full(columns[-1].shape[1], -math.inf)
            least[list(effect.term.positive)] = 0.0
            lows.append(least)
    every, start = np.concatenate(columns, axis=1), np.concatenate(begin)
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        part = stack.part(equation.name)
        q = _nuisance_basis(stack) if equation.name == "torque" else basis
        every[part] -= q @ (q.T @ every[part])
    lower = np.concatenate(lows)
    upper = np.concatenate([high, np.full(len(start) - count, math.inf)])
    drawn = np.concatenate([-_values(nominal), np.zeros(len(start) - count)])
    return every, start, (lower, upper), drawn


def _bounded_least_squares(
    every: Array, target: Array, limits: tuple[Array, Array], drawn: Array
) -> Array:
    """Return the least-squares solution within limits, with a small ridge penalty toward
    ``drawn``.
    """
    scale = np.linalg.norm(every, axis=0)
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(every / scale)
    found = lsq_linear(
        np.concatenate([r, RIDGE * np.eye(len(scale))]),
        np.concatenate([q.T @ target, RIDGE * drawn * scale]),
        (limits[0] * scale, limits[1] * scale),
        method="bvls",
    )
    return np.asarray(found.x / scale)


def _values(nominal: Nominal) -> Array:
    """Return the values to which a step is added: for a static level its rise; for a Stribeck speed
    0, because the step is one of its logarithm.
    """
    return np.array(
        [
            0.0 if name in SPEEDS else nominal.get(name) - nominal.get(_COULOMB_OF.get(name, ""))
            for name in nominal.free
        ]
    )


def _step_limits(nominal: Nominal) -> tuple[Array, Array]:
    """Return the least and the greatest step of each free nominal parameter."""
    low = -np.maximum(_values(nominal), 0.0)
    high = np.full(len(low), math.inf)
    for k, name in enumerate(nominal.free):
        if name == "offset":
            low[k] = -math.inf
        elif name in SPEEDS:
            low[k], high[k] = -LARGEST_STEP, LARGEST_STEP
        elif name in nominal.most:
            high[k] = max(nominal.most[name] - nominal.get(name), 0.0)
    # The solver requires that the two limits of a parameter differ.
    room = np.where(np.isfinite(low), 1e-12 * np.maximum(np.abs(low), 1.0), 0.0)
    return low, np.maximum(high, low + room)


def _point_after(
    views: Sequence[View],
    unit: str,
    point: _Point,
    step: Array,
    effects: Sequence[Added],
    share: float,
) -> _Point:
    """Return the point after a share of a step."""
    placed = tuple(
        replace(
            new,
            coefficients=tuple(
                (1.0 - share) * a + share * b
                for a, b in zip(old.coefficients, new.coefficients, strict=True)
            ),
        )
        for old, new in zip(point.effects, effects, strict=True)
    )
    nominal, placed = start_fit(
        nominal_after_effects(point.nominal.moved(step, step), placed), placed
    )
    return _point_at(views, unit, nominal, placed, point.stack)
