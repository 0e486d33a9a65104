"""Computes generic families of regressors, which detect and locate a mismatch that no effect of the
catalogue explains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from identification.diagnosis.rows.equations import Equation
from identification.diagnosis.rows.view import View
from identification.recording import Array

BINS = 8


@dataclass(frozen=True)
class Coordinate:
    """A coordinate on which the mismatch may depend.

    Attributes:
        name: Name in the report.
        unit: Displayed unit of its values.
        values: Function from a view to values at the full rate, shape (m,), or None if the
            recording lacks them.
        by_direction: Whether the two directions of motion have separate bins.
    """

    name: str
    unit: str
    values: Callable[[View], Array | None]
    by_direction: bool = True


COORDINATES = (
    Coordinate("speed", "rad/s", lambda v: v.velocity, by_direction=False),
    Coordinate("angle", "rad", lambda v: v.angle),
    Coordinate("load", "N", lambda v: v.moment / (v.recording.bench.moment_arm or 1.0)),
    Coordinate("direction", "1", lambda v: v.sense, by_direction=False),
    Coordinate("time", "s", lambda v: v.run_time),
    Coordinate("temperature", "deg C", lambda v: v.temperature),
    Coordinate("time since reversal", "s", lambda v: v.reversal_time),
    Coordinate("travel since reversal", "rad", lambda v: v.reversal_travel),
    Coordinate("rest time", "s", lambda v: v.rest_time),
    Coordinate("acceleration", "rad/s^2", lambda v: v.acceleration, by_direction=False),
    Coordinate("torque", "N m", lambda v: v.torque, by_direction=False),
)


def edges(values: Array, bins: int = BINS) -> Array:
    """Return the edges of ``bins`` bins with about equal numbers of samples, shape (b + 1,); fewer
    bins if values repeat.
    """
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, bins + 1)))


def families(equation: Equation) -> Iterator[tuple[str, Array]]:
    """Yield (name, regressors, shape (n, k)) for every coordinate; a regressor is 1 in the rows of
    one bin and direction, else 0.

    The bin of a row follows from the filtered coordinate, because generic families do not need
    sharp edges.
    """
    sense = equation.rows(lambda v: v.sense)[:, 0]
    for coordinate in COORDINATES:
        if any(coordinate.values(v) is None for v in equation.views):
            continue
        values = equation.rows(partial(_values, coordinate))[:, 0]
        grid = edges(values)
        if len(grid) < 3:
            continue
        place = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
        columns = (place[:, None] == np.arange(len(grid) - 1)).astype(np.float64)
        if coordinate.by_direction:
            columns = np.concatenate(
                [columns * (sense[:, None] > 0.0), columns * (sense[:, None] <= 0.0)], axis=1
            )
        yield coordinate.name, columns[:, np.any(columns != 0.0, axis=0)]


def _values(coordinate: Coordinate, view: View) -> Array:
    values = coordinate.values(view)
    return np.zeros(len(view.time)) if values is None else values
