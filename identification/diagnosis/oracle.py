"""Computes the oracle of a proof: the error, on recordings set aside, of a model with the true
effects, whose names are given and whose parameters are fitted to the recordings of the diagnosis.

Sizes and nonlinear parameters of the effects, and the nominal parameters, are estimated from the
fitted recordings alone, as in a diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from identification.diagnosis.held_out import validation_rms
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.rules import RULES
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.stack import Stack
from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Context, Effect, Shape
from identification.prepare import torque_unit
from identification.recording import Array, Dataset
from identification.views.view import views


@dataclass(frozen=True)
class HeldOut:
    """Rms errors on recordings set aside, in the equation in which the true effects reduce the
    error most.
    """

    equation: str  # name of the equation
    baseline_rms: float  # error of the nominal model alone, in the unit of the equation
    oracle_rms: float  # error with the true effects, in the unit of the equation
    noise_rms: float  # noise of one row, in the unit of the equation
    # Name of each effect to its remaining strength: the error that the effect would cause after a
    # new fit of all other parameters without the effect, over the noise of a row, in the equation
    # in which this ratio is greatest.
    remaining_strength: Mapping[str, float]


def oracle(
    dataset: Dataset, first: Joint, names: Sequence[str], bandwidth_Hz: float
) -> HeldOut | None:
    """Fit the effects with the given names, and compute the errors on the recordings set aside.

    The result is None if these recordings have no row of any equation, or if an effect is collinear
    with the nominal model or its fitted coefficient has an unphysical sign.
    """
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not held:
        return None
    gives = any(EFFECTS[name].flexible for name in names)
    here = views(fitted, bandwidth_Hz, gives, dataset.recordings)
    baseline = fit(here, torque_unit(fitted[0]), first.nominal)
    left = {
        t.name: t for t in (e.on_the_joint() if gives else e for e in MOTION) if t.name in names
    }
    joint = baseline
    while left:
        trials = trial_candidates(
            joint.stack, Context(joint.views, joint.nominal), list(left.values())
        )
        best = max(trials, key=lambda c: c.score, default=None)
        if best is None:
            return None
        added = Added(left.pop(best.name), best.shape, tuple(float(c) for c in best.coefficients))
        joint = baseline.again(joint.nominal, (*joint.effects, added))
    aside = views((*fitted, *held), bandwidth_Hz, gives, dataset.recordings)[len(fitted) :]
    before, after = validation_rms(baseline, aside), validation_rms(joint, aside)
    noise = {e.name: e.sigma for e in baseline.equations if e.name in before and e.judges}
    if not noise:
        return None
    where = max(noise, key=lambda name: (before[name] ** 2 - after[name] ** 2) / noise[name] ** 2)
    remaining_strength = {}
    for effect in joint.effects:
        rest = tuple(e for e in joint.effects if e is not effect)
        without = baseline.again(joint.nominal, rest) if rest else baseline
        beyond = [
            float(np.mean(without.residual[rows] ** 2 - joint.residual[rows] ** 2))
            for rows in map(joint.stack.part, noise)
        ]
        remaining_strength[effect.term.name] = math.sqrt(max(0.0, *beyond))
    return HeldOut(where, before[where], after[where], noise[where], remaining_strength)


MOST_STEPS = 40  # greatest number of groups that the greedy selection adds
FOLDS = 4
RIDGE = 1e-3
"""Ridge penalty, relative to the unit norm of the regressors; with it the normal equations are
solvable although regressors at neighbouring trial parameters are nearly collinear.
"""
LEAST_THRESHOLD = 3.0
"""First threshold of the path: norm of a contribution, relative to the noise of one row; smaller
contributions occur by chance.
"""
THRESHOLDS = 20  # number of thresholds on the path, up to the strongest contribution
MOST_ROUNDS = 10  # greatest number of iterations at one threshold


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


def sparse(given: Library) -> tuple[str, ...]:
    """Return the selected effects sorted by the power of their contribution, greatest first; empty
    if all contributions are below the threshold.
    """
    gram, moment = given.gram.sum(axis=0), given.moment.sum(axis=0)
    greatest = math.sqrt(max(_gains(gram, moment, given.groups), default=0.0))
    if greatest <= LEAST_THRESHOLD:
        return ()
    thresholds = np.geomspace(LEAST_THRESHOLD, 1.01 * greatest, THRESHOLDS)
    errors = np.zeros((len(given.power), THRESHOLDS))
    for fold in range(len(given.power)):
        path = _path(given.groups, gram - given.gram[fold], moment - given.moment[fold], thresholds)
        for k, c in enumerate(path):
            errors[fold, k] = (
                given.power[fold] - 2.0 * c @ given.moment[fold] + c @ given.gram[fold] @ c
            )
    total = errors.sum(axis=0)
    apart = errors - errors[:, [int(np.argmin(total))]]
    deviation = (
        np.std(apart, axis=0, ddof=1) * math.sqrt(len(errors))
        if len(errors) > 1
        else np.zeros(THRESHOLDS)
    )
    chosen = int(np.flatnonzero(apart.sum(axis=0) <= deviation)[-1])
    coefficients = _path(given.groups, gram, moment, thresholds)[chosen]
    power: dict[str, float] = {}
    for name in {g.name for g in given.groups}:
        own = np.concatenate(
            [np.arange(len(moment))[g.columns] for g in given.groups if g.name == name]
        )
        power[name] = float(coefficients[own] @ gram[np.ix_(own, own)] @ coefficients[own])
    return tuple(sorted((n for n in power if power[n] > 0.0), key=lambda n: -power[n]))


def _path(groups: Sequence[Group], gram: Array, moment: Array, thresholds: Array) -> list[Array]:
    """Return coefficients, shape (p,), at each of the rising thresholds, each from the last."""
    left = list(groups)
    coefficients = np.zeros(len(moment))
    out = []
    for threshold in thresholds:
        for _ in range(MOST_ROUNDS):
            if not left:
                break
            places = np.concatenate([np.arange(len(moment))[g.columns] for g in left])
            square = gram[np.ix_(places, places)]
            coefficients = np.zeros(len(moment))
            coefficients[places] = linalg.solve(
                square + RIDGE * np.eye(len(places)), moment[places], assume_a="pos"
            )
            kept = [g for g in left if _stays(g, gram, coefficients, float(threshold))]
            if len(kept) == len(left):
                break
            left = kept
        out.append(coefficients if left else np.zeros(len(moment)))
    return out


def _stays(group: Group, gram: Array, coefficients: Array, threshold: float) -> bool:
    """Whether a group stays in the sparse regression: strong enough, of physical sign."""
    own = coefficients[group.columns]
    power = float(own @ gram[group.columns, group.columns] @ own)
    return power >= threshold**2 and all(own[k] > 0.0 for k in group.positive)
