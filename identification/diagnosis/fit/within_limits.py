"""Refinement of a fit within the limits of its constants, and the residual of these constants.

The search compares effects by fits without limits. A machine has no negative friction and no
negative inertia. The fit within these limits is the one that is reported and that is scored on
recordings set aside (bounded least squares: Stark and Parker, Comput. Stat. 10 (1995) 129).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from identification.diagnosis.fit.feasibility import (
    exceeds,
    predicted_and_attained,
    with_rises_held,
)
from identification.diagnosis.fit.joint import Joint, begun, told
from identification.diagnosis.fit.linear import Added, directions
from identification.diagnosis.fit.stack import Stack, granting, stacked
from identification.diagnosis.rows.equations import equations
from identification.diagnosis.rows.nominal import LARGEST_STEP, SPEEDS, Nominal
from identification.diagnosis.rows.view import View
from identification.model.parameters import STRIBECK_TERMS
from identification.recording import Array

ROUNDS = 8
"""Most steps: friction's fall and regressors that follow the nominal values make the problem
nonlinear.
"""
SETTLED = 1e-5
"""Relative change of the cost at which they end."""
SHARES = (1.0, 0.5, 0.2)
"""Shares of a step that are tried."""
RIDGE = 1e-4
"""Weight, over that of the rows, at which every constant is drawn to zero: of constants that the
rows cannot tell apart the least are taken.
"""
_COULOMB_OF = {static: coulomb for coulomb, static, _ in STRIBECK_TERMS}


@dataclass(frozen=True)
class _Point:
    """Constants, and what they leave.

    Attributes:
        nominal: Within its limits.
        effects: With coefficients.
        stack: There.
        left: Whitened rows, shape (n,): of the torque what these constants leave, of the other
            equations less what their own constants, which are not reported, absorb.
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
    """Whether a fit is infeasible: with its constants within their limits it leaves far more than
    the unlimited fit predicts. Its effects are then not accepted either.

    A fit whose last effect is not in the torque equation is never called infeasible: such an effect
    changes no constant of friction.
    """
    if joint.effects and "torque" not in joint.effects[-1].term.columns:
        return False
    promised, kept = predicted_and_attained(joint.stack, joint.effects, joint.residual)
    return exceeds(promised, kept) and exceeds(
        promised, with_rises_held(joint.stack, joint.effects)
    )


def within_limits(views: Sequence[View], unit: str, joint: Joint) -> Joint:
    """Return a fit with its constants and coefficients refined within their limits.

    Its residual is what these constants leave, not what a step of them would.

    Args:
        views: Recordings that were fitted.
        unit: Of the torque.
        joint: The fit.
    """
    best = _at(views, unit, joint.nominal, joint.effects, joint.stack)
    for _ in range(ROUNDS):
        better = None
        for held in ((), SPEEDS):
            step, effects = _bounded(best, held)
            trials = (_after(views, unit, best, share * step, effects, share) for share in SHARES)
            better = next((t for t in trials if t.cost < best.cost), None)
            if better is not None:
                break
        if better is None:
            break
        done = better.cost > (1.0 - SETTLED) * best.cost
        best = better
        if done:
            break
    left = replace(best.stack, residual=best.stack.projected(best.left[:, None])[:, 0])
    granted = granting(left, directions(left, best.effects))
    return Joint(best.nominal, best.effects, best.stack.equations, best.left, granted)


def moves(joint: Joint) -> Array:
    """Return what steps of the constants and coefficients change, whitened, shape (n, k)."""
    return _problem(_Point(joint.nominal, joint.effects, joint.stack, joint.residual), ())[0]


def predicted(joint: Joint, parts: Array) -> Array:
    """Return what a fit within its limits leaves of each part of the rows when its constants and
    coefficients are those of all other parts, whitened, shape (n,).

    Args:
        joint: From :func:`within_limits`.
        parts: Number of each row's part, shape (n,); of rows in none (-1) nothing is left.
    """
    point = _Point(joint.nominal, joint.effects, joint.stack, joint.residual)
    every, begin, limits, drawn = _problem(point, ())
    out = np.where(parts < 0, 0.0, joint.residual)
    for part in np.unique(parts[parts >= 0]):
        mine = parts == part
        found = _solved(every[~mine], point.left[~mine] + every[~mine] @ begin, limits, drawn)
        out[mine] += every[mine] @ (begin - found)
    return out


