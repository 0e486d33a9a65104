"""Computes the residuals of recordings set aside, and compares those of two fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.linear import Added
from identification.diagnosis.fit.stack import Stack, stack_of
from identification.diagnosis.rows.equations import Equation, equations
from identification.diagnosis.rules import RULES
from identification.recording import Array
from identification.views.view import View


def validation_residual(
    joint: Joint, aside: Sequence[View], unit: str, starts: Sequence[Added] = ()
) -> tuple[Stack, Array] | None:
    """Return the rows of recordings set aside, and the residual of a fit at these rows, relative to
    the noise of the fitted recordings; None if too few samples are in steady motion.

    No nominal parameter and no effect is fitted to these rows. In equations other than the torque
    equation, constants such as the zero of an encoder are fitted but not reported. Unknown states
    at the start of a recording, of the effects of the fit and of ``starts``, are fitted too.
    """
    rows = equations(aside, joint.nominal, unit)
    sigma = {e.name: e.sigma for e in joint.equations}
    rows = tuple(_with_noise(e, sigma[e.name]) for e in rows if e.name in sigma)
    if not rows:
        return None
    stack = stack_of(rows, joint.nominal)
    left = np.concatenate([e.residual / e.sigma for e in rows])
    for effect in joint.effects:
        # An effect that occurs in one recording only, such as a mislabelled weight, does not occur
        # in recordings set aside.
        columns = stack.columns(effect.term, effect.shape) if effect.term.place is None else {}
        if columns:
            left -= stack.whitened(columns) @ np.array(effect.coefficients)
    left = _with_own_constants(stack, left[:, None])[:, 0]
    return stack, _without_start_states(stack, (*joint.effects, *starts), left)


def _with_noise(equation: Equation, sigma: float) -> Equation:
    """Return an equation relative to another noise; the own noise of each recording does not
    change.
    """
    ratio = (equation.sigma / sigma) ** 2
    own = {index: max(1.0, power * ratio) for index, power in equation.own.items()}
    return replace(equation, sigma=sigma, own=own)


def _with_own_constants(stack: Stack, rows: Array) -> Array:
    """Return whitened rows, shape (n, k), after a linear fit of the parameters of all equations
    except the torque equation.
    """
    out = rows.copy()
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name != "torque":
            part = stack.part(equation.name)
            out[part] -= basis @ (basis.T @ out[part])
    return out


def _without_start_states(stack: Stack, effects: Sequence[Added], left: Array) -> Array:
    """Return rows after a fit of the unknown states of the effects at the start of each recording,
    such as the temperature of the winding.
    """
    owner = np.concatenate([e.owner for e in stack.equations])
    for effect in effects:
        if not effect.term.start:
            continue
        begun = effect.term.modified(name=f"start of {effect.term.name}", columns=effect.term.start)
        columns = stack.columns(begun, effect.shape)
        if not columns:
            continue
        whole = stack.whitened(columns)
        own = np.concatenate([whole * (owner == k)[:, None] for k in np.unique(owner)], axis=1)
        own = _with_own_constants(stack, own[:, np.any(own, axis=0)])
        left = left - own @ np.linalg.lstsq(own, left, rcond=None)[0]
    return left


def validation_rms(joint: Joint, aside: Sequence[View], unit: str) -> dict[str, float]:
    """Return the rms error of each equation on recordings set aside
    (:func:`validation_residual`).
    """
    found = validation_residual(joint, aside, unit) if aside else None
    if found is None:
        return {}
    stack, left = found
    return {
        e.name: e.sigma * float(np.sqrt(np.mean(left[stack.part(e.name)] ** 2)))
        for e in stack.equations
    }


def judged_rows(stack: Stack, rows: Array, names: Sequence[str]) -> Array:
    """Return those rows of the whole stack that belong to the named equations."""
    return np.concatenate([rows[:0], *(rows[stack.part(name)] for name in names)])


def reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return :func:`studentised_reduction`; infinite if the second residual has most of its squares
    beyond the noise in excess of the first residual.

    An effect that occurs in a few blocks, such as an end stop, may explain nearly the whole
    mismatch, although a few blocks are not sufficient for a standard error.
    """
    explained = explained_share(stack, left, names)
    if explained is not None and explained >= RULES.adequate:
        return math.inf
    return studentised_reduction(stack, left, names)


def explained_share(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float | None:
    """Return the relative reduction of the squares beyond the noise from the second residual to the
    first, over the named equations together, or None if the second residual has no squares beyond
    the noise.
    """
    rows = judged_rows(stack, np.stack(left, axis=1), names)
    within = RULES.excess * len(rows)
    first, second = (max(float(squares), within) for squares in np.sum(rows**2, axis=0))
    return (second - first) / (second - within) if second > within else None


def studentised_reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return by how many standard errors, over blocks of time, the first residual is smaller than
    the second in the named equations together.

    The rms of each block is compared; with squares, a few blocks would determine the result.
    """
    shown = np.zeros(len(left[0]), dtype=bool)
    for name in names:
        shown[stack.part(name)] = True
    squares = stack.sums(np.stack(left, axis=1) ** 2 * shown[:, None])
    lessened = np.diff(np.sqrt(squares), axis=1)[:, 0]
    scatter = float(np.std(lessened, ddof=1)) if len(lessened) > 1 else 0.0
    spread = scatter * math.sqrt(len(lessened))
    worth = float(np.sum(lessened)) / spread if spread > 0.0 else math.inf
    first, second = np.sum(squares, axis=0)
    return worth if first < second else min(worth, 0.0)


def decisive_reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return :func:`studentised_reduction`; 0 if there is only one block, or if the two mean
    squares differ by less than the uncertainty of the mean square of the noise.
    """
    rows = judged_rows(stack, np.stack(left, axis=1), names)
    low, high = sorted(float(squares) for squares in np.sum(rows**2, axis=0))
    if stack.blocks < 2 or high <= RULES.tested_from * low:
        return 0.0
    return studentised_reduction(stack, left, names)
