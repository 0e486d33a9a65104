"""Maximises the likelihood of long recordings in bounded memory, by passes over their pieces (M44).

The deviance is a sum over motion segments, which have only the parameters in common. For each piece
the breakaway times are optimised with fixed parameters, and the piece is reduced to its normal
equations. After each pass over all pieces the parameters take one Gauss-Newton step. The first
piece of each recording is a head. A refinement of the heads in memory gives the start values, the
noise and the inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate.likelihood.refinement import refine_recordings
from identification.estimate.likelihood.stages import Refined
from identification.estimate.uncertainty.covariance import not_below, rise_to_static
from identification.filter.breakaway_times import ROUNDS, Reduced, optimise_breakaway_times, reduce
from identification.filter.likelihood import Point
from identification.filter.noise import Noise
from identification.filter.noise_level import HUBER_THRESHOLD
from identification.filter.segments import motion
from identification.model.parameters import INDEX, LOGARITHMIC, pack, unpack
from identification.numerics.arrays import Array
from identification.numerics.least_squares import equilibrated
from identification.recording import Model, Recording

PASSES = 3
SETTLED = 0.2
"""Size of a step below which the passes end: rms over the parameters, in standard errors."""


def refine_pieces(
    heads: Sequence[Recording],
    pieces: Sequence[Recording],
    values: Mapping[str, float],
    names: Sequence[str],
    model: Model,
    progress: Callable[[float], None],
    correlated: bool = False,
) -> Refined | str:
    """Return the refined estimate over all pieces, or a text with the reason why prediction errors
    do not apply.

    Args:
        heads: First pieces of recordings, for the start values, one or more for each load
            condition.
        pieces: All pieces, including the heads.
        values: Equation-error values of all parameters.
        names: Parameters to fit.
        model: Declared terms and fixed values.
        progress: Called with the ratio of the passes done to the greatest number of passes.
        correlated: Whether the torque noise has a correlated part.
    """
    start = refine_recordings(heads, values, names, model, correlated)
    if isinstance(start, str):
        return start
    # Least squares give a biased inertia, because noise in the drive's loop counts as excitation;
    # therefore the inertia is that of the heads.
    names = [n for n in start.names if n != "J"]
    free = [INDEX[n] for n in names]
    vector = pack(start.values, model.alpha)
    begins: dict[int, tuple[Array, ...]] = {}
    evaluations = start.evaluations
    left_out = dict.fromkeys(piece.name for piece in pieces)
    for number in range(PASSES):
        found: list[Reduced] = []
        for k, piece in enumerate(pieces):
            settled = _settled(piece, vector, free, model, start.noise, begins.get(k))
            if settled is None:
                continue
            point = settled
            left_out.pop(piece.name, None)
            begins[k] = point.breakaway_times
            found.append(reduce(point, HUBER_THRESHOLD))
            evaluations += point.filter.evaluations
            progress((number + (k + 1) / len(pieces)) / PASSES)
        step, length = _step(found)
        x = point.origin()
        x[: len(free)] += step
        vector = point.parameters(x)
        if length < len(free) * SETTLED**2:
            break
    evaluated = replace(
        start,
        evaluations=evaluations,
        iterations=start.iterations + number + 1,
        left_out=tuple(left_out),
    )
    return _over_all(evaluated, found, names, vector)


def _step(found: Sequence[Reduced]) -> tuple[Array, float]:
    """Return the Gauss-Newton step of the parameters, and its squared norm in standard errors."""
    normal = np.sum([r.normal for r in found], axis=0)
    gradient = np.sum([r.scores.sum(axis=0) for r in found], axis=0)
    step = -np.linalg.pinv(normal, hermitian=True, rcond=1e-14) @ gradient
    return step, float(step @ normal @ step)


def _over_all(
    start: Refined, found: Sequence[Reduced], names: Sequence[str], vector: Array
) -> Refined:
    """Return the estimate of the heads, with values, covariance and innovations replaced by those
    of all pieces.

    Args:
        start: The estimate of the heads.
        found: Normal equations of the pieces.
        names: Parameters that all pieces determine.
        vector: Parameters.
    """
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
        breakaways=sum(len(r.scores) for r in found),
    )


def _settled(
    piece: Recording,
    vector: Array,
    free: Sequence[int],
    model: Model,
    noise: Noise,
    begins: tuple[Array, ...] | None,
) -> Point | None:
    """Return a piece with optimised breakaway times, or None if prediction errors do not apply to
    the piece.

    Args:
        piece: The piece.
        vector: Parameters.
        free: Indices of the free parameters.
        model: Declared terms and fixed values.
        noise: Noise of torque and angle.
        begins: Breakaway times of the previous pass, s; None in the first pass.
    """
    moving = motion(piece)
    if moving is None:
        return None
    point = Point.of([moving], vector, free, model, noise)
    if begins is None:
        return optimise_breakaway_times(point, HUBER_THRESHOLD, ROUNDS)
    return optimise_breakaway_times(replace(point, breakaway_times=begins), HUBER_THRESHOLD, 1)


def _covariances(
    found: Sequence[Reduced], names: Sequence[str], vector: Array
) -> tuple[Array, Array]:
    """Return the covariance of the named parameters and its Cramer-Rao bound; the covariance is the
    larger of the inverse information and the sandwich covariance.
    """
    normal, scale = equilibrated(np.sum([r.normal for r in found], axis=0))
    scores = np.concatenate([r.scores for r in found])
    bread = np.linalg.pinv(normal, hermitian=True)
    scaled = scores / scale
    clusters = max(len(scores), 2)
    sandwich = bread @ (scaled.T @ scaled) @ bread * clusters / max(clusters - len(names), 1)
    mean_square = sum(r.squares for r in found) / sum(r.count for r in found)
    plain = bread * max(mean_square, 1.0)
    widen = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(plain), 1.0))
    units = np.array([vector[INDEX[n]] if INDEX[n] in LOGARITHMIC else 1.0 for n in names])
    turn = rise_to_static(names)
    full = plain * np.outer(widen * units / scale, widen * units / scale)
    bound = bread * np.outer(units / scale, units / scale)
    floor = np.asarray(turn @ bound @ turn.T)
    return not_below(turn @ full @ turn.T, floor), floor
