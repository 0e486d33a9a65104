"""Preprocessing of recordings for a diagnosis: marks of motion, signals at one bandwidth, and the
nominal model as a function of these signals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from identification.diagnosis.rules import RULES
from identification.estimate.equation_error import BLOCK_CORRELATION_TIMES
from identification.model.parameters import unit_on
from identification.numerics.compiled import compiled
from identification.numerics.spread import correlation_samples
from identification.recording import Array
from identification.signals import BoolArray, central_difference, noise, quantum, without_tones
from identification.views.nominal import (
    INSTANTS,
    Nominal,
    has_winding_voltage,
    voltage_change,
    winding_voltage,
)
from identification.views.view import View, lacks_common_origin, rise_rate, sharpness


def between_samples(views: Sequence[View]) -> float:
    """Return the error of the voltage equation, V, that voltages and currents between the samples
    may cause; 0 for averaged channels.

    A control loop that is faster than the log changes voltage and current between two samples. If
    log and loop are synchronised, every sample is taken at one phase of the loop's cycle, so that
    the error depends on the motion and no filter averages it. This error is not white noise, but
    the deviation of an instant within a sample period times the rate of change of the voltage, or
    of the voltage across the resistance.
    """
    voltages = [v.voltage for v in views if "voltage" not in v.recording.averaged]
    drops = [
        v.current * (v.recording.bench.resistance or 0.0)
        for v in views
        if v.current is not None and "current" not in v.recording.averaged
    ]
    return math.hypot(_instant(voltages), _instant(drops))


def _instant(channels: Sequence[Array | None]) -> float:
    """Return the rms error of samples in place of means over their periods."""
    changes = [np.diff(c[np.isfinite(c)]) for c in channels if c is not None]
    every = np.concatenate([np.zeros(1), *changes])
    return float(np.sqrt(np.mean(every**2) / 12.0))


LEAST_BREAKAWAYS = 12  # least number of breakaways, over all recordings, for a breakaway equation
SAME_STEP = 0.01  # relative difference up to which two steps of an encoder are equal
Places = NDArray[np.int64]
GREATEST_RATIO = 1e100
"""Greatest ratio of error to noise with a finite square; recordings at rest have no noise."""
ARC_SECOND_RAD = math.radians(1.0 / 3600.0)  # error of the most accurate encoders for one turn, rad
AT_INSTANTS = frozenset({"breakaway"})
"""Equations that hold at instants alone, with one row per instant; the other equations hold
throughout, and their rows are outputs of the filter. An equation at instants judges no model: it
has few rows, and their noise is large because an instant is known only to within one sample.
"""
EQUATIONS = ("torque", "breakaway", "transmission", "voltage")


@dataclass(frozen=True)
class Equation:
    """One equation over all recordings."""

    name: str  # one of `EQUATIONS`
    unit: str  # unit of the mismatch
    views: tuple[View, ...]
    # For each view, mask of the filter outputs (or breakaways) that are rows.
    kept: tuple[BoolArray, ...]
    residual: Array  # measured less nominal, shape (n,)
    tangent: Array  # derivatives with respect to the parameters of the equation, shape (n, k)
    # Names of the tangent's columns; those of the torque equation are nominal parameters.
    names: tuple[str, ...]
    owner: np.ndarray  # index of each row's recording, shape (n,)
    time: Array  # time stamp of each row, s, shape (n,)
    sigma: float  # noise of one row
    # Index of a recording to the mean square of the recording's own noise over the square of
    # `sigma`, at least 1. The noise of a recording may depend on its motion, for example if a
    # controller amplifies the rounding of an encoder.
    own: Mapping[int, float] = field(default_factory=dict)
    # Error that even the best sensors may cause, in `unit`; it repeats with the motion, so that the
    # noise does not contain it.
    accuracy: float = 0.0
    white: ClassVar[bool] = False
    """Whether the noise of the rows is white and known well, as that of a transducer."""
    firm: tuple[int, ...] = ()
    """Rows that are deviations of constants from their nominal values, in standard deviations."""

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Coordinates on which the mismatch may depend."""
        return COORDINATES

    @property
    def mapped(self) -> tuple[Coordinate, ...]:
        """Coordinates over which the mismatch is located."""
        return MAPPED

    @property
    def judges(self) -> bool:
        """Whether the equation judges models."""
        return self.name not in AT_INSTANTS

    def allowed(self) -> Array:
        """Return each row's mean square of noise and sensor error over ``sigma`` ^2, shape (n,)."""
        sensors = min(self.accuracy / self.sigma, GREATEST_RATIO) ** 2
        noises = np.array([self.own.get(index, 1.0) for index in self.owner.tolist()])
        return noises + sensors

    def rows(self, per_view: Callable[[View], Array]) -> Array:
        """Return full-rate series, shape (m,) or (k, m) per view, as rows, shape (n, k)."""
        return _stack(self.name, self.views, self._places, per_view)

    @cached_property
    def _places(self) -> tuple[Places, ...]:
        """Indices of the rows among the filter's outputs (or breakaways), for each view."""
        return tuple(map(np.flatnonzero, self.kept))


