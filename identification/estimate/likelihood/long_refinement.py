"""Refinement by prediction errors in bounded memory: any number of pieces, a few passes over them.

What the in-memory refinement minimises splits into stretches of motion that share nothing but the parameters. So each
piece is settled by itself (its breakaway times, the parameters held), leaves its reduced normal equations behind and is
forgotten; after each pass the parameters take one Gauss-Newton step. The first piece of each stage, refined in memory,
gives the start and the torque noise; from a start that near, one step is as good as all, and a second pass confirms it.
Time grows with the length, memory does not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate.likelihood.refinement import refine_recordings
from identification.estimate.likelihood.stages import Refined
from identification.estimate.uncertainty.covariance import rise_to_static
from identification.filter.breakaway_times import SETTLING, Reduced, reduce, settle
from identification.filter.likelihood import Problem, static_limit
from identification.filter.noise_level import CLIP
from identification.filter.segments import motion
from identification.model.parameters import INDEX, LOGARITHMIC, pack, unpack
from identification.numerics.arrays import Array
from identification.numerics.least_squares import equilibrated
from identification.recording import Model, Recording

PASSES = 3
SETTLED = 0.2
"""Length of a step, in standard errors and root mean square over the parameters, at which the passes end."""


def refine_pieces(
    heads: Sequence[Recording],
    pieces: Sequence[Recording],
    values: Mapping[str, float],
    names: Sequence[str],
    model: Model,
    progress: Callable[[float], None],
    correlated: bool = False,
) -> Refined | str:
    """Return the refined estimate over all pieces, or in words why prediction errors do not apply.

    Args:
        heads: The pieces that the start is found on, one or more of each stage.
        pieces: All pieces, heads among them.
        values: Equation-error values of all parameters.
        names: Those that are asked for.
        model: Declared terms and fixed values.
        progress: Called with the share of the passes done, at most.
        correlated: Whether the torque's noise is given a correlated part.
    """
    start = refine_recordings(heads, values, names, model, correlated)
    if isinstance(start, str):
        return start
    # By least squares the inertia would take the loop's own noise for motion; the heads' instruments know better.
    names = [n for n in start.names if n != "J"]
    free = [INDEX[n] for n in names]
    vector = pack(start.values, model.alpha)
    begins: dict[int, list[Array]] = {}
    evaluations = start.evaluations
    for number in range(PASSES):
        found: list[Reduced] = []
        for k, piece in enumerate(pieces):
            moving = motion(piece)
            if moving is None:
                continue
            problem = Problem([moving], vector, free, model, start.noise)
            problem.begins = begins.get(k, [moving.static_crossing(static_limit(vector, moving))])
            settle(problem, CLIP, SETTLING if number == 0 else 1)
            begins[k] = problem.begins
            found.append(reduce(problem, CLIP))
            evaluations += problem.evaluations
            progress((number + (k + 1) / len(pieces)) / PASSES)
        normal = np.sum([r.normal for r in found], axis=0)
        gradient = np.sum([r.scores.sum(axis=0) for r in found], axis=0)
        step = -np.linalg.pinv(normal, hermitian=True, rcond=1e-14) @ gradient
        x = problem.origin()
        x[: len(free)] += step
        vector = problem.parameters(x)
        if step @ normal @ step < len(free) * SETTLED**2:
            break
    achieved, floor = start.covariance.copy(), start.floor.copy()
    order = np.ix_(*2 * [[start.names.index(n) for n in names]])
    achieved[order], floor[order] = _covariances(found, names, vector)
    squares, count = sum(r.squares for r in found), sum(r.count for r in found)
    return replace(
        start,
        values={**start.values, **unpack(vector, [n for n in INDEX if n in start.values])},
        covariance=achieved,
        floor=floor,
        innovation_rms=float(np.sqrt(squares / count)),
        whiteness=sum(r.neighbours for r in found) / squares,
        evaluations=evaluations,
        iterations=start.iterations + number + 1,
        breakaways=sum(len(r.scores) for r in found),
    )


def _covariances(found: Sequence[Reduced], names: Sequence[str], vector: Array) -> tuple[Array, Array]:
    """Return the covariance of the named parameters, the larger of information's and sandwich's, and its bound."""
    normal, scale = equilibrated(np.sum([r.normal for r in found], axis=0))
    scores = np.concatenate([r.scores for r in found])
    bread = np.linalg.pinv(normal, hermitian=True)
    scaled = scores / scale
    clusters = max(len(scores), 2)
    sandwich = bread @ (scaled.T @ scaled) @ bread * clusters / max(clusters - len(names), 1)
    mean_square = sum(r.squares for r in found) / sum(r.count for r in found)
    plain = bread * max(mean_square, 1.0)
    widen = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(plain), 1.0))
    stretch = np.array([vector[INDEX[n]] if INDEX[n] in LOGARITHMIC else 1.0 for n in names])
    turn = rise_to_static(names)
    full = plain * np.outer(widen * stretch / scale, widen * stretch / scale)
    bound = bread * np.outer(stretch / scale, stretch / scale)
    return np.asarray(turn @ full @ turn.T), np.asarray(turn @ bound @ turn.T)
