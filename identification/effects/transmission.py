"""Effects between motor and joint: a joint angle theta other than phi / i, and a joint torque other
than i times the motor torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import pi
from typing import NamedTuple

import numpy as np

from identification.effects.effect import (
    EXACT,
    Clearance,
    Coefficients,
    Context,
    Dimension,
    Effect,
    Needs,
    Quantity,
    Separation,
    Shape,
    everywhere,
    rows,
)
from identification.numerics.series import dahl, falling_play, first_swing, play, sine_cosine
from identification.recording import Array
from identification.signals import central_difference, quantum
from identification.views.nominal import Nominal
from identification.views.view import View, at_scale, recent

WITH_TORQUE = (1.0, 0.0)
TEETH: tuple[Shape, ...] = tuple((float(n), WITH_TORQUE[0]) for n in range(5, 201))
GAPS_RAD = tuple(float(g) for g in np.geomspace(5e-5, 5e-2, 13))
TWIST_COUNTS = (0.0, 2.0)
"""Search range of the twist of a stiff shaft under the greatest torque, in counts of the joint
encoder.
"""
LOOP_SHARES = (0.05, 0.15, 0.4)
"""Trial torques that close a hysteresis loop, relative to the greatest torque."""
LEAST_JOINT_SHARE = 0.1
"""Least share of the joint's side in the total inertia."""
LOOPS_RAD = tuple(float(x) for x in np.geomspace(5e-5, 1e-2, 5))
ROTOR_SHARE = 0.5
"""Start value of the rotor's share of the total inertia, which is unknown and fitted."""
WIND_SHARES = tuple(float(s) for s in np.geomspace(3e-4, 0.1, 7))
"""Trial travels over which a gear's friction builds up, relative to the travel."""
LOSSES = ((0.1, 0.0), (0.1, 0.1), (0.3, 0.1))
"""Trial shares of a gear's torque that its friction takes, against the motion and the torque."""
ONE_BODY = "the model moves motor and joint as one body; only the motor's angle has the effect"
"""What a simulation leaves out of an effect of a flexible transmission."""
FIRST_SAMPLES = 20
"""Number of samples at the start of a recording whose encoder readings determine the initial
position in a gap or a hysteresis loop.
"""


class Gap(NamedTuple):
    """Nonlinear parameters of a gap: width, rad, compliance of the shaft, inertia of the rotor."""

    width: float
    counts: float
    """Twist of the shaft under the greatest torque, in counts of the joint encoder."""
    per_torque: float
    """Compliance with which the shaft twists by one count under the greatest torque, rad/(N m)."""
    rotor: float
    """Inertia of the rotor at the joint, kg m^2."""


class Loop(NamedTuple):
    """Nonlinear parameters of a coupling's hysteresis loop: closing torque, N m, deflection, rad,
    and shaft and rotor as in :class:`Gap`.
    """

    torque: float
    rotor: float
    deflection: float
    counts: float
    per_torque: float


def coupling_torque(view: View, rotor: float) -> Array:
    """Return the torque through the coupling, N m, for a rotor of this inertia at the joint, kg
    m^2.

    While a hysteresis loop is crossed, the rotor moves alone, and its acceleration requires most of
    the drive's torque.
    """
    out = rotor * view.rotor_acceleration
    return np.asarray(np.subtract(view.transmitted, out, out=out))


def count_of_twist(views: Sequence[View]) -> float:
    """Return the compliance with which a shaft twists by one count of the joint encoder at the
    greatest torque, rad/(N m).

    Even a stiff shaft twists under torque, and its twist adds to the lead through a narrow gap.
    """
    known = [v for v in views if v.lag is not None]
    greatest = max((float(np.max(np.abs(v.transmitted))) for v in known), default=0.0)
    return (
        max(quantum(v.recording.channels["angle"]) for v in known) / greatest
        if greatest > 0.0
        else 0.0
    )


def lead(view: View, nominal: Nominal, gap: float, rotor: float) -> Array:
    """Return the motor's lead through a gap, rad, shape (m,); the initial position in the gap is
    computed from the encoder readings.

    The joint rests while the gap is open, unless a weight exceeds the friction of the joint.

    Args:
        view: The recording.
        nominal: Nominal values, whose friction and inertia are used if a weight turns with the
            joint.
        gap: Width of the gap, rad.
        rotor: The rotor's inertia at the joint, kg m^2.
    """
    if not nominal.helped(view) or nominal.get("J") <= 0.0:
        return _lead(view, None, gap, 0.0)
    return _lead(view, nominal, gap, rotor)


