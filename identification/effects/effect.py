"""Definition of an effect: words, parameters with dimensions and ranges, the equations that it
enters, its response, and all that the search, the corrected model and the reports need to know of
it.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, Self

import numpy as np

from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import View

Shape = tuple[float, ...]
"""Values of an effect's nonlinear parameters."""
Coefficients = tuple[float, ...]
"""Coefficients of an effect's regressors."""
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
NEARLY_NONE = 1e-9
"""Factor on the coefficients of an effect with which the effect is practically absent."""
WORDS = frozenset({"equation", "implied", "assumption", "coordinate", "experiment", "sentence"})
_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


class Dimension(Enum):
    """Dimension of a parameter, with its unit on a rotary bench. Plausible ranges scale with the
    machine by dimension.
    """

    NUMBER = "number", ""
    CYCLES = "cycles", "1/turn"
    TIME = "time", "s"
    FREQUENCY = "frequency", "Hz"
    PHASE = "phase", "rad"
    ANGLE = "angle", "rad"
    SLOPE = "slope", "1/rad"
    TORQUE = "torque", "N m"
    TORQUE_RATE = "torque rate", "N m/s"
    STIFFNESS = "stiffness", "N m/rad"
    VISCOSITY = "viscosity", "N m s/rad"
    DRAG = "drag", "N m s^2/rad^2"
    STRAY = "stray drag", "N m s/(A^2 rad)"
    INERTIA = "inertia", "kg m^2"
    MASS = "mass", "kg"
    CURRENT = "current", "A"
    CURRENT_RATE = "current rate", "A/s"
    VOLTAGE = "voltage", "V"
    RESISTANCE = "resistance", "ohm"
    THERMAL_RESISTANCE = "thermal resistance", "K/W"
    LAYER_RATE = "layer rate", "m/s"
    TAPER = "taper", "1/m"
    EROSION = "erosion", "s/m"
    HEAT_FLOW = "heat flow", "W"
    AREA = "area", "m^2"

    @property
    def unit(self) -> str:
        """SI unit on a rotary bench."""
        return str(self.value[1])


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect, with its dimension and its plausible range on the practical bench.

    The dimension of a parameter of an effect of one's own is its unit, and its range is that on the
    bench of the recordings.
    """

    name: str
    dimension: Dimension | str
    low: float
    high: float

    @property
    def unit(self) -> str:
        """SI unit on a rotary bench."""
        return self.dimension if isinstance(self.dimension, str) else self.dimension.unit


class Needs(Enum):
    """What recordings and bench must have to show an effect."""

    COMMON_ZERO = "angles of all recordings from one origin"
    JOINT_TURN = "a joint that turns"
    MOTOR_TURN = "a motor that turns"


class Separation(Enum):
    """Kind of experiment, of one machine and one sequence, that distinguishes an effect from
    similar effects.
    """

    LOADS = "two weights and none"
    LOADS_AND_SPEEDS = "two loads at two speeds"
    FREQUENCIES = "fast sines without load, slow ones under load"
    SPEEDS = "steady speeds in rising and falling order"
    SLOW = "slow sines around the Stribeck speed"
    RESTS = "rests of several durations"
    SMALL_LOOPS = "loops below breakaway after rests"
    TRAVEL = "the whole travel with and without load"
    SESSION = "cold, warm and rested at two speeds"
    HOLD = "holding at rest after approaches from either side"
    AFTER_HANGING = "a weight just hung, and a minute later"


@dataclass(frozen=True)
class Context:
    """Data on which trial parameters may depend: the recordings under diagnosis and their nominal
    model.
    """

    views: tuple[View, ...]
    nominal: Nominal


class Clearance:
    """Travel of the motor during which friction holds the joint, as a gap or a hysteresis loop has
    it. Angles alone do not distinguish such effects if friction holds the joint.
    """

    torque_rises: bool
    """Whether the torque rises during the crossing of this travel."""

    def travel_and_rotor(self, shape: Shape) -> tuple[float, float]:
        """Return the travel, rad, and the inertia of the rotor at the joint, kg m^2."""
        raise NotImplementedError

    def closing_torque(self, shape: Shape) -> float:
        """Return the torque that the travel takes, N m; 0 for a gap."""
        raise NotImplementedError

    def of_travel(
        self, travel: float, rotor: float, per_torque: float, closing: tuple[float, float] | None
    ) -> tuple[Effect, Shape]:
        """Return an effect of this kind with the given travel.

        Args:
            travel: Travel, rad.
            rotor: Inertia of the rotor at the joint, kg m^2.
            per_torque: Compliance of the shaft, rad/(N m), per count of its encoder.
            closing: Torque that the travel takes and its standard error, N m, if they are known
                better than from a fit.
        """
        raise NotImplementedError


class Effect:
    """One physical effect that the nominal model omits.

    A subclass has the function :meth:`torque`, :meth:`transmission`, :meth:`voltage` or
    :meth:`breakaway` of each equation that the effect enters: static methods of a view, the nominal
    values and the nonlinear parameters that return regressors, shape (k, m). The effect adds the
    sum of coefficients times regressors to the measured less the nominal side of the equation.
    Search, corrected model and exported model all use these functions; :meth:`read` and :meth:`at`
    convert between coefficients and the parameters of the catalogue.

    Regressors that depend on the drive's torque use that of the nominal model. The measured torque
    is the quantity to be explained, and as a regressor would explain every mismatch.

    Attributes:
        name: Stable name: the name of the class in small letters.
        equation: Governing equation.
        assumption: Assumption of the paper that the effect violates.
        implied: The same after "the implied assumption that".
        shows_in: Equation in which the effect shows: ``torque``, ``transmission``, ``voltage``,
            ``breakaway`` or ``pressure``.
        coordinate: Coordinate over which the effect shows, a colon, and how the effect shows.
        parameters: Parameters with dimensions and plausible ranges.
        look_alikes: Names of the most similar effects.
        experiment: Experiment that distinguishes the effect from these.
        separation: Kind of this experiment if a sequence can carry it out; None if it needs a
            manual change of the bench.
        sentence: Sentence that states the effect, with parameters in braces.
        enters: Equations that the effect enters; the breakaway equation has the regressors of the
            torque equation unless the effect states others.
        on_drive: Whether the effect changes the torque that the logged current stands for, and not
            the torque that the motion requires.
        modelled: Equations of :attr:`enters` in which the corrected model has the effect; None for
            all of them.
        not_simulated: What a simulation of the exported model leaves out of the effect, and why;
            empty for an effect that the simulation has completely.
        flexible: Whether the joint moves differently from the motor, so that friction is a function
            of the motion of the joint encoder.
        fast: Whether the effect may vary by its full amplitude from row to row.
        needs: What recordings and bench must have to show the effect.
        fitted_by_estimators: Whether a campaign may declare the effect, so that the estimators fit
            it.
        declared_by: Key of a campaign's recordings that declares such a load if it is known; empty
            if there is none.
        nonlinear: Parameters of the catalogue that are nonlinear parameters, in their order; a
            number is the value, at given parameters, of a nonlinear parameter that the catalogue
            does not have.
        linear: Parameter of the catalogue that is the only coefficient: the one that is not
            nonlinear; empty if it is another function of the coefficients, or if nonlinear
            parameters determine the size.
        polar: Parameters of the catalogue that are amplitude and phase of a pair of coefficients.
        trials: Trial values of the nonlinear parameters.
        shown_by: Function that returns whether a recording can show the effect; None for every
            recording.
        refine: Index of each continuous nonlinear parameter to the half width of its search around
            the trial value; 0 for a parameter that is searched within a factor.
        forms: Index of a nonlinear parameter that selects the form of the effect to the values of
            this parameter, the usual form first.
        positive: Indices of coefficients that must be positive to be physical; a fixed coefficient
            is, and the coefficient of :attr:`linear` is if its range has no negative values. An
            effect states them only if its coefficients are not parameters of the catalogue.
        simulated: Whether the response is simulated, and not linear in the size.
        scale: Size from which the fit of an effect without a score starts.
        one_sided: Whether an effect of the opposite sign is one outside the catalogue.
        size: Fixed coefficient of a regressor whose size is determined by nonlinear parameters;
            None otherwise.
        shape_error: Class of the error of the regressor; :data:`EXACT` if the regressor is computed
            exactly from time, angle, motion or torque.
        follows: Whether the regressors depend on the nominal values, and so change during a fit.
        at_angle: Whether the torque of the effect depends on the angle, which must then be delayed
            like the samples of the torque.
        varies: Names of the equations whose regressors change with the nominal values although the
            coefficients do not change.
        limits: Index of a nonlinear parameter to its least and greatest physical value.
        measured: Name of a parameter of the catalogue that something else than the fit determined
            to its standard error.
        place: Index of the nonlinear parameter that is the number of the only recording with the
            effect; None for an effect that occurs in all recordings.
        start: Name of an equation to the regressor of an unknown state at the start of a recording;
            its coefficient is different in each recording, and is fitted also to recordings set
            aside.
    """

    name: str
    equation: str
    assumption: str
    implied: str
    shows_in = "torque"
    coordinate: str
    parameters: tuple[Quantity, ...]
    look_alikes: tuple[str, ...]
    experiment: str
    sentence: str
    separation: Separation | None = None
    enters: tuple[str, ...] = ("torque", "breakaway")
    on_drive = False
    modelled: tuple[str, ...] | None = None
    not_simulated = ""
    flexible = False
    fast = False
    needs: frozenset[Needs] = frozenset()
    fitted_by_estimators = False
    declared_by = ""
    nonlinear: tuple[str | float, ...] = ()
    linear = ""
    polar: tuple[str, ...] = ()
    trials: Sequence[Shape] = NO_SHAPE
    shown_by: Callable[[View], bool] | None = None
    refine: Mapping[int, float] = {}
    forms: Mapping[int, tuple[float, ...]] = {}
    positive: tuple[int, ...] = ()
    one_sided = False
    simulated = False
    scale = 1.0
    size: float | None = None
    shape_error: float = ROUGH
    follows = False
    at_angle = False
    varies: tuple[str, ...] = ()
    limits: Mapping[int, tuple[float, float]] = {}
    measured: Mapping[str, float] = {}
    place: int | None = None
    start: Mapping[str, Columns] = {}

    def __init_subclass__(cls) -> None:
        """Complete a definition: name, words without line ends, and what follows from the rest."""
        own = vars(cls)
        if not cls.__name__.startswith("_"):
            cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        for words in own.keys() & WORDS:
            setattr(cls, words, " ".join(own[words].split()))
        if "implied" in own:
            cls.assumption = f"the implied assumption that {cls.implied}"
        if cls.size is not None:
            cls.positive = (0,)
        elif "parameters" in own:
            if cls.read is Effect.read and not cls.polar:
                (cls.linear,) = (q.name for q in cls.parameters if q.name not in cls.nonlinear)
            if cls.linear and not cls.one_sided:
                least = next(q.low for q in cls.parameters if q.name == cls.linear)
                cls.positive = (0,) if least >= 0.0 else ()

    def modified(self, **changes: Any) -> Self:
        """Return the effect with other attributes."""
        changed = copy.copy(self)
        changed.__dict__.pop("columns", None)
        changed.__dict__.update(changes)
        return changed

    @property
    def group(self) -> str:
        """Group of the catalogue: that of the module."""
        return type(self).__module__.rpartition(".")[2].replace("_", " ")

    @cached_property
    def columns(self) -> Mapping[str, Columns]:
        """Name of each equation that the effect enters to its regressors there."""
        return {e: getattr(self, e, None) or self.torque for e in self.enters}  # type: ignore[attr-defined]

    @property
    def exported(self) -> tuple[str, ...]:
        """Equations in which the corrected model has the effect."""
        return self.enters if self.modelled is None else self.modelled

    @property
    def corrected(self) -> Mapping[str, Columns]:
        """Regressors of the corrected model, by equation; the torque at a breakaway is part of the
        torque.
        """
        found = {e: c for e, c in self.columns.items() if e in self.exported}
        return {"torque": found["breakaway"], **found} if "breakaway" in found else found

    @property
    def freedom(self) -> int:
        """Number of parameters fitted in addition to the coefficients."""
        return len(self.refine) - (self.size is not None)

    def physical(self, shape: Shape) -> bool:
        """Whether nonlinear parameters are within their limits."""
        return all(low <= shape[k] <= high for k, (low, high) in self.limits.items())

    def physical_range(self, name: str) -> tuple[float, float]:
        """Return the limits of a parameter of the catalogue that is a nonlinear parameter with
        limits; infinite for other parameters.
        """
        index = self.nonlinear.index(name) if name in self.nonlinear else -1
        return self.limits.get(index, (-math.inf, math.inf))

    def absent(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        """Return the parameters of the catalogue that are sizes of the effect, with their values
        without the effect. A size that is infinite without the effect, such as a stiffness, counts
        as zero: an interval that contains zero is as wide as the value.

        Args:
            c: Fitted coefficients.
            shape: Fitted nonlinear parameters.
            context: Recordings and nominal model.
        """
        if self.size is not None:
            sizes = [n for k, n in enumerate(self.nonlinear) if k in self.refine]
            return {n: 0.0 for n in sizes if isinstance(n, str)}
        here, twice, none = (self.read(k * c, shape, context) for k in (1.0, 2.0, NEARLY_NONE))
        return {
            name: none[name] if 1e-6 < abs(none[name] / value) < 1e6 else 0.0
            for name, value in here.items()
            if value != 0.0 and not math.isclose(twice[name], value)
        }

    def shapes(self, context: Context) -> Sequence[Shape]:
        """Return the trial values of the nonlinear parameters; empty if these recordings cannot
        show the effect.
        """
        shown = self.shown_by
        return self.trials if shown is None else everywhere(context, shown, self.trials)

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        """Return the parameters of the catalogue at fitted coefficients ``c``."""
        found = dict(zip(self.nonlinear, shape, strict=True))
        if self.polar:
            found |= zip(self.polar, polar(float(c[0]), float(c[1])), strict=True)
        elif self.linear:
            found[self.linear] = float(c[0])
        return {q.name: float(found[q.name]) for q in self.parameters}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        """Return nonlinear parameters and coefficients at parameters of the catalogue; the inverse
        of :meth:`read`. A parameter ``recording`` counts from 1.
        """
        given = {**values, "recording": values.get("recording", 1.0) - 1.0}
        shape = tuple(given[n] if isinstance(n, str) else n for n in self.nonlinear)
        if self.polar:
            return shape, cartesian(given[self.polar[0]], given[self.polar[1]])
        return shape, (given[self.linear] if self.linear else self.size or 0.0,)

    def begin(self, nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
        """Return the nominal values and nonlinear parameters from which a joint fit starts."""
        return nominal, shape

    def feeds_back(self, nominal: Nominal, _shape: Shape, _coefficients: Coefficients) -> Nominal:
        """Return the nominal values with those quantities of the fitted effect on which regressors
        of other effects depend.
        """
        return nominal

    def impossible(self, _coefficients: Coefficients, _nominal: Nominal) -> str:
        """Return why no machine has these coefficients at these values; empty if one may."""
        return ""

    def shows_a_period(self, _views: Sequence[View]) -> bool:
        """Whether the travel of a recording contains a period of an effect that is periodic."""
        return True

    def indistinct(
        self, _parameters: Mapping[str, float], _views: Sequence[View]
    ) -> tuple[str, ...]:
        """Return the names of effects from which these recordings cannot distinguish the effect
        although their regressors differ.
        """
        return ()

    def on_the_joint(self) -> Effect:
        """Return the effect for torques that are computed with the motion of the joint encoder."""
        return self


def title(name: str) -> str:
    """Return a stable name as words, such as ``asymmetric Coulomb`` of ``asymmetric_coulomb``."""
    return " ".join(_PROPER.get(word, word) for word in name.split("_"))


def polar(sine: float, cosine: float) -> tuple[float, float]:
    """Return amplitude and phase of ``sine`` sin(x) + ``cosine`` cos(x) = amplitude sin(x +
    phase).
    """
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))


def cartesian(amplitude: float, phase: float) -> tuple[float, float]:
    """Return the coefficients of sin(x) and cos(x) of amplitude sin(x + phase)."""
    return amplitude * math.cos(phase), amplitude * math.sin(phase)


def everywhere(
    context: Context, needed: Callable[[View], bool], shapes: Sequence[Shape] = NO_SHAPE
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
