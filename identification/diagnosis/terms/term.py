"""What the search needs of an effect: regressors at the full rate for trial shapes, and how to read
its parameters.
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
"""Regressors of one recording at the full rate, shape (k, m), at nominal values, for one shape."""
NO_SHAPE: tuple[Shape, ...] = ((),)
EXACT, CLOSE, ROUGH = 1e-5, 1e-4, 1e-3
"""Squares that a regressor's own error leaves to others over what it explains.

Beside the strongest of 16 draws others gained no more than 1 to 13 parts in a million of it, or
nothing above 1 % of the noise; up to 15, or in one draw alone; or more.
"""


@dataclass(frozen=True)
class Context:
    """What the trial shapes may depend on: the recordings under diagnosis and the nominal model of
    them.
    """

    views: tuple[View, ...]
    nominal: Nominal


Reader = Callable[[Array, Shape, Context], Mapping[str, float]]
"""(coefficients, shape, context) to the catalogue's parameters."""


@dataclass(frozen=True)
class Term:
    """How one effect is computed.

    Attributes:
        name: Stable name of the catalogue.
        columns: Equation to regressors; an equation that is not named is not touched.
        read: (coefficients, shape, context) to the catalogue's parameters.
        shapes: Trial shapes; empty where these recordings cannot show the effect.
        refine: Index of each continuous entry of the shape to how far it is sought about its trial;
            0 for entries that are scales, sought within a factor.
        positive: Indices of coefficients that must be positive to be physical.
        follows: Whether the regressors depend on the nominal values, so that they change as those
        are fitted.
        varies: Equations whose regressors change with the nominal values though no coefficient
        moves with these.
        limits: Index of a shape's entry to its least and greatest physical value.
        place: Index of the shape's entry that is the recording in which alone the effect shows, if
        there is one.
        begin: From nominal values and a trial shape to those that a joint fit begins from.
        shape_error: What the regressor's own error leaves to others, over what it explains;
            :data:`EXACT` where it is the physics itself, known from clock, angle, motion or torque.
        at_angle: Whether its torque is met at an angle: where the torque's samples are late, so is
        that angle.
        size: Coefficient the regressor is scaled to have, where its shape alone says how large it
            is (else None).
    """

    name: str
    columns: Mapping[str, Columns]
    read: Reader
    shapes: Callable[[Context], Sequence[Shape]] = lambda _context: NO_SHAPE
    refine: Mapping[int, float] = field(default_factory=dict)
    positive: tuple[int, ...] = ()
    size: float | None = None
    shape_error: float = ROUGH
    follows: bool = False
    at_angle: bool = False
    varies: tuple[str, ...] = ()
    limits: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    place: int | None = None
    begin: Callable[[Nominal, Shape], tuple[Nominal, Shape]] = lambda nominal, shape: (
        nominal,
        shape,
    )

    @property
    def freedom(self) -> int:
        """How many numbers the data choose, beside the coefficients."""
        return len(self.refine) - (self.size is not None)

    def physical(self, shape: Shape) -> bool:
        """Whether a shape is within its limits."""
        return all(low <= shape[k] <= high for k, (low, high) in self.limits.items())


def in_motion(columns: Columns) -> dict[str, Columns]:
    """Return an entry for effects that add to the drive's torque, in motion and at breakaway
    alike.
    """
    return {"torque": columns, "breakaway": columns}


def one(name: str) -> Reader:
    """Return a reader of a single coefficient."""
    return lambda coefficients, _shape, _context: {name: float(coefficients[0])}


def shaped(name: str, index: int = 0) -> Reader:
    """Return a reader of a shape's entry, for effects whose size is their shape."""
    return lambda _coefficients, shape, _context: {name: shape[index]}


def polar(sine: float, cosine: float) -> tuple[float, float]:
    """Return amplitude and phase of ``sine`` sin(x) + ``cosine`` cos(x) = amplitude sin(x +
    phase).
    """
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))


def everywhere(
    context: Context, needed: Callable[[View], bool], shapes: Sequence[Shape]
) -> Sequence[Shape]:
    """Return the shapes where at least one recording can show the effect, else none."""
    return shapes if any(needed(v) for v in context.views) else ()


def rows(*series: Array) -> Array:
    """Stack series of one recording, shape (k, m); a single one is not copied."""
    if len(series) == 1:
        return np.asarray(series[0], dtype=np.float64)[None]
    return np.stack([np.asarray(s, dtype=np.float64) for s in series])
