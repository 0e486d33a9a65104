"""Computes which effects recordings can show, at which least size, and which effects they cannot
distinguish.

The answer depends on excitation, channels and noise only: it is computed from the regressors of the
effects, with the nominal tangent projected out. The mismatch is not used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.diagnosis.joint import Joint
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Stack
from identification.effects.effect import Context, Effect, Shape
from identification.recording import Array


@dataclass(frozen=True)
class Observable:
    """Observability of one effect."""

    name: str  # name in the catalogue
    # Share of the regressor's squares that the nominal parameters cannot explain, median over trial
    # parameters; zero if no recording can show the effect.
    left: float
    # Name of each parameter to its value at the least size that the recordings can show. Of the
    # trial parameters, those with the median least size are used; if the trial parameters determine
    # the size, those with the smallest observable size. Empty if the effect is not observable.
    sizes: Mapping[str, float]
    # Name of each effect that explains at least the share `alike` of this effect's regressor to the
    # share that it explains, greatest first.
    alike: Mapping[str, float]


@dataclass(frozen=True)
class _Trial:
    """An effect at trial parameters."""

    term: Effect  # effect of the effect
    shape: Shape  # trial values of its nonlinear parameters
    span: Array  # orthonormal regressors with the tangent projected out, shape (n, k)
    left: float  # share of the squares of the regressors that remains after the projection
    gain: float  # sum of whitened squares if the first coefficient is one
    rows: int  # number of rows of the effect's equations


def observable(joint: Joint, terms: Sequence[Effect]) -> tuple[Observable, ...]:
    """Return the observability of each effect, in the order of the terms.

    Args:
        joint: Fit of the nominal model; only its values and its noise are used.
        terms: Terms of the effects.
    """
    context = Context(joint.views, joint.nominal)
    trials = [t for term in terms for t in _trials(joint.stack, context, term)]
    explained = _explained(trials)
    needed = RULES.level / max(len(trials), 1)
    out = []
    for term in terms:
        own = [k for k, t in enumerate(trials) if t.term is term]
        if not own:
            out.append(Observable(term.name, 0.0, {}, {}))
            continue
        left = float(np.median([trials[k].left for k in own]))
        sizes = _least_sizes([trials[k] for k in own], context, needed)
        out.append(Observable(term.name, left, sizes, _alike(trials, explained, own)))
    return tuple(out)


def _trials(stack: Stack, context: Context, term: Effect) -> Iterator[_Trial]:
    for shape in term.shapes(context):
        columns = stack.columns(term, shape)
        if not columns:
            continue
        whole = stack.whitened(columns)
        rest = stack.projected(whole)
        before, after = (np.sum(c**2, axis=0) for c in (whole, rest))
        if not np.all(before > 0.0) or not np.all(after > RULES.collinear_below**2 * before):
            continue
        span, _ = np.linalg.qr(rest)
        rows = sum(len(c) for c in columns.values())
        share = float(np.sum(after) / np.sum(before))
        yield _Trial(term, shape, span, share, float(after[0]), rows)


def _explained(trials: Sequence[_Trial]) -> Array:
    """Return the share of each trial's span that each other trial's span contains, shape (t, t)."""
    if not trials:
        return np.zeros((0, 0))
    every = np.concatenate([t.span for t in trials], axis=1)
    owner = np.repeat(np.arange(len(trials)), [t.span.shape[1] for t in trials])
    squares = (every.T @ every) ** 2
    edges = np.flatnonzero(np.diff(owner, prepend=-1))
    sums = np.add.reduceat(np.add.reduceat(squares, edges, axis=0), edges, axis=1)
    return np.asarray(sums / np.bincount(owner)[:, None])


def _alike(trials: Sequence[_Trial], explained: Array, own: Sequence[int]) -> dict[str, float]:
    """Return the effects that explain one effect at more than half of its trial parameters."""
    found = {}
    for name in {t.term.name for t in trials} - {trials[own[0]].term.name}:
        others = [k for k, t in enumerate(trials) if t.term.name == name]
        best = np.max(explained[np.ix_(own, others)], axis=1)
        if np.mean(best >= RULES.alike) >= RULES.alike_shapes:
            found[name] = float(np.median(best[best >= RULES.alike]))
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _least_sizes(own: Sequence[_Trial], context: Context, level: float) -> dict[str, float]:
    """Return the parameters of an effect at the smallest size that the recordings can show.

    The squares that the effect explains must be significant at ``level``, and must exceed the share
    of the noise (`least_share`) below which an effect is negligible.
    """
    linear: list[tuple[float, Mapping[str, float]]] = []
    shaped: list[tuple[float, Mapping[str, float]]] = []
    for trial in own:
        width, size = trial.span.shape[1], trial.term.size
        needed = max(float(stats.chi2.isf(level, width)), RULES.least_share * trial.rows)
        coefficients = np.zeros(width)
        coefficients[0] = math.sqrt(needed / trial.gain) if size is None else size
        read = trial.term.read(coefficients, trial.shape, context)
        if size is None:
            linear.append((float(coefficients[0]), read))
        elif size**2 * trial.gain >= needed:
            shaped.append((trial.gain, read))
    if linear:
        # All values are those of one set of trial parameters, because values of different sets do
        # not belong together: the mass of a wrong weight belongs to its recording.
        middle = sorted(linear, key=lambda found: found[0])[len(linear) // 2]
        return {name: float(value) for name, value in middle[1].items()}
    return dict(min(shaped, key=lambda found: found[0])[1]) if shaped else {}


# Finds effects that are collinear with the nominal model, so that recordings with these loads and
# channels cannot show them.
#
# For example, if friction is the only load, a gear with 80 % efficiency is equivalent to nominal
# parameters that are larger by 1/0.8.


def collinear_effects(baseline: Joint, terms: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of effects that are collinear with the nominal tangent, whatever their size.

    Only effects without nonlinear parameters are tested, because an effect with several trial
    parameters is not collinear at all of them. The breakaway equation is not used, because its
    tangent includes the delay of the breakaway.

    Args:
        baseline: Fit of the nominal model.
        terms: Terms of the effects that were tried.
    """
    context = Context(baseline.views, baseline.nominal)
    stack = baseline.stack
    judging = np.ones(len(stack.residual), dtype=bool)
    for equation in stack.equations:
        judging[stack.part(equation.name)] = equation.judges
    found = []
    for term in terms:
        shapes = list(term.shapes(context))
        columns = stack.columns(term, shapes[0]) if len(shapes) == 1 else {}
        if not columns:
            continue
        whole = stack.whitened(columns)
        before, after = (
            np.linalg.norm(rows[judging], axis=0) for rows in (whole, stack.projected(whole))
        )
        if np.all(before > 0.0) and np.all(after < RULES.collinear_below * before):
            found.append(term.name)
    return tuple(found)
