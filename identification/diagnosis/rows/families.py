"""Computes generic families of regressors, which detect and locate a mismatch that no effect of the
catalogue explains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from identification.diagnosis.rows.equations import Equation
from identification.recording import Array
from identification.signals import central_difference
from identification.views.view import View, lacks_common_origin

BINS = 8
LEAST_ROWS = 5
"""Least number of rows in which a function of a coordinate must be nonzero."""
COARSE = (2, 4, 8)
"""Numbers of intervals between quantiles of the coarse piecewise-linear functions."""
DIGITS = 9
"""Decimal digits of a coordinate, relative to its greatest value."""
HARMONICS = 48
"""Greatest number of periods per turn by which a periodic mismatch is located."""
LEAST_TURNS = 2.0
"""Turns of a recording from which a periodic coordinate differs from the angle itself."""
_ENDS = 2.0 ** -np.arange(5.0, 9.0)
KNOTS = np.concatenate([np.arange(17) / 16.0, _ENDS, 1.0 - _ENDS])
"""Probabilities of the quantiles between which functions of a coordinate are linear; closer
together at both ends, since most effects grow towards an end.
"""


@dataclass(frozen=True)
class Coordinate:
    """A coordinate on which the mismatch may depend.

    Attributes:
        name: Name in the report.
        unit: Displayed unit of its values.
        values: Function from a view to values at the full rate, shape (m,), or None if the
            recording lacks them.
        by_direction: Whether the two directions of motion have separate bins.
        by_load: Whether the mismatch may be proportional to the load as well.
        periodic: Whether the coordinate is an angle of which full turns are equal.
    """

    name: str
    unit: str
    values: Callable[[View], Array | None]
    by_direction: bool = True
    by_load: bool = False
    periodic: bool = False


def _load(view: View) -> Array:
    """Return the force of the load at the lever, with that of declared loads that turn with the
    joint, N, shape (m,).
    """
    arm = view.recording.bench.moment_arm or 1.0
    return np.asarray((view.moment + np.abs(view.hanging)) / arm)


LOAD = Coordinate("load", "N", _load)
DIRECTION = Coordinate("direction", "1", lambda v: v.sense, by_direction=False)
COORDINATES = (
    Coordinate("speed", "rad/s", lambda v: v.velocity, by_direction=False),
    Coordinate("angle", "rad", lambda v: v.angle, by_load=True),
    LOAD,
    DIRECTION,
    Coordinate("time", "s", lambda v: v.run_time),
    Coordinate("temperature", "deg C", lambda v: v.temperature),
    Coordinate("time since reversal", "s", lambda v: v.reversal_time),
    Coordinate("travel since reversal", "rad", lambda v: v.reversal_travel),
    Coordinate("rest time", "s", lambda v: v.rest_time),
    Coordinate(
        "acceleration", "rad/s^2", lambda v: v.acceleration, by_direction=False, by_load=True
    ),
    Coordinate("torque", "N m", lambda v: v.transmitted, by_direction=False),
)
MAPPED = (
    *COORDINATES,
    Coordinate("motor angle", "rad", lambda v: v.motor, periodic=True),
    Coordinate(
        "torque rate",
        "N m/s",
        lambda v: central_difference(v.transmitted, v.step),
        by_direction=False,
    ),
    Coordinate(
        "current direction",
        "1",
        lambda v: None if v.current is None else np.sign(v.current),
        by_direction=False,
    ),
)
"""Coordinates over which a mismatch is located."""
FROM_TORQUE = ("torque", "torque rate", "current direction")
"""Coordinates that are computed from the measured torque: they contain a mismatch of the torque and
the breakaway equation, so that they seem to explain any such mismatch.
"""


def edges(values: Array, bins: int = BINS) -> Array:
    """Return the edges of ``bins`` bins with about equal numbers of samples, shape (b + 1,); fewer
    bins if values repeat.
    """
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, bins + 1)))


def weight_of(equation: Equation) -> Array:
    """Return the weights of the rows of an equation, shape (n,): one, except for breakaways."""
    return equation.rows(lambda v: np.ones(len(v.time)))[:, 0]


def at_rows(coordinate: Coordinate, equation: Equation, weight: Array) -> Array:
    """Return the filtered coordinate at the rows of an equation, shape (n,); zero where a recording
    lacks its channel.

    Args:
        coordinate: The coordinate.
        equation: The equation.
        weight: Weights of the rows, from :func:`weight_of`, shape (n,).
    """
    if coordinate.periodic:
        first = equation.rows(partial(_harmonic, coordinate, 1))
        return np.asarray(np.arctan2(first[:, 0], first[:, 1]) % (2.0 * np.pi))
    values = equation.rows(partial(_values, coordinate))[:, 0] / weight
    # Filtered constants differ by rounding.
    scale = float(np.max(np.abs(values), initial=0.0))
    return np.asarray(scale * np.round(values / scale, DIGITS)) if scale > 0.0 else values


def shows(coordinate: Coordinate, views: Sequence[View], stated: bool = False) -> bool:
    """Whether the recordings have the channel of a coordinate; a periodic coordinate also needs a
    common origin and, unless it is the ``stated`` coordinate of an effect, full turns.
    """
    values = [coordinate.values(v) for v in views]
    if any(v is None for v in values):
        return False
    turns = max(float(np.ptp(v)) for v in values if v is not None) / (2.0 * np.pi)
    if not coordinate.periodic:
        return True
    return (stated or turns >= LEAST_TURNS) and not lacks_common_origin(views)


def functions_at_rows(
    coordinate: Coordinate,
    equation: Equation,
    values: Array,
    step: int,
    cache: dict[tuple[str, tuple[float, ...]], dict[str, Array]],
) -> list[Array]:
    """Return sets of functions of a coordinate at the rows of an equation, from few functions to
    many, shape (n, k) each: harmonics of a periodic coordinate up to :data:`HARMONICS`, filtered
    and weighted like the rows; otherwise :func:`functions`.

    Args:
        coordinate: The coordinate.
        equation: The equation.
        values: The coordinate at all rows, from :func:`at_rows`.
        step: Distance of the rows that are used.
        cache: Cache of the stack; it keeps the harmonics.
    """
    if not coordinate.periodic:
        return functions(values[::step])
    kept = cache.setdefault((coordinate.name, ()), {})
    if equation.name not in kept:
        # One at a time: a long recording at the full rate is large.
        numbers = range(1, HARMONICS + 1)
        made = [equation.rows(partial(_harmonic, coordinate, n))[::step] for n in numbers]
        kept[equation.name] = np.concatenate(made, axis=1)
    return [kept[equation.name][:, : 2 * most] for most in (HARMONICS // 4, HARMONICS)]


def _harmonic(coordinate: Coordinate, number: int, view: View) -> Array:
    turns = number * _values(coordinate, view)
    return np.stack([np.sin(turns), np.cos(turns)])


def functions(values: Array) -> list[Array]:
    """Return sets of functions of a coordinate, from few functions to many, shape (n, k) each:
    piecewise-linear functions between few quantiles; then steps between bins and piecewise-linear
    functions between many quantiles. A constant coordinate has no functions.
    """
    levels = np.unique(values)
    if len(levels) < 2:
        return []
    grid = edges(values, 2 * BINS)
    if len(levels) == 2 or len(grid) < 3:
        return [_used((values[:, None] > np.mean(levels[[0, -1]])) == np.array([False, True]))]
    place = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
    steps = place[:, None] == np.arange(len(grid) - 1)
    coarse = [_piecewise_linear(values, np.linspace(0.0, 1.0, k + 1)) for k in COARSE]
    return [*coarse, _used(np.concatenate([steps, _piecewise_linear(values, KNOTS)], axis=1))]


def _piecewise_linear(values: Array, probabilities: Array) -> Array:
    knots = np.unique(np.quantile(values, probabilities))
    return _used(np.stack([np.interp(values, knots, unit) for unit in np.eye(len(knots))], axis=1))


def _used(columns: np.ndarray) -> Array:
    used = np.count_nonzero(columns, axis=0) >= LEAST_ROWS
    return np.asarray(columns[:, used], dtype=np.float64)


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