def _at(
    views: Sequence[View], unit: str, nominal: Nominal, effects: Sequence[Added], like: Stack
) -> _Point:
    stack = stacked(equations(views, nominal, unit, like.equations), nominal, like)
    left = np.concatenate([e.residual / e.sigma for e in stack.equations])
    for effect in effects:
        columns = stack.whitened(stack.columns(effect.term, effect.shape))
        left -= columns @ np.array(effect.coefficients)
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        rows = stack.part(equation.name)
        if equation.name == "torque":
            left[rows] -= _nuisance(stack) @ (_nuisance(stack).T @ left[rows])
        else:
            left[rows] -= basis @ (basis.T @ left[rows])
    return _Point(nominal, tuple(effects), stack, left)


def _nuisance(stack: Stack) -> Array:
    """Return orthonormal columns of what the torque's rows absorb that is no nominal parameter: the
    rotor's share of the inertia, where the transmission gives.
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    columns = equation.tangent[:, [n not in stack.nominal.free for n in equation.names]]
    basis, _ = np.linalg.qr(columns)
    return np.asarray(basis)


def _bounded(point: _Point, held: Sequence[str]) -> tuple[Array, tuple[Added, ...]]:
    """Return a step of the nominal parameters within their limits, and effects with the
    coefficients that go with it.
    """
    every, begin, limits, drawn = _problem(point, held)
    found = _solved(every, point.left + every @ begin, limits, drawn)
    effects, at = [], len(point.nominal.free)
    for effect in point.effects:
        if effect.term.size is None:
            width = len(effect.coefficients)
            effect = replace(effect, coefficients=tuple(found[at : at + width].tolist()))
            at += width
        effects.append(effect)
    return found[: len(point.nominal.free)], tuple(effects)


def _problem(point: _Point, held: Sequence[str]) -> tuple[Array, Array, tuple[Array, Array], Array]:
    """Return whitened columns of steps of the nominal parameters and of coefficients, shape (n, k),
    where they stand, their limits, and where they are drawn to.
    """
    stack, nominal = point.stack, point.nominal
    count = len(nominal.free)
    torque = next(e for e in stack.equations if e.name == "torque")
    own = np.zeros((len(point.left), count))
    own[stack.part("torque")] = torque.tangent[:, :count] / torque.sigma
    own[:, [k for k, name in enumerate(nominal.free) if name in held]] = 0.0
    low, high = _room(nominal)
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
        q = _nuisance(stack) if equation.name == "torque" else basis
        every[part] -= q @ (q.T @ every[part])
    lower = np.concatenate(lows)
    upper = np.concatenate([high, np.full(len(start) - count, math.inf)])
    drawn = np.concatenate([-_values(nominal), np.zeros(len(start) - count)])
    return every, start, (lower, upper), drawn


def _solved(every: Array, target: Array, limits: tuple[Array, Array], drawn: Array) -> Array:
    """Return the least squares within limits, drawn a little to where they are drawn."""
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
    """Return the values that the directions of a step change: of a static level its rise, of a
    speed nothing, as its logarithm has no zero.
    """
    return np.array(
        [
            0.0 if name in SPEEDS else nominal.get(name) - nominal.get(_COULOMB_OF.get(name, ""))
            for name in nominal.free
        ]
    )


def _room(nominal: Nominal) -> tuple[Array, Array]:
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
    # The solver asks for some room between limits.
    room = np.where(np.isfinite(low), 1e-12 * np.maximum(np.abs(low), 1.0), 0.0)
    return low, np.maximum(high, low + room)


def _after(
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
    nominal, placed = begun(told(point.nominal.moved(step, step), placed), placed)
    return _at(views, unit, nominal, placed, point.stack)
