"""Definition of an effect for the search: regressors at the full rate at trial parameters, and
conversion of fitted values to the effect's parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View
from identification.recording import Array

Shape = tuple[float, ...]
"""Values of an effect's nonlinear parameters."""
Columns = Callable[[View, Nominal, Shape], Array]
"""Regressors of one recording at the full rate, shape (k, m), at nominal values and nonlinear
parameters.
"""
NO_SHAPE: tuple[Shape, ...] = ((),)
EXACT, CLOSE, ROUGH = 1e-5, 1e-4, 1e-3
"""Shape error of a regressor: squares that its error leaves to other effects, over the squares that
it explains.

The classes are from 16 draws of each effect. In the first, other effects then explained at most 1
to 13 millionths of the strongest draw's squares, or nothing above 1 % of the noise; in the second
up to 15, or more in one draw only; in the third more.
"""


@dataclass(frozen=True)
class Context:
    """Data on which trial parameters may depend: the recordings under diagnosis and their nominal
    model.
    """

    views: tuple[View, ...]
    nominal: Nominal


Reader = Callable[[Array, Shape, Context], Mapping[str, float]]
"""(coefficients, shape, context) to the catalogue's parameters."""


@dataclass(frozen=True)
class Term:
    """Computation of one effect.

    Attributes:
        name: Stable name of the catalogue.
        columns: Equation to regressors; the effect does not appear in other equations.
        read: (coefficients, nonlinear parameters, context) to the catalogue's parameters.
        shapes: Trial values of the nonlinear parameters; empty if these recordings cannot show the
            effect.
        refine: Index of each continuous nonlinear parameter to its search range around the trial; 0
            for scales, which are searched within a factor.
        forms: Index of a nonlinear parameter that selects the form of the effect, to its values,
            the usual form first.
        positive: Indices of coefficients that must be positive to be physical.
        follows: Whether the regressors depend on the nominal values, so that they change during a
            fit.
        varies: Equations whose regressors change with the nominal values while the coefficients do
            not.
        limits: Index of a nonlinear parameter to its least and greatest physical value.
        place: Index of the nonlinear parameter that is the only recording with the effect, if there
            is one.
        start: Equation to the regressor of an unknown state at the start of a recording, whose
            coefficient each recording has to itself; fitted where a recording set aside is
            predicted.
        begin: Function from nominal values and trial parameters to the start values of a joint fit.
        shape_error: Squares that the regressor's error leaves to others, over the squares that it
            explains; :data:`EXACT` if the regressor is exact, known from clock, angle, motion or
            torque.
        at_angle: Whether its torque depends on angle, which must then be delayed like the torque's
            samples.
        size: Fixed coefficient of a regressor whose nonlinear parameters determine its size; else
            None.
    """

    name: str
    columns: Mapping[str, Columns]
    read: Reader
    shapes: Callable[[Context], Sequence[Shape]] = lambda _context: NO_SHAPE
    refine: Mapping[int, float] = field(default_factory=dict)
    forms: Mapping[int, tuple[float, ...]] = field(default_factory=dict)
    positive: tuple[int, ...] = ()
    size: float | None = None
    shape_error: float = ROUGH
    follows: bool = False
    at_angle: bool = False
    varies: tuple[str, ...] = ()
    limits: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    place: int | None = None
    start: Mapping[str, Columns] = field(default_factory=dict)
    begin: Callable[[Nominal, Shape], tuple[Nominal, Shape]] = lambda nominal, shape: (
        nominal,
        shape,
    )

    @property
    def freedom(self) -> int:
        """Number of parameters fitted in addition to the coefficients."""
        return len(self.refine) - (self.size is not None)

    def physical(self, shape: Shape) -> bool:
        """Whether nonlinear parameters are within their limits."""
        return all(low <= shape[k] <= high for k, (low, high) in self.limits.items())


def in_motion(columns: Columns) -> dict[str, Columns]:
    """Return the columns of an effect that adds to the drive's torque, both in motion and at
    breakaway.
    """
    return {"torque": columns, "breakaway": columns}


def one(name: str) -> Reader:
    """Return a reader of a single coefficient."""
    return lambda coefficients, _shape, _context: {name: float(coefficients[0])}


def shaped(name: str, index: int = 0) -> Reader:
    """Return a function that reads a nonlinear parameter, for effects whose size this parameter
    determines.
    """
    return lambda _coefficients, shape, _context: {name: shape[index]}


def polar(sine: float, cosine: float) -> tuple[float, float]:
    """Return amplitude and phase of ``sine`` sin(x) + ``cosine`` cos(x) = amplitude sin(x +
    phase).
    """
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))


def everywhere(
    context: Context, needed: Callable[[View], bool], shapes: Sequence[Shape]
) -> Sequence[Shape]:
    """Return the trial parameters if at least one recording can show the effect, else an empty
    list.
    """
    return shapes if any(needed(v) for v in context.views) else ()


def rows(*series: Array) -> Array:
    """Stack series of one recording, shape (k, m); a single series is not copied."""
    if len(series) == 1:
        return np.asarray(series[0], dtype=np.float64)[None]
    return np.stack([np.asarray(s, dtype=np.float64) for s in series])


def of_each_recording(view: View, count: int, series: Array) -> Array:
    """Return regressors with separate coefficients for each of ``count`` recordings, shape (count
    k, m), from the regressors of one recording, shape (k, m).

    A recording that is not fitted has none.
    """
    out = np.zeros((count, *series.shape))
    if view.index < count:
        out[view.index] = series
    return out.reshape(-1, series.shape[1])
