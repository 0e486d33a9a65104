"""Locates the mismatch: computes its mean in bins of each coordinate, with simultaneous bands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnosis.result import Location, Map
from identification.diagnosis.rows import (
    DIRECTION,
    FROM_TORQUE,
    LEAST_ROWS,
    LOAD,
    Equation,
    at_rows,
    edges,
    functions_at_rows,
    shows,
    weight_of,
)
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import NOMINAL_IN, Stack
from identification.model.parameters import unit_on
from identification.numerics.spread import CONFIDENCE
from identification.recording import Array

PARTS = 10  # number of parts of the blocks, each of which is predicted from the other parts
MOST_ROWS = 20_000
"""Number of rows of an equation, of which at most this many are used, at equal distances."""
ALONE = 0.9  # leverage of one part from which a function counts as occurring in this part only
ROUNDING = 1e-9


@dataclass(frozen=True)
class Mismatch:
    """The mismatch of one equation, with everything else projected out."""

    step: int  # distance of the rows that are used
    other: Array  # orthonormal columns of the nominal tangent and of other effects, shape (n, g)
    residual: Array  # whitened mismatch without these columns, shape (n,)
    part: np.ndarray  # part of each row, from 0, shape (n,)
    # Sum of squares of the parts, each predicted by the columns `other` that are fitted to the
    # other parts.
    unexplained: float

    def explained(self, resolutions: Iterable[Array], factor: Array) -> float:
        """Return the share of the mismatch that functions predict, at the best resolution.

        Coefficients of the functions and of the columns ``other`` are fitted to all parts of the
        blocks but one, and predict this part. A function that occurs nearly in one part only
        predicts nothing there.

        Args:
            resolutions: Sets of functions at the rows that are used, shape (n, k) each.
            factor: Factor of all functions at these rows, shape (n,).
        """
        return max((self._share(columns * factor[:, None]) for columns in resolutions), default=0.0)

    def _share(self, made: Array) -> float:
        lengths = np.linalg.norm(made, axis=0)
        made = made[:, lengths > 0.0] / lengths[lengths > 0.0]
        if not made.shape[1] or self.unexplained == 0.0:
            return 0.0
        rest = made - self.other @ (self.other.T @ made)
        values, vectors = np.linalg.eigh(rest.T @ rest)
        keep = values > RULES.collinear_below
        q = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        basis = np.concatenate([self.other, q], axis=1)
        left = unpredicted(basis, self.residual, self.part)
        return min(max(0.0, 1.0 - left / self.unexplained), 1.0)


def mismatch_of(stack: Stack, equation: str) -> Mismatch:
    """Return the mismatch of an equation without its nominal tangent and its effect basis."""
    rows = stack.part(equation)
    number = next(k for k, e in enumerate(stack.equations) if e.name == equation)
    step = max(1, -(-(rows.stop - rows.start) // MOST_ROWS))
    given = np.concatenate([stack.basis[number], stack.effect_basis[rows]], axis=1)[::step]
    vectors, sizes, _ = np.linalg.svd(given, full_matrices=False)
    other = vectors[:, sizes > ROUNDING]
    residual = stack.residual[rows][::step]
    residual = residual - other @ (other.T @ residual)
    part = parts(stack.block[rows][::step])
    return Mismatch(step, other, residual, part, unpredicted(other, residual, part))


def parts(block: np.ndarray) -> np.ndarray:
    """Return the part of each row, from 0, shape (n,).

    Blocks are assigned to parts of equal size in a random order, because recordings may repeat one
    motion after a whole number of blocks.
    """
    blocks, place = np.unique(block, return_inverse=True)
    order = np.random.default_rng(0).permutation(len(blocks))
    return np.asarray((order % min(PARTS, len(blocks)))[place])


def unpredicted(basis: Array, residual: Array, part: np.ndarray) -> float:
    """Return the squares that remain if each part is predicted from fits to the other parts."""
    coefficients = basis.T @ residual
    errors = residual - basis @ coefficients
    left = 0.0
    for k in range(int(np.max(part, initial=-1)) + 1):
        rows = part == k
        here, error = basis[rows], errors[rows]
        leverage, axes = np.linalg.eigh(here.T @ here)
        alone = leverage > ALONE
        change = np.where(
            alone,
            axes.T @ coefficients,
            axes.T @ (here.T @ error) / np.where(alone, 1.0, 1.0 - leverage),
        )
        left += float(np.sum((error + here @ (axes @ change)) ** 2))
    return left


BINS = 16
TURN_BINS, TURN_ROWS = 64, 1000
"""Bins over a turn, which show waves, and the number of rows from which they are used."""
DRAWS = 499


def maps(
    stack: Stack,
    equation: Equation,
    before: Array,
    after: Array,
    rng: np.random.Generator,
    own: str = "",
) -> tuple[Map, ...]:
    """Return maps of one equation's mismatch over every coordinate, greatest share first.

    Args:
        stack: Stack with blocks and rows.
        equation: The equation.
        before: Mismatch before correction, in the equation's unit, shape (n,).
        after: Mismatch after correction, shape (n,).
        rng: Random generator for the bands.
        own: Coordinate that the catalogue states for the effect. Only this coordinate may be
            computed from the measured torque in the torque and breakaway equations.
    """
    block = stack.block[stack.part(equation.name)]
    weight, alone = weight_of(equation), mismatch_of(stack, equation.name)
    sense, known = at_rows(DIRECTION, equation, weight), equation.owner >= 0
    bench, amperes = equation.views[0].recording.bench, stack.equations[0].unit == "A"
    found = []
    for coordinate in equation.mapped:
        if not shows(coordinate, equation.views, coordinate.name == own):
            continue
        measured = equation.name in NOMINAL_IN and coordinate.name in FROM_TORQUE
        if measured and coordinate.name != own:
            continue
        values = at_rows(coordinate, equation, weight)
        unit = coordinate.unit if coordinate.periodic else ""
        unit = unit or unit_on(bench.motion, coordinate.unit, amperes)
        sets = functions_at_rows(coordinate, equation, values, alone.step, stack.cache)
        # Harmonics have the weights of the rows already.
        plain = np.ones(len(sense)) if coordinate.periodic else weight
        factors = [plain]
        if coordinate.by_load:
            factors.append(plain * at_rows(LOAD, equation, weight))
        share = max(alone.explained(sets, f[:: alone.step]) for f in factors)
        sided = max(
            [alone.explained(sets, (sense * f)[:: alone.step]) for f in factors]
            if coordinate.by_direction
            else [0.0]
        )
        sign = sense if sided > share else np.ones(len(sense))
        bins = TURN_BINS if coordinate.periodic and len(values) > TURN_ROWS else BINS
        x, first, last = (series[known] for series in (values, sign * before, sign * after))
        made = map_over(
            coordinate.name, unit, equation, x, first, last, block[known], stack.blocks, rng, bins
        )
        if made is not None:
            most, against = max(share, sided), sided > share
            made = replace(made, share=most, against_motion=against, periodic=coordinate.periodic)
            found.append(made)
    return tuple(sorted(found, key=lambda m: (-m.share, -m.mean_share)))


def location(equation: Equation, found: Map | None, before: Array) -> Location:
    """Return the location of the mismatch: ranges of the coordinate of a map, and recordings.

    If there are too few rows for a map, or no coordinate predicts anything, the location consists
    of the recordings alone.
    """
    power = {v.index: before[equation.owner == v.index] for v in equation.views}
    names = tuple(
        v.recording.name
        for v in equation.views
        if len(power[v.index])
        and float(np.mean(power[v.index] ** 2)) > RULES.recording * equation.sigma**2
    )
    if found is None or found.share == 0.0:
        return Location("recording", "1", (), 0.0, names)
    return Location(found.coordinate, found.unit, ranges(found), found.share, names)


def best_map(drawn: Sequence[Map], coordinate: str) -> Map | None:
    """Return the map over the coordinate that the catalogue states for an effect, if this map
    explains about as much as the best map; otherwise the best map.
    """
    own = next((m for m in drawn if m.coordinate == coordinate), None)
    best = drawn[0] if drawn else None
    return (
        own
        if own is not None and best is not None and own.share >= RULES.own_coordinate * best.share
        else best
    )


def ranges(found: Map) -> tuple[tuple[float, float], ...]:
    """Return a map's ranges whose band excludes zero; a periodic coordinate's whole turn."""
    outside = (found.low > 0.0) | (found.high < 0.0)
    if found.periodic:
        return ((0.0, 2.0 * np.pi),) if np.any(outside) else ()
    # Bins meet half way between their centres, which are unevenly spaced; beyond the first and the
    # last centre there may be no value at all, as for a direction of -1 or 1.
    centre = found.centre
    edges = [*centre[:1], *(0.5 * (centre[1:] + centre[:-1])), *centre[-1:]]
    stretches: list[tuple[float, float]] = []
    for k in np.flatnonzero(outside):
        low, high = float(edges[k]), float(edges[k + 1])
        if stretches and k > 0 and outside[k - 1]:
            stretches[-1] = (stretches[-1][0], high)
        else:
            stretches.append((low, high))
    return tuple(stretches)


def map_over(
    coordinate: str,
    unit: str,
    equation: Equation,
    values: Array,
    before: Array,
    after: Array,
    block: np.ndarray,
    blocks: int,
    rng: np.random.Generator,
    bins: int,
) -> Map | None:
    """Return the mismatch over one coordinate with simultaneous bands, or None if too coarse."""
    grid = edges(values, bins)
    if len(grid) < 3:
        levels = np.unique(values)
        if len(levels) < 2:
            return None
        grid = np.array([levels[0], 0.5 * (levels[0] + levels[1]), levels[1]])
    bins = len(grid) - 1
    place = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins).astype(np.float64)
    if np.any(count < LEAST_ROWS):
        return None
    mean = np.bincount(place, before, bins) / count
    centre = np.bincount(place, values, bins) / count
    rest = before - mean[place]
    sums = np.bincount(block * bins + place, rest, blocks * bins).reshape(blocks, bins) / count
    spread = np.sqrt(np.sum(sums**2, axis=0))
    spread[spread == 0.0] = 1e-300
    drawn = np.abs(rng.choice((-1.0, 1.0), size=(DRAWS, blocks)) @ sums) / spread
    wide = float(np.quantile(np.max(drawn, axis=1), CONFIDENCE)) * spread
    power = float(before @ before)
    chance = float(np.sum(count * spread**2))
    share = max(0.0, float(np.sum(count * mean**2)) - chance) / power if power > 0.0 else 0.0
    return Map(
        equation=equation.name,
        coordinate=coordinate,
        unit=unit,
        residual_unit=equation.unit,
        centre=centre,
        mean=mean,
        low=mean - wide,
        high=mean + wide,
        after=np.bincount(place, after, bins) / count,
        share=min(share, 1.0),
        mean_share=min(share, 1.0),
    )