def equations(
    views: Sequence[View], nominal: Nominal, unit: str, before: Sequence[Equation] = ()
) -> tuple[Equation, ...]:
    """Return every equation for which these recordings have the channels, at the nominal values.

    Args:
        views: Recordings.
        nominal: Values of the nominal parameters.
        unit: Unit of the torque.
        before: The equations at other nominal values, whose noise is used. The rows of all
            equations except the torque equation are used too; the tangents of these equations
            account for the change of the nominal values.
    """
    if before:
        known = {e.name: e for e in before}
        torque = _torque(views, nominal, unit, known["torque"]) if "torque" in known else None
        kept = tuple(e for e in before if e.name != "torque")
        return kept if torque is None else (torque, *kept)
    found = (
        _torque(views, nominal, unit),
        _breakaway(views, nominal, unit),
        _transmission(views),
        _voltage(views),
    )
    return tuple(e for e in found if e is not None)


def _stack(
    name: str, views: Sequence[View], places: Sequence[Places], per_view: Callable[[View], Array]
) -> Array:
    parts = []
    for view, at in zip(views, places, strict=True):
        series = np.atleast_2d(per_view(view))
        if name in AT_INSTANTS:
            parts.append((series[:, view.breakaways] * sharpness(view))[:, at].T)
        else:
            parts.append(view.low_pass.chosen(series, at))
    return np.concatenate(parts)


def _build(
    name: str,
    unit: str,
    views: Sequence[View],
    kept: Sequence[BoolArray],
    measured: Callable[[View], Array],
    tangent: Callable[[View], Array],
    names: Sequence[str],
    before: Equation | None = None,
) -> Equation | None:
    places = [np.flatnonzero(k) for k in kept]
    residual = _stack(name, views, places, measured)[:, 0]
    if len(residual) < 2 * len(names) + 8:
        return None
    counts = [int(np.sum(k)) for k in kept]
    owner = np.repeat([v.index for v in views], counts)
    times = [
        (v.time[v.breakaways] if name in AT_INSTANTS else v.kept_times)[k]
        for v, k in zip(views, kept, strict=True)
    ]
    columns = _stack(name, views, places, tangent)
    when = np.concatenate(times)
    found = Equation(
        name, unit, tuple(views), tuple(kept), residual, columns, tuple(names), owner, when, 1.0
    )
    if before is not None:
        return replace(found, sigma=before.sigma, own=before.own, accuracy=before.accuracy)
    basis, _ = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))
    rest = residual - basis @ (basis.T @ residual)
    if name in AT_INSTANTS:
        scatter = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
        return replace(found, sigma=max(scatter, least_noise(found)))
    rest = without_tones(rest, owner, when)
    scatter = noise(rest, owner, views[0].low_pass)
    sigma = max(math.hypot(scatter, held_voltage(found)), least_noise(found))
    own = own_noise(found, rest / sigma)
    return replace(found, sigma=sigma, own=own, accuracy=_accuracy(found))


