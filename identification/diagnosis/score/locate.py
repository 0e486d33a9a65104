"""Locates the mismatch: computes its mean in bins of each coordinate, with simultaneous bands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnosis.fit.stack import NOMINAL_IN, Stack
from identification.diagnosis.result import Curve, Location, Map
from identification.diagnosis.rows.equations import Equation
from identification.diagnosis.rows.families import (
    DIRECTION,
    FROM_TORQUE,
    LEAST_ROWS,
    LOAD,
    MAPPED,
    at_rows,
    edges,
    functions_at_rows,
    shows,
    weight_of,
)
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.beside import mismatch_of
from identification.model.parameters import unit_on
from identification.numerics.spread import CONFIDENCE
from identification.recording import Array

BINS = 16
TURN_BINS, TURN_ROWS = 64, 1000
"""Bins over a turn, which show waves, and the number of rows from which they are used."""
DRAWS = 499


@dataclass(frozen=True)
class Axis:
    """A coordinate with its values at the rows of an equation.

    Attributes:
        name: Name of the coordinate.
        unit: Unit of its values.
        values: Value at each row, shape (n,).
    """

    name: str
    unit: str
    values: Array


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
    sense, load = (at_rows(c, equation, weight) for c in (DIRECTION, LOAD))
    bench, amperes = equation.views[0].recording.bench, stack.equations[0].unit == "A"
    found = []
    for coordinate in MAPPED:
        if not shows(coordinate, equation.views, coordinate.name == own):
            continue
        measured = equation.name in NOMINAL_IN and coordinate.name in FROM_TORQUE
        if measured and coordinate.name != own:
            continue
        values = at_rows(coordinate, equation, weight)
        unit = coordinate.unit if coordinate.periodic else ""
        axis = Axis(
            coordinate.name, unit or unit_on(bench.motion, coordinate.unit, amperes), values
        )
        sets = functions_at_rows(coordinate, equation, values, alone.step, stack.cache)
        # Harmonics have the weights of the rows already.
        plain = np.ones(len(sense)) if coordinate.periodic else weight
        factors = [plain] + [plain * load] * coordinate.by_load
        share = max(alone.explained(sets, f[:: alone.step]) for f in factors)
        sided = max(
            [alone.explained(sets, (sense * f)[:: alone.step]) for f in factors]
            if coordinate.by_direction
            else [0.0]
        )
        sign = sense if sided > share else np.ones(len(sense))
        bins = TURN_BINS if coordinate.periodic and len(values) > TURN_ROWS else BINS
        made = map_over(equation, axis, sign * before, sign * after, block, stack.blocks, rng, bins)
        if made is not None:
            found.append(
                replace(
                    made,
                    share=max(share, sided),
                    against_motion=sided > share,
                    periodic=coordinate.periodic,
                )
            )
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
    """Return the ranges of the coordinate of a map in which the band excludes zero; of a periodic
    coordinate, the whole turn.
    """
    outside = (found.low > 0.0) | (found.high < 0.0)
    if found.periodic:
        return ((0.0, 2.0 * np.pi),) if np.any(outside) else ()
    half = 0.5 * np.gradient(found.centre) if len(found.centre) > 1 else np.zeros(1)
    stretches: list[tuple[float, float]] = []
    for k in np.flatnonzero(outside):
        low, high = float(found.centre[k] - half[k]), float(found.centre[k] + half[k])
        if stretches and k > 0 and outside[k - 1]:
            stretches[-1] = (stretches[-1][0], high)
        else:
            stretches.append((low, high))
    return tuple(stretches)


def curve(drawn: Sequence[Map]) -> Curve | None:
    """Return the mean of a map as an empirical curve of the mismatch: of the location's map, if its
    mean explains about as much as the mean of any map; otherwise of the map whose mean explains
    most.

    The mean of the location's map may explain little, if the nominal parameters compensate a part
    of the missing torque, or if this torque is proportional to the load.
    """
    if not drawn:
        return None
    found = max(drawn, key=lambda m: m.mean_share)
    if drawn[0].mean_share >= RULES.own_coordinate * found.mean_share:
        found = drawn[0]
    return Curve(
        found.equation,
        found.coordinate,
        found.unit,
        found.residual_unit,
        found.centre,
        found.mean,
        found.against_motion,
    )


def map_over(
    equation: Equation,
    axis: Axis,
    before: Array,
    after: Array,
    block: np.ndarray,
    blocks: int,
    rng: np.random.Generator,
    bins: int = BINS,
) -> Map | None:
    """Return the map of the mismatch over one coordinate with simultaneous bands, or None if the
    coordinate has too few values.

    Args:
        equation: The equation.
        axis: The coordinate.
        before: Mismatch before correction, shape (n,).
        after: Mismatch after correction, shape (n,).
        block: Block of each row, shape (n,).
        blocks: Number of blocks.
        rng: Random generator for the bands.
        bins: Number of bins.
    """
    values = axis.values
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
        coordinate=axis.name,
        unit=axis.unit,
        residual_unit=equation.unit,
        centre=centre,
        mean=mean,
        low=mean - wide,
        high=mean + wide,
        after=np.bincount(place, after, bins) / count,
        share=min(share, 1.0),
        mean_share=min(share, 1.0),
    )
