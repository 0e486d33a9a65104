"""Builds the pressure equation of the gas diagnosis: the pressure mismatch and the regressors of
every gas effect, with the nominal tangent projected out.

The result has the types of the torque diagnosis (``Stack``, ``Candidate``), so that its
significance tests can be used. There is one row for each averaged sample (mismatch over noise), and
one row for each parameter with a prior (deviation from the nominal value over the tolerance).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from identification.diagnosis.gas.burns import Burn
from identification.diagnosis.gas.fit import Fitted, Model, simulate, simulated_burn
from identification.diagnosis.rows import GREATEST_BLOCK_S, LEAST_BLOCK_S, Equation, edges
from identification.diagnosis.stack import Candidate, Stack
from identification.effects import GAS
from identification.effects.gas_generator import GasEffect, GasGeneratorEffect
from identification.estimate.equation_error import BLOCK_CORRELATION_TIMES
from identification.numerics.spread import correlation_samples
from identification.recording import Array
from identification.views.nominal import Nominal

PRESSURE = "pressure"
"""Name of the equation."""
UNIT = "Pa"
_PIECES = 4
"""Number of intervals of time of each recording for which a generic family has a constant each."""
_SMALL = 0.01
"""Size of an effect, relative to its scale, for numerical derivatives; at this size the effect is
linear.
"""


@dataclass(frozen=True)
class Coordinate:
    """A coordinate on which the mismatch may depend; ``values`` computes the coordinate from a
    recording and its simulated (pressure, web), shape (m,).
    """

    name: str
    unit: str
    values: Callable[[Burn, Array], Array]


COORDINATES = (
    Coordinate("time", "s", lambda b, _m: b.time),
    Coordinate("web burnt", "m", lambda _b, m: m[1]),
    Coordinate("pressure", "Pa", lambda _b, m: m[0]),
    Coordinate("throat area", "m^2", lambda b, _m: b.areas[0]),
    Coordinate("opening rate", "m^2/s", lambda b, _m: b.opening_rate),
)


def stack_of(
    burns: Sequence[Burn], fitted: Fitted, sigma: float, like: Stack | None = None
) -> Stack:
    """Return the stack of the mismatch of a fit, with the tangent of all fitted parameters
    projected out.

    The rows of the recordings are followed by one row for each prior, in a separate block;
    therefore fitted parameters can replace an effect only within their tolerances.

    Args:
        burns: Recordings.
        fitted: Fit to these recordings.
        sigma: Noise of a row, Pa.
        like: A stack of the same recordings, whose blocks are reused.
    """
    held = fitted.held > 0.0
    residual = np.concatenate((fitted.residual, fitted.pull[held]))
    tangent = np.concatenate((fitted.tangent, np.diag(fitted.held)[held]))
    priors = int(np.sum(held))
    owner = np.concatenate([*(np.full(len(b.time), b.index) for b in burns), np.full(priors, -1)])
    time = np.concatenate([*(b.time for b in burns), np.zeros(priors)])
    equation = Equation(
        PRESSURE, UNIT, (), (), sigma * residual, sigma * tangent, (), owner, time, sigma
    )
    values, vectors = np.linalg.eigh(tangent.T @ tangent)
    keep = values > 1e-12 * float(values[-1])
    basis = tangent @ (vectors[:, keep] / np.sqrt(values[keep]))
    if like is None:
        block, count = _blocks(burns, fitted.residual, owner)
        gather = (
            sparse.csr_matrix(
                (np.ones(len(block)), (block, np.arange(len(block)))), shape=(count, len(block))
            ),
        )
    else:
        block, count, gather = like.block, like.blocks, like.gather
    nominal = Nominal(fitted.model.constants, tuple(fitted.model.constants), 2.0)
    left = residual - basis @ (basis.T @ residual)
    return Stack(
        (equation,), nominal, (basis,), np.zeros((len(left), 0)), left, block, count, gather
    )


def padded_rows(stack: Stack, values: Array) -> Array:
    """Return the rows padded with zeros for the priors, shape (n + p, ...)."""
    out = np.zeros((len(stack.residual), *values.shape[1:]))
    out[: len(values)] = values
    return out


def candidates(
    burns: Sequence[Burn], stack: Stack, fitted: Fitted, terms: Sequence[GasGeneratorEffect] = GAS
) -> Iterator[Candidate]:
    """Yield every effect at all trial parameters, linearised about the fit; the coefficients are in
    the unit of the effect.
    """
    for term in terms:
        for shape in term.start_values:
            columns = {PRESSURE: padded_rows(stack, slope(burns, fitted, term, shape)[:, None])}
            found = stack.candidate(term.name, shape, columns)
            if found is not None:
                yield found


def starts(
    burns: Sequence[Burn], stack: Stack, fitted: Fitted, term: GasGeneratorEffect
) -> list[tuple[float, float, tuple[float, ...]]]:
    """Fit the size of an effect by linear least squares at each set of trial parameters; return
    (decrease of the sum of squares, size, trial parameters) for each set, the greatest decrease
    first.
    """
    found = []
    for shape in term.start_values:
        column = stack.projected(
            stack.whitened(
                {PRESSURE: padded_rows(stack, slope(burns, fitted, term, shape)[:, None])}
            )
        )
        power, score = float(np.sum(column**2)), float(column[:, 0] @ stack.residual)
        if power > 0.0:
            found.append((score**2 / power, score / power, shape))
    return sorted(found, reverse=True)


def slope(
    burns: Sequence[Burn], fitted: Fitted, term: GasGeneratorEffect, shape: tuple[float, ...]
) -> Array:
    """Return the derivative of the pressure with respect to an effect's size, Pa over the unit of
    the size, shape (n,).
    """
    size = _SMALL * next(iter(term.sizes.values())).scale
    effect = GasEffect(term, dict(zip(term.sizes, (size, *shape), strict=True)))
    moved: Model = replace(fitted.model, effects=(*fitted.model.effects, effect))
    return (simulate(burns, moved) - fitted.simulated) / size


def families(burns: Sequence[Burn], stack: Stack, fitted: Fitted) -> Iterator[Candidate]:
    """Yield generic families of regressors: a constant for each bin of every coordinate, and of the
    time within each recording.
    """
    for name, values in coordinates(burns, fitted):
        grid = edges(values)
        if len(grid) > 2:
            yield from _levels(stack, name, np.searchsorted(grid[1:-1], values, side="right"))
    pieces = [
        b.index * _PIECES + (b.time * (_PIECES - 1e-9) / b.time[-1]).astype(np.int64) for b in burns
    ]
    yield from _levels(stack, "time in each recording", np.concatenate(pieces))


def coordinates(burns: Sequence[Burn], fitted: Fitted) -> Iterator[tuple[str, Array]]:
    """Yield the name of every coordinate and its values at all rows, shape (n,)."""
    marched = [simulated_burn(b, fitted.model) for b in burns]
    for coordinate in COORDINATES:
        yield (
            coordinate.name,
            np.concatenate([coordinate.values(b, m) for b, m in zip(burns, marched, strict=True)]),
        )


def _levels(stack: Stack, name: str, place: np.ndarray) -> Iterator[Candidate]:
    columns = (place[:, None] == np.unique(place)).astype(np.float64)
    found = stack.independent(f"{PRESSURE} over {name}", PRESSURE, padded_rows(stack, columns))
    if found is not None:
        yield found


def _blocks(burns: Sequence[Burn], residual: Array, owner: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the block number of each row and the number of blocks. A block of time has ten
    correlation times of the most correlated mismatch, within limits; the last block has the rows of
    the priors.
    """
    length = LEAST_BLOCK_S
    for burn in burns:
        step = float(burn.time[-1] - burn.time[0]) / (len(burn.time) - 1)
        mine = residual[owner[: len(residual)] == burn.index]
        length = max(length, BLOCK_CORRELATION_TIMES * correlation_samples(mine) * step)
    length = min(length, GREATEST_BLOCK_S)
    parts, count = [], 0
    for burn in burns:
        span = float(burn.time[-1] - burn.time[0])
        number = max(1, round(span / length))
        place = (burn.time - burn.time[0]) / span * number
        parts.append(count + np.minimum(place.astype(np.int64), number - 1))
        count += number
    return np.concatenate([*parts, np.full(len(owner) - len(residual), count)]), count + 1