def own_noise(equation: Equation, rest: Array) -> dict[int, float]:
    """Return the mean square of each recording's own noise in whitened rows, at least 1."""
    low_pass, owner = equation.views[0].low_pass, equation.owner
    return {
        index: max(1.0, noise(rest[owner == index], owner[owner == index], low_pass) ** 2)
        for index in np.unique(owner).tolist()
    }


def _accuracy(equation: Equation) -> float:
    """Return the error of an equation, in its unit, that even the best sensors may cause."""
    if equation.name == "transmission":
        return ARC_SECOND_RAD
    read = [v.torque if equation.name == "torque" else v.voltage for v in equation.views]
    finite = [r[np.isfinite(r)] for r in read if r is not None]
    return RULES.accuracy * max((float(np.max(np.abs(r))) for r in finite if len(r)), default=0.0)


def held_voltage(equation: Equation) -> float:
    """Return the noise of the rows of the voltage equation, V, due to changes of the voltage
    between samples: a voltage that changes during a sample period is known only to within this
    change, unless the channel is declared as averaged. A constant delay of the voltage samples is a
    parameter (:data:`INSTANTS`).
    """
    if equation.name != "voltage":
        return 0.0
    return float(np.sqrt(np.mean(equation.rows(voltage_change) ** 2) / 12.0))


def least_noise(equation: Equation) -> float:
    """Return the least possible noise of an equation's rows: the rounding error of the samples."""
    least = 1e-9 * float(np.max(np.abs(equation.residual), initial=1e-300))
    if equation.name != "transmission":
        return least
    # In slow motion rounding errors are correlated, so that no filter averages them.
    motor = _count(equation.views, "motor_angle") / equation.views[0].recording.bench.gear_ratio
    return max(least, math.hypot(_count(equation.views, "angle"), motor) / math.sqrt(12.0))


def _count(views: Sequence[View], channel: str) -> float:
    """Return the step of an encoder, rad; if unknown, the smallest repeated step."""
    series = [v.recording.channels[channel] for v in views]
    known = max(quantum(values) for values in series)
    if known > 0.0:
        return known
    steps = np.sort(np.concatenate([np.abs(np.diff(values)) for values in series]))
    steps = steps[steps > 0.0]
    # The steps of a quantised angle repeat, the steps of a continuous angle do not.
    repeats = len(steps) > 1 and steps[1] < (1.0 + SAME_STEP) * steps[0]
    return float(steps[0]) if repeats else 0.0


def _torque(
    views: Sequence[View], nominal: Nominal, unit: str, before: Equation | None = None
) -> Equation | None:
    # With a flexible transmission the rotor, whose share of the inertia is unknown, moves
    # differently from the valve.
    gives = any(np.any(v.twist) for v in views)

    def tangent(view: View) -> Array:
        return (
            np.concatenate([nominal.tangent(view), view.twist[None]])
            if gives
            else nominal.tangent(view)
        )

    return _build(
        "torque",
        unit,
        views,
        [v.moving for v in views],
        lambda v: np.asarray(v.torque - nominal.torque(v)),
        tangent,
        (*nominal.free, *(("rotor",) if gives else ())),
        before,
    )


def _breakaway(views: Sequence[View], nominal: Nominal, unit: str) -> Equation | None:
    if sum(len(v.breakaways) for v in views) < LEAST_BREAKAWAYS:
        return None
    loaded = any(v.loaded for v in views)

    def limit(view: View) -> Array:
        # The torque is that of the last sample at rest by the encoder; its error is proportional to
        # the rate of rise of the torque.
        last = np.roll(view.raw_torque, 1)
        return np.asarray(
            last - view.sense * (nominal.get("Ms") + view.moment * nominal.get("mu_s"))
        )

    def tangent(view: View) -> Array:
        return np.stack(
            [view.sense, rise_rate(view), *([view.moment * view.sense] if loaded else [])]
        )

    names = ("Ms", "rate", *(["mu_s"] if loaded else []))
    return _build(
        "breakaway",
        unit,
        views,
        [np.ones(len(v.breakaways), bool) for v in views],
        limit,
        tangent,
        names,
    )


