"""Effects of springs, stops and unbalance on the joint, and of the lever with its weights, which
eq. 10 to 13 and 17 omit (Fig. 10).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi

import numpy as np

from identification.effects.effect import (
    CLOSE,
    EXACT,
    NO_SHAPE,
    Coefficients,
    Context,
    Dimension,
    Effect,
    Needs,
    Quantity,
    Separation,
    Shape,
    everywhere,
    of_each_recording,
    polar,
    rows,
)
from identification.numerics.series import sine_cosine
from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import View, recent

REFERENCE_FORCE_N = 3000.0
REFERENCE_MASS_KG = 30.6
"""Mass of case 2 of the paper, the reference for load exponent and load inertia."""
EXPONENTS: tuple[Shape, ...] = tuple((e,) for e in (0.6, 0.8, 0.9, 1.1, 1.2, 1.5))
UPPER, LOWER, BOTH = 1.0, -1.0, 0.0
"""End of the travel at which the joint meets a stop."""
STOPS = 10
"""Number of trial stops on either side, in the outer half of the travel."""
ONE_PHASE = 0.0
"""Last nonlinear parameter of a swing whose phase and size are the same at the start of each
recording; if each recording has its own phase and size, this parameter is the number of recordings.
"""
SWINGS_HZ = tuple(float(f) for f in np.arange(0.3, 3.01, 0.04))
SWING_DECAY_S = 8.0
ROUNDING = 1e-6
"""Size of the swing in a recording, relative to the greatest swing, below which it counts as a
rounding error.
"""


@recent
def _load(view: View, nominal: Nominal) -> Array:
    """Return the working load (eq. 13) with its sign, N m."""
    return np.asarray(view.sense * view.moment * nominal.coefficient(view))


def _forces(context: Context) -> set[float]:
    return {round(v.recording.contact_force, 6) for v in context.views if v.loaded}


def _travel(context: Context) -> tuple[float, float]:
    """Return the least and the greatest angle, rad."""
    ends = [(float(np.min(v.angle)), float(np.max(v.angle))) for v in context.views]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _of_the_label(view: View, nominal: Nominal) -> Array:
    """Return the drive torque that is proportional to the labelled mass, N m."""
    if view.loaded:
        return _load(view, nominal)
    return np.asarray(-view.known + view.sense * np.abs(view.hanging) * nominal.gear(view))


def label_kg(view: View) -> float:
    """Return the labelled mass of a recording, on the lever or turning with the joint, kg."""
    pendulum = view.recording.pendulum
    return view.recording.weight_mass if view.loaded or pendulum is None else pendulum.mass


def _has_weight(view: View) -> bool:
    return view.recording.pendulum is not None


def _with_load(
    nominal: Nominal, sine: float, cosine: float, slope: float, constant: float
) -> Nominal:
    """Return nominal values with a further load: of sin, cos, angle and 1, N m."""
    further = (sine, cosine, slope, constant)
    first, second, third, last = (a + b for a, b in zip(nominal.undeclared, further, strict=True))
    return replace(nominal, undeclared=(first, second, third, last))


class GravityImbalance(Effect):
    """Torque of a weight out of balance."""

    equation = "J domega/dt = i Km I - M_f - M_L - M sin(theta - theta_0)"
    implied = "the joint is balanced and nothing but friction loads it (eq. 1)"
    coordinate = """angle: a sine with one period per joint turn, the same in motion, at rest and in
        both directions"""
    parameters = (
        Quantity("torque_Nm", Dimension.TORQUE, 0.0, 50.0),
        Quantity("zero_rad", Dimension.PHASE, -pi, pi),
    )
    look_alikes = (
        "return_spring",
        "current_offset",
        "asymmetric_coulomb",
        "encoder_eccentricity",
    )
    experiment = """Slow motion over the widest travel that the stops allow, in both directions:
        over the angle, the torque of gravity is a sine, that of a spring a straight line, and that
        of an offset constant."""
    separation = Separation.TRAVEL
    sentence = """a weight out of balance pulls with up to {torque_Nm:N m}, and hangs straight down
        at {zero_rad:deg}"""
    shape_error = EXACT
    polar = ("torque_Nm", "zero_rad")
    needs = frozenset({Needs.COMMON_ZERO, Needs.JOINT_TURN})
    declared_by = "gravity"

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(np.sin(view.angle), -np.cos(view.angle))

    def feeds_back(self, nominal: Nominal, _shape: Shape, coefficients: Coefficients) -> Nominal:
        sine, cosine = coefficients
        return _with_load(nominal, sine, -cosine, 0.0, 0.0)


class ReturnSpring(Effect):
    """Torque of a spring."""

    equation = "J domega/dt = i Km I - M_f - M_L - k (theta - theta_0)"
    implied = "nothing but friction loads the joint (eq. 1)"
    coordinate = """angle: a straight line over the travel, the same in motion, at rest and in both
        directions"""
    parameters = (
        Quantity("stiffness_Nm_rad", Dimension.STIFFNESS, 0.0, 200.0),
        Quantity("rest_rad", Dimension.ANGLE, -pi, pi),
    )
    look_alikes = ("gravity_imbalance", "end_stop", "constant_torque", "current_offset")
    experiment = GravityImbalance.experiment
    separation = Separation.TRAVEL
    sentence = "a spring of {stiffness_Nm_rad:N m/deg} pulls the joint toward {rest_rad:deg}"
    positive = (0,)
    shape_error = EXACT
    needs = frozenset({Needs.COMMON_ZERO})

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(view.angle, -np.ones(len(view.time)))

    def read(self, c: Array, _shape: Shape, _context: Context) -> Mapping[str, float]:
        return {"stiffness_Nm_rad": float(c[0]), "rest_rad": float(c[1] / c[0]) if c[0] else 0.0}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        stiffness = values["stiffness_Nm_rad"]
        return (), (stiffness, stiffness * values["rest_rad"])

    def feeds_back(self, nominal: Nominal, _shape: Shape, coefficients: Coefficients) -> Nominal:
        slope, constant = coefficients
        return _with_load(nominal, 0.0, 0.0, slope, -constant)


class ConstantTorque(Effect):
    """Torque on the joint that is the same at any angle, as of a hanging mass or a pressure."""

    equation = "J domega/dt = i Km I - M_f - M_L + M_0"
    implied = "nothing but friction loads the joint (eq. 1)"
    coordinate = """direction: a constant torque in motion and at rest, at any speed, angle and
        load"""
    parameters = (Quantity("torque_Nm", Dimension.TORQUE, -200.0, 200.0),)
    look_alikes = ("asymmetric_coulomb", "current_offset", "gravity_imbalance", "return_spring")
    experiment = """The joint released at rest, with the power stage off: a load above static
        friction moves the joint, friction never does. A load below static friction is shown by the
        other side of the machine: without the load, the torque is gone, and an asymmetry of
        friction or an offset of the current remains."""
    sentence = """a constant torque of {torque_Nm:abs N m} drives the joint
        {torque_Nm:?forward/backward}, at any angle and speed"""
    shape_error = EXACT
    declared_by = "constant_torque"

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(-np.ones(len(view.time)))

    def feeds_back(self, nominal: Nominal, _shape: Shape, coefficients: Coefficients) -> Nominal:
        return _with_load(nominal, 0.0, 0.0, 0.0, -coefficients[0])


class EndStop(Effect):
    """Elastic stop at one end of the travel or at both.

    The sign of a single stop's angle is its end of the travel. A lower stop above zero and an upper
    stop below zero are written as a pair whose other stop is outside the travel.
    """

    equation = "J domega/dt = i Km I - M_f - M_L - k (theta - a) beyond the angle a, zero before it"
    implied = "the travel is free"
    coordinate = """angle: zero up to one angle, then a steep torque toward the free travel, in both
        directions of motion"""
    parameters = (
        Quantity("angle_rad", Dimension.ANGLE, -pi, pi),
        Quantity("stiffness_Nm_rad", Dimension.STIFFNESS, 1.0, 1e5),
        Quantity("other_rad", Dimension.ANGLE, -pi, pi),
    )
    look_alikes = ("return_spring", "position_dependent_friction", "gravity_imbalance")
    experiment = """Slow approaches to the suspected angle from the free travel, in steps of a
        degree, in both directions: a stop pushes back at rest too, friction does not."""
    separation = Separation.TRAVEL
    sentence = """an elastic stop of {stiffness_Nm_rad:N m/deg} begins at
        {angle_rad:deg}{other_rad:|, another one at |deg}"""
    refine = {1: 0.08, 2: 0.08}
    forms = {0: (UPPER, LOWER, BOTH)}
    positive = (0,)
    at_angle = True
    needs = frozenset({Needs.COMMON_ZERO})

    @staticmethod
    def torque(view: View, _nominal: Nominal, shape: Shape) -> Array:
        side, upper, lower = shape
        above, below = np.maximum(view.angle - upper, 0.0), np.minimum(view.angle - lower, 0.0)
        return rows((side != LOWER) * above + (side != UPPER) * below)

    def shapes(self, context: Context) -> Sequence[Shape]:
        low, high = _travel(context)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        return [
            (side, float(middle + share * half), float(middle - share * half))
            for share in np.linspace(0.5, 0.97, STOPS)
            for side in (UPPER, LOWER, BOTH)
        ]

    def read(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        side, upper, lower = shape
        low, high = _travel(context)
        if side == LOWER and lower >= 0.0:
            side, upper = BOTH, min(2.0 * high - low, max(high, pi))
        elif side == UPPER and upper < 0.0:
            side, lower = BOTH, max(2.0 * low - high, min(low, -pi))
        return {
            "angle_rad": lower if side == LOWER else upper,
            "stiffness_Nm_rad": float(c[0]),
            "other_rad": lower if side == BOTH else 0.0,
        }

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        angle, other = values["angle_rad"], values["other_rad"]
        side = BOTH if other != 0.0 else UPPER if angle >= 0.0 else LOWER
        return (side, angle, other if side == BOTH else angle), (values["stiffness_Nm_rad"],)


class LoadExponent(Effect):
    """Load friction in proportion to a power of the contact force."""

    equation = "M_L = L1 F_ref (F_P / F_ref)^p mu(omega), F_ref = 3000 N, p != 1"
    assumption = "assumption A2, and eq. 12: load friction is proportional to the contact force"
    coordinate = "load: a curve over the weight that is not a straight line, zero without load"
    parameters = (Quantity("exponent", Dimension.NUMBER, 0.3, 2.0),)
    look_alikes = (
        "torque_saturation",
        "wrong_weight",
        "load_position_dependence",
        "lever_pivot_friction",
    )
    experiment = """At least three weights, the heaviest at least four times the lightest, at one
        speed in both directions; and accelerations without load that need the same current."""
    separation = Separation.LOADS
    sentence = """load friction grows with the contact force to the power {exponent:}, where the
        nominal model has 1"""
    refine = {0: 0.0}
    size = 1.0
    follows = True
    shape_error = CLOSE
    nonlinear = ("exponent",)

    def absent(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        return {"exponent": 1.0}

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        arm = view.recording.bench.moment_arm or 1.0
        force = np.maximum(view.moment / arm, 1e-9)
        return rows(_load(view, nominal) * ((force / REFERENCE_FORCE_N) ** (shape[0] - 1.0) - 1.0))

    def shapes(self, context: Context) -> Sequence[Shape]:
        return EXPONENTS if len(_forces(context)) > 1 else ()


class LoadPositionDependence(Effect):
    """Contact force that depends on the angle."""

    equation = "F_P -> F_P (1 + s theta)"
    assumption = "assumptions A1 and A3: impact at one point, one touch spot"
    coordinate = "angle: load friction changes over the travel, zero without load"
    parameters = (Quantity("slope_per_rad", Dimension.SLOPE, -2.0, 2.0),)
    look_alikes = ("position_dependent_friction", "load_exponent", "gravity_imbalance")
    experiment = """Slow passes over the whole travel in both directions, without load and under two
        weights: friction of the load grows with the weight, friction of the bearing does not."""
    separation = Separation.TRAVEL
    sentence = "the contact force changes by {slope_per_rad:%/deg} of travel"
    follows = True
    shape_error = CLOSE
    shown_by = staticmethod(lambda view: view.loaded)
    needs = frozenset({Needs.COMMON_ZERO})

    @staticmethod
    def torque(view: View, nominal: Nominal, _shape: Shape) -> Array:
        return rows(_load(view, nominal) * view.angle)


class WrongWeight(Effect):
    """Mass that differs from its label in one recording.

    The nonlinear parameters are the number of the recording from 0 and, where it is given, the
    mass; the coefficient of a mass that is sought is the difference over the label.
    """

    equation = "F'_P = (L3/L4) m g with m other than the recording's label (eq. 17)"
    implied = "the weight has the mass on its label"
    coordinate = """load: in one recording the load friction is wrong by a constant factor; all
        other recordings fit"""
    parameters = (Quantity("mass_kg", Dimension.MASS, 0.0, 200.0),)
    look_alikes = ("load_exponent", "load_swing", "coulomb_drift")
    experiment = """Weigh the load on the lever and repeat this recording; all other recordings
        remain valid."""
    separation = Separation.LOADS
    not_simulated = "the weight of one recording, not a property of the machine"
    sentence = "the weight in {recordings} is {mass_kg:kg}, which differs from its label"
    place = 0
    follows = True
    shape_error = EXACT

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        share = float(view.index == round(shape[0]))
        if len(shape) > 1:
            label = label_kg(view)
            share *= shape[1] / label - 1.0 if label > 0.0 else 0.0
        return rows(_of_the_label(view, nominal) * share)

    def shapes(self, context: Context) -> Sequence[Shape]:
        labelled = [v for v in context.views if v.loaded or _has_weight(v)]
        return [(float(v.index),) for v in labelled] if len(labelled) > 1 else []

    def read(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        view = next(v for v in context.views if v.index == round(shape[0]))
        return {"mass_kg": (1.0 + float(c[0])) * label_kg(view)}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (values["recording"] - 1.0, values["mass_kg"]), (1.0,)


class LoadSwing(Effect):
    """Contact force of a swinging weight.

    The last nonlinear parameter is :data:`ONE_PHASE`, or the number of recordings, each of which
    then has a phase and a size of its own.
    """

    equation = "F_P -> F_P (1 + f cos(2 pi nu t) exp(-t / T)), t since the recording's start"
    implied = "the weight hangs still"
    coordinate = """time: load friction oscillates at one frequency, with an amplitude that decays
        from the start of the recording"""
    parameters = (
        Quantity("fraction", Dimension.NUMBER, 0.0, 0.9),
        Quantity("frequency_Hz", Dimension.FREQUENCY, 0.1, 10.0),
        Quantity("decay_s", Dimension.TIME, 0.2, 1000.0),
    )
    look_alikes = ("wrong_weight", "load_position_dependence", "torque_ripple")
    experiment = """One constant slow speed under load, started immediately after the weight was
        hung, and again after a minute: in the second recording the swing has decayed."""
    separation = Separation.AFTER_HANGING
    sentence = """the hung weight swings: the contact force by {fraction:%} at {frequency_Hz:Hz},
        dying away over {decay_s:s}"""
    refine = {0: 0.0, 1: 0.0}
    follows = True
    shape_error = CLOSE

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        swing = np.zeros((2, len(view.time)))
        if view.loaded:
            since = view.time - view.time[0]
            envelope = _load(view, nominal) * np.exp(-since / shape[1])
            swing = sine_cosine(2.0 * np.pi * shape[0], since) * envelope
        return swing if shape[2] == ONE_PHASE else of_each_recording(view, round(shape[2]), swing)

    def shapes(self, context: Context) -> Sequence[Shape]:
        loaded = [v.index for v in context.views if v.loaded]
        own = (float(1 + max(loaded)),) if len(loaded) > 1 else ()
        phases = (ONE_PHASE, *own) if loaded else ()
        return [(f, SWING_DECAY_S, phase) for f in SWINGS_HZ for phase in phases]

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        sizes = [
            polar(float(sine), float(cosine))[0]
            for sine, cosine in zip(c[::2], c[1::2], strict=True)
        ]
        # For recordings without load the columns are zero, and the coefficients are rounding
        # errors.
        least = ROUNDING * max(sizes)
        return {
            "fraction": float(np.median([size for size in sizes if size > least] or [0.0])),
            "frequency_Hz": shape[0],
            "decay_s": shape[1],
        }

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (values["frequency_Hz"], values["decay_s"], ONE_PHASE), (0.0, values["fraction"])


class LoadInertia(Effect):
    """Inertia in proportion to the mass on the lever."""

    equation = "J -> J + J_L m_w / (30.6 kg) where loaded"
    implied = "the lever's weight adds friction and no inertia (eq. 15)"
    coordinate = "acceleration: in phase with the acceleration, and proportional to the weight"
    parameters = (Quantity("inertia_kgm2", Dimension.INERTIA, 0.0, 5.0),)
    look_alikes = ("compliance", "current_loop_lag", "load_exponent")
    experiment = """Sines of one amplitude and two frequencies under two weights: a torque that
        grows with the square of the frequency and with the weight is due to inertia."""
    separation = Separation.LOADS_AND_SPEEDS
    sentence = "each 30.6 kg hung on the lever adds {inertia_kgm2:kg m^2} of inertia"
    shape_error = EXACT
    shown_by = staticmethod(lambda view: view.recording.weight_mass > 0.0)

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(view.acceleration * (view.recording.weight_mass / REFERENCE_MASS_KG))


class LeverPivotFriction(Effect):
    """Coulomb friction of the lever's pivot."""

    equation = "M_L -> M_L + d sgn(omega) where the lever is hung, whatever the mass"
    assumption = "assumption A3: load friction arises at one touch spot alone (eq. 12)"
    coordinate = """load: a step between no weight and any weight, against the motion in both
        directions"""
    parameters = (Quantity("torque_Nm", Dimension.TORQUE, 0.0, 20.0),)
    look_alikes = ("load_exponent", "wrong_weight", "coulomb_drift")
    experiment = """Two very different weights, and the lever without weight: the straight line of
        friction over mass, extended to zero mass, gives the friction of the pivot."""
    separation = Separation.LOADS
    sentence = "the lever's own pivot adds {torque_Nm:N m} of friction, the same for every weight"
    shape_error = CLOSE

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(view.sense * float(view.loaded))

    def shapes(self, context: Context) -> Sequence[Shape]:
        return NO_SHAPE if len(_forces(context)) > 1 else ()


class LoadDependentFriction(Effect):
    """Friction in proportion to the torque of the known loads that turn with the joint."""

    equation = "M_f -> M_f + c |M_load| sgn(omega)"
    implied = "system friction does not depend on the load torque (eq. 9)"
    coordinate = """load: proportional to the torque of the load, against the motion in both
        directions"""
    parameters = (Quantity("coefficient", Dimension.NUMBER, 0.0, 1.0),)
    look_alikes = ("transmission_efficiency", "torque_saturation", "position_dependent_friction")
    experiment = """One slow motion under two loads and without load, raising and lowering: friction
        that grows with the load is the same in both directions, the loss of a gear is not."""
    separation = Separation.LOADS
    sentence = "friction grows by {coefficient:%} of the load's torque"
    follows = True
    fitted_by_estimators = True

    @staticmethod
    def torque(view: View, nominal: Nominal, _shape: Shape) -> Array:
        return rows(view.sense * nominal.borne(view))

    def shapes(self, context: Context) -> Sequence[Shape]:
        # A load that an effect adds is not known, but fitted.
        if any(context.nominal.undeclared):
            return ()
        return everywhere(context, lambda v: _has_weight(v) or v.recording.steady_torque != 0.0)