@recent
def _lead(view: View, nominal: Nominal | None, gap: float, rotor: float) -> Array:
    """Return :func:`lead`; ``nominal`` may be None if no weight turns with the joint."""
    motor = view.drive_angle
    through = _through(view, nominal, motor, gap, rotor)
    middle = through(len(motor), 0.0)
    crossed = first_swing(motor, gap)
    if view.lag is None or crossed == len(motor):
        return middle
    zero = float(np.mean(view.lag[crossed:] - middle[crossed:]))
    # From this sample on the lead does not depend on its start value, because a flank has driven
    # the joint.
    middle[: crossed + 1] = through(crossed + 1, float(np.mean(view.lag[:FIRST_SAMPLES])) - zero)
    return middle


def _through(
    view: View, nominal: Nominal | None, motor: Array, gap: float, rotor: float
) -> Callable[[int, float], Array]:
    """Return the lead, rad, as a function of a number of samples and the initial lead, rad."""
    if nominal is None:
        return lambda count, start: play(motor[:count], gap, start)
    weight = nominal.helping(view)
    inertia = max(nominal.get("J") - rotor, LEAST_JOINT_SHARE * nominal.get("J"))
    pull, hold = weight / inertia, np.abs(nominal.friction(view)) / inertia
    speed = view.motor_speed / view.recording.bench.gear_ratio
    return lambda count, start: falling_play(
        motor[:count], speed, view.step, gap, pull, hold, start
    )


@recent
def _closing(view: View, width: float, rotor: float) -> tuple[Array, Array, int, Array | None]:
    """Return the components of a hysteresis loop that do not depend on its deflection and twist.

    Returns:
        Transmitted torque, N m; deflection from the centre of the loop, relative to the greatest
        deflection; first sample from which the deflection does not depend on the start; means of
        lag, torque and deflection over the first samples and from this sample on, shape (2, 3), or
        None.
    """
    torque = coupling_torque(view, rotor)
    state, closed = _sheared(torque, width), first_swing(torque, 2.0 * width)
    if view.lag is None or closed == len(torque):
        return torque, state, closed, None
    stretches = slice(FIRST_SAMPLES), slice(closed, None)
    means = np.array(
        [[np.mean(series[s]) for series in (view.lag, torque, state)] for s in stretches]
    )
    return torque, state, closed, means


def _sheared(torque: Array, width: float, start: float = 0.0) -> Array:
    """Return the deflection of a hysteresis loop relative to its greatest deflection; ``start`` is
    the initial lead of the play operator, whose input is the torque.
    """
    out = play(torque, 2.0 * width, start)
    out = np.subtract(torque, out, out=out)
    out /= width
    return np.asarray(np.clip(out, -1.0, 1.0, out=out))


def both_encoders(view: View) -> bool:
    """Whether a recording has both encoders."""
    return view.lag is not None


class Backlash(Clearance, Effect):
    """Gap: the joint rests until the motor has crossed it."""

    equation = """theta stands while |phi / i - theta| < gap / 2, else phi / i - theta = gap / 2
        sgn(M)"""
    assumption = "assumption A5: no mechanical clearance, phi = i theta"
    shows_in = "transmission"
    coordinate = """travel since reversal: a step of fixed size of the angle difference at each
        reversal of torque"""
    parameters = (Quantity("gap_rad", Dimension.ANGLE, 0.0, 0.1),)
    look_alikes = ("compliance", "coupling_hysteresis", "transport_delay", "presliding")
    experiment = """Torque that passes slowly through zero, at two loads and two speeds: a gap has a
        fixed width in angle; the effect of a twist is proportional to the torque, that of a delay
        to the speed."""
    separation = Separation.LOADS_AND_SPEEDS
    not_simulated = ONE_BODY
    sentence = "the shaft turns {gap_rad:deg} before the valve follows each reversal of torque"
    refine = {0: 0.0, 1: 0.5 * TWIST_COUNTS[1], 3: 0.0}
    limits = {1: TWIST_COUNTS}
    size = 1.0
    varies = ("transmission",)
    enters = ("transmission",)
    nonlinear = ("gap_rad", 0.0, 0.0, 0.0)
    flexible = True
    torque_rises = False

    @staticmethod
    def transmission(view: View, nominal: Nominal, shape: Shape) -> Array:
        gap, counts, per_torque, rotor = Gap(*shape)
        return rows(
            lead(view, nominal, gap, rotor) + counts * per_torque * coupling_torque(view, rotor)
        )

    def shapes(self, context: Context) -> Sequence[Shape]:
        per_torque, rotor = count_of_twist(context.views), ROTOR_SHARE * context.nominal.get("J")
        return everywhere(
            context,
            both_encoders,
            [
                (gap, 0.5 * TWIST_COUNTS[1], per_torque, rotor)
                for gap in at_scale(GAPS_RAD, context.views)
            ],
        )

    def travel_and_rotor(self, shape: Shape) -> tuple[float, float]:
        return Gap(*shape).width, Gap(*shape).rotor

    def closing_torque(self, _shape: Shape) -> float:
        return 0.0

    def of_travel(
        self, travel: float, rotor: float, per_torque: float, _closing: tuple[float, float] | None
    ) -> tuple[Effect, Shape]:
        return self, Gap(travel, 0.5 * TWIST_COUNTS[1], per_torque, rotor)