def _transmission(views: Sequence[View]) -> Equation | None:
    both = [v for v in views if v.lag is not None]
    if not both:
        return None

    def measured(view: View) -> Array:
        assert view.lag is not None
        return view.lag - np.median(view.lag)

    def tangent(view: View) -> Array:
        place = np.zeros((len(both), len(view.time)))
        place[[v.index for v in both].index(view.index)] = 1.0
        return place

    kept = [np.ones(len(v.kept_times), bool) for v in both]
    names = [f"zero of {v.recording.name}" for v in both]
    unit = unit_on(both[0].recording.bench.motion, "rad")
    return _build("transmission", unit, both, kept, measured, tangent, names)


def _voltage(views: Sequence[View]) -> Equation | None:
    known = [v for v in views if has_winding_voltage(v)]
    if not known:
        return None

    def measured(view: View) -> Array:
        assert view.voltage is not None
        return np.where(np.isnan(view.voltage), 0.0, view.voltage) - winding_voltage(view)

    unsure = {name: make for name, make in INSTANTS.items() if any(np.any(make(v)) for v in known)}

    def tangent(view: View) -> Array:
        assert view.current is not None
        return np.stack([view.current, view.motor_speed, *(make(view) for make in unsure.values())])

    kept = [v.low_pass.untouched(np.isnan(v.voltage)) for v in known if v.voltage is not None]
    names = ("R", "Ke", *unsure)
    return _build("voltage", "V", known, kept, measured, tangent, names)


LEAST_BLOCK_S = 1.0
GREATEST_BLOCK_S = 3.0
"""Greatest length of a block, s. The mismatch is correlated over whole half cycles, but with longer
blocks the number of blocks would be too small.
"""


def gather_of(
    equations: Sequence[Equation], block: np.ndarray, blocks: int
) -> tuple[sparse.csr_matrix, ...]:
    """Return for each equation the matrix that sums the rows of each block, shape (blocks, n_e)."""
    out, start = [], 0
    for equation in equations:
        count = len(equation.residual)
        mine = block[start : start + count]
        out.append(
            sparse.csr_matrix((np.ones(count), (mine, np.arange(count))), shape=(blocks, count))
        )
        start += count
    return tuple(out)


@compiled
def in_blocks(
    columns: Array, residual: Array, block: np.ndarray, blocks: int
) -> tuple[Array, Array]:
    """Return for each block the inner products of columns, shape (n, k), with the residual and with
    each other.

    Returns:
        Shapes (b, k) and (b, k, k).
    """
    rows, width = columns.shape
    sums, weights = np.zeros((blocks, width)), np.zeros((blocks, width, width))
    for i in range(rows):
        at = block[i]
        for j in range(width):
            value = columns[i, j]
            sums[at, j] += value * residual[i]
            for k in range(j + 1):
                weights[at, j, k] += value * columns[i, k]
    for at in range(blocks):
        for j in range(width):
            for k in range(j):
                weights[at, k, j] = weights[at, j, k]
    return sums, weights


def numbered(equations: Sequence[Equation], residuals: Sequence[Array]) -> tuple[np.ndarray, int]:
    """Return the block number of each row and the number of blocks. A block has ten correlation
    times of the most correlated residual, within limits, and is the same for all equations.
    """
    length = LEAST_BLOCK_S
    for equation, residual in zip(equations, residuals, strict=True):
        if not equation.judges:
            continue
        for view in equation.views:
            mine = residual[equation.owner == view.index]
            step = view.step * view.low_pass.factor
            if len(mine) > 8:
                length = max(length, BLOCK_CORRELATION_TIMES * correlation_samples(mine) * step)
    views = {v.index: v for e in equations for v in e.views}
    priors = any(np.any(e.owner < 0) for e in equations)
    longest = max(float(v.time[-1] - v.time[0]) for v in views.values())
    length = min(length, GREATEST_BLOCK_S, max(LEAST_BLOCK_S, longest / 4.0))
    first: dict[int, int] = {}
    count = 0
    for index in sorted(views):
        first[index] = count
        count += max(1, round(float(views[index].time[-1] - views[index].time[0]) / length))
    parts = []
    for equation in equations:
        for_rows = np.full(len(equation.residual), count, dtype=np.int64)
        for view in equation.views:
            mine = equation.owner == view.index
            span = float(view.time[-1] - view.time[0])
            number = max(1, round(span / length))
            place = (equation.time[mine] - view.time[0]) / span * number
            for_rows[mine] = first[view.index] + np.clip(place.astype(np.int64), 0, number - 1)
        parts.append(for_rows)
    return np.concatenate(parts), count + priors


