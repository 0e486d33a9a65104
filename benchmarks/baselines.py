"""Greedy selection of effects by BIC on the rows of a diagnosis, as a baseline of the diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.joint import Joint
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Stack
from identification.effects.effect import Context, Effect, Shape
from identification.recording import Array

MOST_STEPS = 40  # greatest number of groups that the greedy selection adds
FOLDS = 4


@dataclass(frozen=True)
class Group:
    """One effect at one set of trial parameters: its columns, and the indices of coefficients that
    must be positive.
    """

    name: str
    shape: Shape
    columns: slice
    positive: tuple[int, ...]


@dataclass(frozen=True)
class Library:
    """Inner products of all regressors, scaled to unit norm."""

    groups: tuple[Group, ...]  # groups in the order of the columns
    gram: Array  # inner products over each fold, shape (f, p, p)
    moment: Array  # inner products with the mismatch, shape (f, p)
    power: Array  # sum of squares of the mismatch over each fold, shape (f,)
    rows: int  # number of whitened rows


def library(joint: Joint, terms: Sequence[Effect]) -> Library:
    """Return the regressors that the search tests on the mismatch of the nominal model."""
    stack = joint.stack
    context = Context(joint.views, joint.nominal)
    groups: list[Group] = []
    found: list[dict[str, Array]] = []
    width = 0
    for term in terms:
        for shape in term.shapes(context):
            columns = _projected(stack, stack.columns(term, shape))
            if columns:
                count = next(iter(columns.values())).shape[1]
                groups.append(Group(term.name, shape, slice(width, width + count), term.positive))
                found.append(columns)
                width += count
    fold_of = _folds(stack)
    folds = int(fold_of.max()) + 1
    gram, moment, power = np.zeros((folds, width, width)), np.zeros((folds, width)), np.zeros(folds)
    for equation in stack.equations:
        mine = [k for k, columns in enumerate(found) if equation.name in columns]
        places = np.array(
            [p for k in mine for p in range(groups[k].columns.start, groups[k].columns.stop)],
            dtype=int,
        )
        residual = stack.residual[stack.part(equation.name)]
        wide = np.concatenate(
            [np.zeros((len(residual), 0)), *(found[k][equation.name] for k in mine)], axis=1
        )
        for fold in range(folds):
            rows = fold_of[equation.owner] == fold
            power[fold] += float(residual[rows] @ residual[rows])
            part = wide[rows]
            gram[fold][np.ix_(places, places)] += part.T @ part
            moment[fold][places] += part.T @ residual[rows]
    scale = np.sqrt(np.einsum("fpp->p", gram))
    return Library(
        tuple(groups), gram / np.outer(scale, scale), moment / scale, power, len(stack.residual)
    )


def _projected(stack: Stack, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return whitened, projected regressors; empty if one is collinear with the nominal model."""
    out: dict[str, Array] = {}
    before: Array | float = 0.0
    after: Array | float = 0.0
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name in columns:
            full = columns[equation.name] / equation.sigma
            out[equation.name] = full - basis @ (basis.T @ full)
            before = before + np.sum(full**2, axis=0)
            after = after + np.sum(out[equation.name] ** 2, axis=0)
    return out if np.all(np.sqrt(after) > RULES.collinear_below * np.sqrt(before)) else {}


def _folds(stack: Stack) -> np.ndarray:
    """Return the fold of each recording by its index; -1 for a recording without rows."""
    recordings = sorted({v.index for e in stack.equations for v in e.views})
    fold = np.full(recordings[-1] + 1, -1, dtype=np.int64)
    fold[recordings] = np.arange(len(recordings)) % FOLDS
    return fold


def greedy_bic(given: Library) -> tuple[str, ...]:
    """Return the selected effects in the order of selection; empty if no effect decreases the
    criterion.
    """
    gram, moment = given.gram.sum(axis=0), given.moment.sum(axis=0)
    power = float(given.power.sum())
    named: dict[str, None] = {}
    for _ in range(MOST_STEPS):
        gains = _gains(gram, moment, given.groups)
        scores = [
            given.rows * math.log(max(1.0 - gain / power, 1e-12))
            + (g.columns.stop - g.columns.start) * math.log(given.rows)
            for gain, g in zip(gains, given.groups, strict=True)
        ]
        best = int(np.argmin(scores))
        if scores[best] >= 0.0:
            break
        taken = given.groups[best].columns
        named.setdefault(given.groups[best].name)
        power -= gains[best]
        lever = (
            np.linalg.pinv(gram[taken, taken], rcond=RULES.collinear_below**2, hermitian=True)
            @ gram[taken]
        )
        moment = moment - lever.T @ moment[taken]
        gram = gram - gram[:, taken] @ lever
    return tuple(named)


def _gains(gram: Array, moment: Array, groups: Sequence[Group]) -> list[float]:
    """Return the squares that each group explains; 0 if collinear or of unphysical sign."""
    gains = np.zeros(len(groups))
    widths = np.array([g.columns.stop - g.columns.start for g in groups])
    for width in np.unique(widths):
        mine = np.flatnonzero(widths == width)
        places = np.array([groups[int(k)].columns.start for k in mine])[:, None] + np.arange(width)
        own, its = gram[places[:, :, None], places[:, None, :]], moment[places]
        known = np.all(np.einsum("gkk->gk", own) >= RULES.collinear_below**2, axis=1)
        known[known] = np.linalg.cond(own[known]) <= RULES.collinear_below**-2
        mine, own, its = mine[known], own[known], its[known]
        coefficients = np.linalg.solve(own, its[:, :, None])[:, :, 0]
        signs = [
            all(c[p] > 0.0 for p in groups[int(k)].positive)
            for k, c in zip(mine, coefficients, strict=True)
        ]
        gains[mine] = np.where(signs, np.einsum("gk,gk->g", coefficients, its), 0.0)
    return [float(gain) for gain in gains]
