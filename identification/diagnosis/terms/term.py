"""Definition of an effect for the search: regressors at the full sample rate for given trial
parameters, and conversion of fitted values to the parameters of the catalogue.
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
"""Function of a view, nominal values and nonlinear parameters that returns the regressors of one
recording at the full sample rate, shape (k, m).
"""
NO_SHAPE: tuple[Shape, ...] = ((),)
EXACT, CLOSE, ROUGH = 1e-5, 1e-4, 1e-3
"""Classes of the error of a regressor: gain that other effects have because of this error, over the
gain of the effect itself.

The class of an effect was determined by simulation of 16 random benches. In the class ``EXACT``,
other effects had at most 1 to 13 millionths of the gain of the effect in its strongest draw, or
nothing above 1 % of the noise; in ``CLOSE`` up to 15 millionths, or more in one draw only; in
``ROUGH`` more.
"""


@dataclass(frozen=True)
class Context:
    """Data on which trial parameters may depend: the recordings under diagnosis and their nominal
    model.
    """

    views: tuple[View, ...]
    nominal: Nominal


Reader = Callable[[Array, Shape, Context], Mapping[str, float]]
"""Function of coefficients, nonlinear parameters and context that returns the parameters of the
catalogue.
"""


@dataclass(frozen=True)
class Term:
    """Computation of one effect.

    Attributes:
        name: Stable name of the catalogue.
        columns: Name of each equation in which the effect appears to its regressors.
        read: Function of coefficients, nonlinear parameters and context that returns the parameters
            of the catalogue.
        shapes: Trial values of the nonlinear parameters; empty if these recordings cannot show the
            effect.
        refine: Index of each continuous nonlinear parameter to the half width of its search around
            the trial value; 0 for a parameter that is searched within a factor.
        forms: Index of a nonlinear parameter that selects the form of the effect to the values of
            this parameter, the usual form first.
        positive: Indices of coefficients that must be positive to be physical.
        follows: Whether the regressors depend on the nominal values, and so change during a fit.
        varies: Names of the equations whose regressors change with the nominal values although the
            coefficients do not change.
        limits: Index of a nonlinear parameter to its least and greatest physical value.
        place: Index of the nonlinear parameter that is the number of the only recording with the
            effect; None for an effect that occurs in all recordings.
        start: Name of an equation to the regressor of an unknown state at the start of a recording;
            its coefficient is different in each recording, and is fitted also to recordings set
            aside.
        begin: Function from nominal values and trial parameters to the start values of a joint fit.
        shape_error: Class of the error of the regressor; :data:`EXACT` if the regressor is computed
            exactly from time, angle, motion or torque.
        at_angle: Whether the torque of the effect depends on the angle, which must then be delayed
            like the samples of the torque.
        size: Fixed coefficient of a regressor whose size is determined by nonlinear parameters;
            None otherwise.
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
    """Return a function that reads a single coefficient as the parameter ``name``."""
    return lambda coefficients, _shape, _context: {name: float(coefficients[0])}


def shaped(name: str, index: int = 0) -> Reader:
    """Return a function that reads a nonlinear parameter as the parameter ``name``, for effects
    whose size is determined by this nonlinear parameter.
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

    For a recording that is not fitted, all these regressors are zero.
    """
    out = np.zeros((count, *series.shape))
    if view.index < count:
        out[view.index] = series
    return out.reshape(-1, series.shape[1])