class Compliance(Effect):
    """Elastic twist in proportion to the torque.

    The regressors are the drive torque, and the torques of rotor inertia, shaft damping, and the
    rotor's dry and viscous friction. Of these torques only the drive torque is known. With a soft
    shaft the effect of all other torques is up to a hundred times the noise of the encoders.
    """

    equation = "phi / i - theta = M / k"
    assumption = "assumption A4: no deformation"
    shows_in = "transmission"
    coordinate = """torque: the difference of the angles of motor and joint is proportional to the
        torque between them"""
    parameters = (Quantity("stiffness_Nm_rad", Dimension.STIFFNESS, 50.0, 1e6),)
    look_alikes = ("backlash", "coupling_hysteresis", "transport_delay")
    experiment = Backlash.experiment
    separation = Separation.LOADS_AND_SPEEDS
    not_simulated = ONE_BODY
    sentence = """the shaft twists in proportion to its torque, with a stiffness of
        {stiffness_Nm_rad:N m/deg}"""
    positive = (0,)
    shape_error = EXACT
    enters = ("transmission",)
    shown_by = staticmethod(both_encoders)
    flexible = True

    @staticmethod
    def transmission(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        torque, speed = view.transmitted, view.motor_speed / view.recording.bench.gear_ratio
        damping = -central_difference(torque, view.step)
        return rows(torque, -view.rotor_acceleration, damping, -view.sense, -speed)

    def read(self, c: Array, _shape: Shape, _context: Context) -> Mapping[str, float]:
        return {"stiffness_Nm_rad": 1.0 / float(c[0])}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (), (1.0 / values["stiffness_Nm_rad"], 0.0, 0.0, 0.0, 0.0)


class GearMeshRipple(Effect):
    """Transmission ratio that is periodic in the joint's angle."""

    equation = """phi / i - theta = A sin(n theta + p); M = i Km I (1 + A n cos(n theta + p)) (if
        with_torque = 1)"""
    assumption = "assumption A5: phi = i theta with one constant ratio i"
    shows_in = "transmission"
    coordinate = """angle: periodic in the joint's angle, the same in both directions and at any
        speed and load"""
    parameters = (
        Quantity("amplitude_rad", Dimension.ANGLE, 0.0, 0.05),
        Quantity("per_turn", Dimension.CYCLES, 5.0, 2000.0),
        Quantity("phase_rad", Dimension.PHASE, -pi, pi),
        Quantity("with_torque", Dimension.NUMBER, 0.0, 1.0),
    )
    look_alikes = ("encoder_eccentricity", "cogging", "torque_ripple")
    experiment = """Slow turns over the whole travel: an error with more than one period per joint
        turn is due to the gear, an error with one period to the seat of the encoder. Turning the
        encoder on its shaft changes the phase of the latter only."""
    separation = Separation.TRAVEL
    sentence = """the gear's ratio varies: the angles of motor and joint differ by up to
        {amplitude_rad:deg}, {per_turn:} times per joint turn (phase {phase_rad:deg}), and the
        torque varies with the ratio ({with_torque:}; 1: it does, 0: it does not)"""
    forms = {1: WITH_TORQUE}
    at_angle = True
    follows = True
    enters = ("transmission", "torque")
    nonlinear = ("per_turn", "with_torque")
    polar = ("amplitude_rad", "phase_rad")
    trials = TEETH
    shown_by = staticmethod(both_encoders)
    on_drive = True
    flexible = True
    fast = True
    needs = frozenset({Needs.JOINT_TURN})

    def shapes(self, context: Context) -> Sequence[Shape]:
        turns = max(float(np.ptp(v.angle)) for v in context.views) / (2.0 * pi)
        return [shape for shape in super().shapes(context) if shape[0] * turns >= 1.0]

    def indistinct(
        self, parameters: Mapping[str, float], _views: Sequence[View]
    ) -> tuple[str, ...]:
        # A difference of the angles without a torque may also be an error of an encoder.
        return () if parameters["with_torque"] else ("encoder_ripple",)

    @staticmethod
    def transmission(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return sine_cosine(shape[0], view.angle)

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        # Where the teeth make the motor turn faster, it needs less torque in the same proportion:
        # power is conserved. An error of the angle alone, as of an encoder, makes no torque.
        sine, cosine = sine_cosine(shape[0], view.angle)
        torque = shape[1] * shape[0] * nominal.drive(view)
        out = np.empty((2, len(torque)))
        out[0] = np.negative(np.multiply(torque, cosine, out=out[0]), out=out[0])
        out[1] = np.multiply(torque, sine, out=out[1])
        return out


class TransmissionEfficiency(Effect):
    """Power that the gear loses in either direction; the coefficient is 1 / eta - 1."""

    equation = """M_joint = eta i Km I where the motor drives (M omega > 0), i Km I / eta where it
        is driven"""
    implied = "the gear transmits torque without loss in either direction of power"
    coordinate = "torque: proportional to the torque, with the sign of the power through the gear"
    parameters = (Quantity("efficiency", Dimension.NUMBER, 0.4, 1.0),)
    look_alikes = ("asymmetric_coulomb", "load_dependent_friction", "torque_saturation")
    experiment = """A load that pulls both ways, in one recording at least: a declared weight fixed
        to the joint, level and heavier than its friction. The loss follows the direction of power,
        an asymmetry that of motion. If friction is the only load, power flows in one direction
        only, and the nominal parameters explain the loss."""
    separation = Separation.LOADS
    sentence = """the gear transmits {efficiency:%} of the torque, both when it drives and when it
        is driven back"""
    positive = (0,)
    follows = True
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, _shape: Shape) -> Array:
        # If the load drives the motor, the share eta of the torque is transmitted; if the motor
        # drives the load, 1 / eta of the torque is required.
        torque = nominal.drive(view)
        return rows(torque * np.where(torque * view.velocity >= 0.0, 1.0, -nominal.efficiency))

    def read(self, c: Array, _shape: Shape, _context: Context) -> Mapping[str, float]:
        return {"efficiency": 1.0 / (1.0 + float(c[0]))}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (), (1.0 / values["efficiency"] - 1.0,)

    def feeds_back(self, nominal: Nominal, _shape: Shape, coefficients: Coefficients) -> Nominal:
        return replace(nominal, efficiency=1.0 / (1.0 + max(coefficients[0], 0.0)))


class GearFriction(Effect):
    """Friction of a gear in proportion to the torque that it transmits; the friction builds up over
    a small travel, as in strain-wave and cycloid gears.
    """

    equation = """M_joint = M - a |M| z - d M z^2, M = i Km I; dz/dtheta = (1 - z sgn(omega)) / h"""
    implied = "the gear transmits torque without loss, and friction does not depend on it (eq. 9)"
    coordinate = """travel since reversal: friction in proportion to the torque, which changes its
        sign gradually over a small travel"""
    parameters = (
        Quantity("travel_rad", Dimension.ANGLE, 0.0, 0.5),
        Quantity("against_motion", Dimension.NUMBER, 0.0, 0.6),
        Quantity("against_torque", Dimension.NUMBER, 0.0, 0.6),
    )
    look_alikes = ("presliding", "transmission_efficiency", "coupling_hysteresis")
    experiment = """Small and large reversals under two loads that pull both ways: this friction and
        its slope after a reversal grow with the load; presliding of a bearing does not."""
    separation = Separation.LOADS
    sentence = """the gear's friction is {against_motion:%} of its torque against the motion and
        {against_torque:%} against the torque, and builds up over {travel_rad:deg} of travel after
        each reversal"""
    refine = {0: 0.0, 1: 0.1, 2: 0.1}
    limits = {1: (0.0, 0.6), 2: (0.0, 0.35)}
    size = 1.0
    follows = True
    enters = ("torque",)
    nonlinear = ("travel_rad", "against_motion", "against_torque")
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        travel, against_motion, against_torque = shape
        z = dahl(view.angle, np.ones(len(view.angle)), 1.0 / travel)
        torque = nominal.drive(view)
        lost = against_motion * np.sign(torque) * z + against_torque * z**2
        return rows(torque * lost / (1.0 - lost))

    def shapes(self, context: Context) -> Sequence[Shape]:
        # If friction is the only load, the two losses have one regressor, that of presliding.
        travel = max(float(np.ptp(v.angle)) for v in context.views)
        trials = [(share * travel, a, d) for share in WIND_SHARES for a, d in LOSSES]
        return everywhere(context, context.nominal.helped, trials)


class CouplingHysteresis(Clearance, Effect):
    """Coupling whose deflection lags behind the torque and dissipates work."""

    equation = """phi / i - theta = x sat(P / M_h), P the play of half width M_h that the torque M
        drags along"""
    assumption = "assumption A4: no deformation; and a deformed part springs back without loss"
    shows_in = "transmission"
    coordinate = """travel since reversal: loops of the deflection over the torque, the same at any
        speed"""
    parameters = (
        Quantity("torque_Nm", Dimension.TORQUE, 0.01, 100.0),
        Quantity("deflection_rad", Dimension.ANGLE, 0.0, 0.05),
    )
    look_alikes = ("backlash", "compliance", "presliding")
    experiment = """Loops of torque of growing size around zero and around a constant torque,
        without motion of the joint: with hysteresis, loops of deflection over torque appear at any
        constant torque, with a gap at zero torque only, with a spring never."""
    separation = Separation.LOADS_AND_SPEEDS
    not_simulated = ONE_BODY
    sentence = """the coupling lags behind its torque by a loop of {deflection_rad:deg} that closes
        over {torque_Nm:N m}"""
    refine = {2: 0.0, 0: 0.0, 1: 0.0, 3: 0.5 * TWIST_COUNTS[1]}
    limits = {3: TWIST_COUNTS}
    size = 1.0
    enters = ("transmission",)
    nonlinear = ("torque_Nm", 0.0, "deflection_rad", 0.0, 0.0)
    flexible = True
    torque_rises = True

    @staticmethod
    def transmission(view: View, _nominal: Nominal, shape: Shape) -> Array:
        width, rotor, deflection, counts, per_torque = Loop(*shape)
        torque, state, closed, known = _closing(view, width, rotor)
        compliance = counts * per_torque
        out = deflection * state + compliance * torque
        if known is not None:
            at_first, later = (float(lag - compliance * twisting) for lag, twisting in known[:, :2])
            first = (at_first - (later - deflection * float(known[1, 2]))) / deflection
            here = torque[: closed + 1]
            initial = _sheared(here, width, float(torque[0]) - width * min(max(first, -1.0), 1.0))
            out[: closed + 1] = deflection * initial + compliance * here
        return rows(out)

    def shapes(self, context: Context) -> Sequence[Shape]:
        known = [v for v in context.views if v.lag is not None]
        if not known:
            return []
        greatest = max(float(np.max(np.abs(v.transmitted))) for v in known)
        rotor, per_torque = ROTOR_SHARE * context.nominal.get("J"), count_of_twist(known)
        deflections = at_scale(LOOPS_RAD, context.views)
        sizes = [
            (share * greatest, deflection) for share in LOOP_SHARES for deflection in deflections
        ]
        return [
            (width, rotor, deflection, 0.5 * TWIST_COUNTS[1], per_torque)
            for width, deflection in sizes
        ]

    def travel_and_rotor(self, shape: Shape) -> tuple[float, float]:
        return 2.0 * Loop(*shape).deflection, Loop(*shape).rotor

    def closing_torque(self, shape: Shape) -> float:
        return Loop(*shape).torque

    def of_travel(
        self, travel: float, rotor: float, per_torque: float, closing: tuple[float, float] | None
    ) -> tuple[Effect, Shape]:
        torque, error = closing or (1.0, 0.0)
        loop = Loop(torque, rotor, 0.5 * travel, 0.5 * TWIST_COUNTS[1], per_torque)
        if closing is None:
            return self, loop
        # The closing torque is fixed, because the crossings determine it better than the angles;
        # the other nonlinear parameters are fitted.
        sought = {k: reach for k, reach in self.refine.items() if Loop._fields[k] != "torque"}
        return self.modified(refine=sought, measured={"torque_Nm": error}), loop