BINS = 8
LEAST_ROWS = 5  # least number of rows in which a function of a coordinate must be nonzero
COARSE = (2, 4, 8)
"""Numbers of intervals between quantiles of the coarse piecewise-linear functions."""
DIGITS = 9  # decimal digits of a coordinate, relative to its greatest value
HARMONICS = 48  # greatest number of periods per turn by which a periodic mismatch is located
LEAST_TURNS = 2.0
"""Turns of a recording from which a periodic coordinate differs from the angle itself."""
_ENDS = 2.0 ** -np.arange(5.0, 9.0)
KNOTS = np.concatenate([np.arange(17) / 16.0, _ENDS, 1.0 - _ENDS])
"""Probabilities of the quantiles between which functions of a coordinate are linear; closer
together at both ends, since most effects grow towards an end.
"""


@dataclass(frozen=True)
class Coordinate:
    """A coordinate on which the mismatch may depend."""

    name: str  # name in the report
    unit: str  # displayed unit of its values
    # Function from a view to values at the full rate, shape (m,), or None if the recording lacks
    # them.
    values: Callable[[View], Array | None]
    by_direction: bool = True  # whether the two directions of motion have separate bins
    by_load: bool = False  # whether the mismatch may be proportional to the load as well
    periodic: bool = False  # whether the coordinate is an angle of which full turns are equal
    bins: int = BINS  # number of bins of a generic family


def _load(view: View) -> Array:
    """Return the force of the load at the lever and of loads that turn with the joint, N."""
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
    """Return the edges of about ``bins`` equally filled bins, shape (b + 1,)."""
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, bins + 1)))


def weight_of(equation: Equation) -> Array:
    """Return the weights of the rows of an equation, shape (n,): one, except for breakaways."""
    return equation.rows(lambda v: np.ones(len(v.time)))[:, 0]


def at_rows(coordinate: Coordinate, equation: Equation, weight: Array) -> Array:
    """Return the filtered coordinate at an equation's rows, shape (n,); 0 without its channel."""
    if coordinate.periodic:
        first = equation.rows(partial(_harmonic, coordinate, 1))
        return np.asarray(np.arctan2(first[:, 0], first[:, 1]) % (2.0 * np.pi))
    values = equation.rows(partial(_values, coordinate))[:, 0] / np.where(weight > 0.0, weight, 1.0)
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
    for coordinate in equation.coordinates:
        if any(coordinate.values(v) is None for v in equation.views):
            continue
        values = equation.rows(partial(_values, coordinate))[:, 0]
        grid = edges(values[equation.owner >= 0], coordinate.bins)
        if len(grid) < 3:
            continue
        place = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
        columns = (place[:, None] == np.arange(len(grid) - 1)).astype(np.float64)
        columns[equation.owner < 0] = 0.0
        if coordinate.by_direction:
            columns = np.concatenate(
                [columns * (sense[:, None] > 0.0), columns * (sense[:, None] <= 0.0)], axis=1
            )
        yield coordinate.name, columns[:, np.any(columns != 0.0, axis=0)]


def _values(coordinate: Coordinate, view: View) -> Array:
    values = coordinate.values(view)
    return np.zeros(len(view.time)) if values is None else values
