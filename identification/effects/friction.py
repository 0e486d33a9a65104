"""Effects of system friction that a Stribeck curve without memory and without dependence on
direction, angle and temperature (eq. 9) omits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import pi

import numpy as np

from identification.effects.effect import (
    CLOSE,
    EXACT,
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
from identification.numerics.series import dahl, first_order_lag, play
from identification.recording import Array
from identification.signals import central_difference
from identification.views.nominal import SPEEDS, Nominal
from identification.views.view import View, recent, reversals, torque_scale, travel_scale

AT_START_S = 0.02
"""Duration over which a straight line is fitted to the torque to determine the presliding force at
the start, s.
"""
ALPHAS = (0.5, 0.7, 0.9, 1.2, 1.5, 2.6, 3.4, 4.5)
SAME_FALL = (0.6, 0.1)
"""Shares of the rise that remain at the speed at which the friction with a trial exponent equals
the nominal friction. The right share depends on the speeds of the recordings.
"""
LEVEL_OR_SPEED = (0.0, 1.0)
"""Quantity that lags: the level of friction (0), or the speed on which this level depends (1)."""
LAGS: tuple[Shape, ...] = tuple(
    (t, of_speed) for of_speed in LEVEL_OR_SPEED for t in (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
)
DWELLS_S: tuple[Shape, ...] = tuple((t,) for t in (0.1, 0.3, 1.0, 3.0, 10.0))
STIFFNESSES = np.geomspace(3e2, 1e6, 15)
"""Trial stiffnesses of presliding on the practical bench, N m/rad."""
PLAY_SHARES = tuple(float(s) for s in np.geomspace(0.004, 0.5, 12))
"""Trial widths of a play, relative to the travel."""
TOUCHING = 1e-6
"""Distance from a flank of a play up to which the flank drives, relative to half the play."""
STEADY_S = 1e6
"""Time constant of a drift that does not level off, s."""
WARM_UPS_S: tuple[Shape, ...] = tuple((t,) for t in (20.0, 60.0, 150.0, 400.0))
PATCH_CENTRES = 12
PATCH_WIDTHS = (0.02, 0.05, 0.12)
"""Trial widths (standard deviations) of a worn patch, relative to the travel."""


def _fall_change(view: View, nominal: Nominal, name: str, shape: Shape) -> Array:
    omega_s = nominal.get(name)
    if omega_s <= 0.0:
        return np.zeros(len(view.velocity))
    alpha, wider = shape
    return np.asarray(
        _stribeck_fall(view, omega_s, alpha, wider)
        - _stribeck_fall(view, omega_s, nominal.alpha, 1.0)
    )


@recent
def _stribeck_fall(view: View, omega_s: float, alpha: float, wider: float) -> Array:
    return np.asarray(np.exp(-((np.abs(view.velocity) / omega_s / wider) ** alpha)))


@recent
def dry_level(view: View, nominal: Nominal) -> Array:
    """Return the part of friction that is not proportional to speed, without its sign, N m."""
    total = nominal.level(view) - nominal.get("sigma_2") * np.abs(view.velocity)
    if view.loaded:
        slope = nominal.get("mu_2") * np.abs(view.velocity)
        total = total + view.moment * (nominal.coefficient(view) - slope)
    return np.asarray(total)


@recent
def _with_lagged_speed(view: View, time_s: float) -> View:
    """Return the view with its speed after a first-order lag."""
    return view.with_velocity(first_order_lag(view.velocity, view.step, time_s))


@recent
def initial_friction(view: View, nominal: Nominal) -> float:
    """Return the friction that balances the drive's torque at rest at the start of a recording, N
    m.

    The presliding stiffness of a resting joint may hold any friction up to the static friction in
    either direction, which depends on the motion before the recording. The friction at the start is
    therefore computed from the measured torque. Its contribution decays with the first slip, so
    that an error of the friction at the start cannot explain any other mismatch.
    """
    places = np.arange(max(2, round(AT_START_S / view.step)))
    left = view.torque[places] - nominal.get("J") * view.acceleration[places]
    return float(np.polyval(np.polyfit(places, left, 1), 0.0))


def _left_of_the_start(view: View, shape: Shape) -> Array:
    """Return what is left of a state that is 1 at the start of the running time."""
    return np.asarray(np.exp(-view.run_time / shape[0]))


def _viscous_start(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(view.velocity * _left_of_the_start(view, shape))


def _coulomb_start(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(view.sense * _left_of_the_start(view, shape))


class AsymmetricCoulomb(Effect):
    """Coulomb friction that is greater in one direction than in the other."""

    equation = "Mc, Ms -> Mc + d, Ms + d for omega > 0; Mc - d, Ms - d for omega < 0"
    implied = "friction is the same both ways (eq. 9)"
    coordinate = """direction: a constant torque in motion, the same at any speed, angle and load;
        none at rest"""
    parameters = (Quantity("torque_Nm", Dimension.TORQUE, -20.0, 20.0),)
    look_alikes = (
        "constant_torque",
        "current_offset",
        "asymmetric_viscous",
        "gravity_imbalance",
        "transmission_efficiency",
    )
    experiment = """Holding at rest after approaches from either side, at two loads, and over the
        widest travel: at rest asymmetric friction is zero, an offset of the current remains, and
        gravity changes with the angle."""
    separation = Separation.HOLD
    sentence = """friction is {torque_Nm:abs N m} {torque_Nm:?higher/lower} in the positive
        direction, and as much {torque_Nm:?lower/higher} in the negative, at any speed"""
    shape_error = EXACT

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(np.ones(len(view.time)))

    def impossible(self, coefficients: Coefficients, nominal: Nominal) -> str:
        if abs(coefficients[0]) <= nominal.values.get("Mc", np.inf):
            return ""
        return "friction that drives the motion in one direction"


class AsymmetricViscous(Effect):
    """Viscous friction that is greater in one direction than in the other."""

    equation = "sigma_2 -> sigma_2 + d for omega > 0; sigma_2 - d for omega < 0"
    implied = "friction is the same both ways (eq. 9)"
    coordinate = "speed: proportional to |omega|, with one sign in both directions"
    parameters = (Quantity("coefficient_Nms_rad", Dimension.VISCOSITY, -40.0, 40.0),)
    look_alikes = ("asymmetric_coulomb", "quadratic_drag", "current_offset")
    experiment = """Steady speeds in both directions, at least four between the Stribeck speed and
        the limit: an asymmetry that grows with speed is one of viscous friction, a constant
        asymmetry is one of Coulomb friction."""
    separation = Separation.SPEEDS
    sentence = """viscous friction is {coefficient_Nms_rad:abs N m s/rad}
        {coefficient_Nms_rad:?higher/lower} in the positive direction, and as much
        {coefficient_Nms_rad:?lower/higher} in the negative"""
    shape_error = CLOSE

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(np.abs(view.velocity))


class QuadraticDrag(Effect):
    """Drag in proportion to the square of the speed."""

    equation = "M_f -> M_f + c omega |omega|"
    implied = "friction grows with speed as a line (eq. 9)"
    coordinate = "speed: proportional to the square of the speed, greatest at the highest speed"
    parameters = (Quantity("coefficient_Nms2_rad2", Dimension.DRAG, -80.0, 80.0),)
    look_alikes = ("asymmetric_viscous", "stribeck_shape", "viscous_thermal_drift")
    experiment = """Steady speeds in both directions up to the limit, at least four above three
        Stribeck speeds, in rising and in falling order: quadratic drag depends on the speed alone,
        the effect of warming also on time."""
    separation = Separation.SPEEDS
    sentence = """friction is {coefficient_Nms2_rad2:?higher/lower} by
        {coefficient_Nms2_rad2:abs N m s^2/rad^2} times the square of speed"""

    @staticmethod
    def torque(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(view.velocity * np.abs(view.velocity))


class StribeckShape(Effect):
    """Stribeck curves with another exponent than that of the nominal model.

    The nonlinear parameters are the exponent, and the ratio of the trial to the nominal Stribeck
    speed; with it trial and nominal friction are equal at the speed at which a share
    :data:`SAME_FALL` of the rise remains.
    """

    equation = "M_f = Mc + (Ms - Mc) exp(-|omega / omega_sf|^alpha) + sigma_2 |omega|, alpha != 2"
    assumption = "the printed exponent alpha = 2 of the Stribeck curve (eq. 13)"
    coordinate = "speed: between zero and three Stribeck speeds, the same in both directions"
    parameters = (Quantity("alpha", Dimension.NUMBER, 0.3, 6.0),)
    look_alikes = ("friction_memory", "presliding", "quadratic_drag")
    experiment = """Steady slow speeds, five between a fifth of the Stribeck speed and three
        Stribeck speeds, in both directions, each approached from higher and from lower speed: a
        Stribeck curve does not depend on this history, friction with memory does."""
    separation = Separation.SLOW
    sentence = """friction falls from static to Coulomb with the exponent {alpha:}, where the
        nominal model has 2"""
    refine = {0: 0.0}
    size = 1.0
    follows = True
    limits = {0: (0.3, 8.0)}
    enters = ("torque",)
    nonlinear = ("alpha", 1.0)

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        total = _fall_change(view, nominal, "omega_sf", shape) * (
            nominal.get("Ms") - nominal.get("Mc")
        )
        if view.loaded:
            rise = view.moment * (nominal.get("mu_s") - nominal.get("mu_c"))
            total = total + _fall_change(view, nominal, "omega_sL", shape) * rise
        return rows(view.sense * total)

    def shapes(self, context: Context) -> Sequence[Shape]:
        usual = context.nominal.alpha
        return [
            (a, float((-np.log(share)) ** (1.0 / usual - 1.0 / a)))
            for a in ALPHAS
            for share in SAME_FALL
        ]

    def absent(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        return {"alpha": context.nominal.alpha}

    def begin(self, nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
        alpha, wider = shape
        values = {n: v * wider if n in SPEEDS else v for n, v in nominal.values.items()}
        return replace(nominal, values=values, fitted_alpha=alpha), (alpha, 1.0)


class FrictionMemory(Effect):
    """Lag of the level of friction, or of the speed on which this level depends."""

    equation = """T dx/dt = u - x; x is the level M_f(omega) of friction less its viscous part, or
        (of_speed = 1) the speed omega that this level follows"""
    implied = "Stribeck friction is static, without memory (eq. 9)"
    coordinate = """time since reversal: loops of friction over speed that widen with the
        acceleration"""
    parameters = (
        Quantity("time_s", Dimension.TIME, 0.0, 0.2),
        Quantity("of_speed", Dimension.NUMBER, 0.0, 1.0),
    )
    look_alikes = ("current_loop_lag", "time_skew", "stribeck_shape", "presliding")
    experiment = """Slow sines of the speed around one Stribeck speed, without reversal, at three
        frequencies; and fast motion without load: friction with memory has loops only where the
        Stribeck curve falls, a lag of the current wherever the current changes."""
    separation = Separation.SLOW
    sentence = """friction responds to a change of speed with a lag of {time_s:ms} (of_speed
        {of_speed:}; 1: friction follows a lagged speed, 0: the friction level lags)"""
    refine = {0: 0.0}
    forms = {1: LEVEL_OR_SPEED}
    size = 1.0
    follows = True
    shape_error = EXACT
    enters = ("torque",)
    nonlinear = ("time_s", "of_speed")
    trials = LAGS

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        time_s, of_speed = shape
        level = dry_level(view, nominal)
        late = (
            dry_level(_with_lagged_speed(view, time_s), nominal)
            if of_speed
            else first_order_lag(level, view.step, time_s)
        )
        if nominal.presliding_stiffness:  # the presliding deflection then has the lag
            start = initial_friction(view, nominal)
            late, level = (
                dahl(view.angle, each, nominal.presliding_stiffness, start)
                for each in (late, level)
            )
            return rows(late - level)
        return rows(view.sense * (late - level))


class DwellStaticFriction(Effect):
    """Static friction that grows with the time at rest.

    A short travel removes the growth, so that friction in motion does not change.
    """

    equation = "Ms(t_rest) = Ms + dM (1 - exp(-t_rest / T))"
    implied = "static friction does not depend on the time at rest (eq. 9)"
    shows_in = "breakaway"
    coordinate = "rest time: breakaway torque rises with the preceding time at rest"
    parameters = (
        Quantity("growth_Nm", Dimension.TORQUE, 0.0, 20.0),
        Quantity("time_s", Dimension.TIME, 0.02, 100.0),
    )
    look_alikes = ("presliding", "backlash", "friction_memory")
    experiment = """Rests of several durations from 0.1 to 8 s, each followed by the same slow rise
        of torque until breakaway, repeated in mixed order."""
    separation = Separation.RESTS
    sentence = """static friction grows by {growth_Nm:N m} at rest, with a time constant of
        {time_s:s}"""
    refine = {0: 0.0}
    enters = ("breakaway",)
    nonlinear = ("time_s",)
    trials = DWELLS_S

    @staticmethod
    def breakaway(view: View, _nominal: Nominal, shape: Shape) -> Array:
        ends = np.concatenate(([False], view.still[:-1] & ~view.still[1:]))
        last_rest = np.maximum(view.rest_time, np.roll(view.rest_time, 1))  # also where it ends
        grown = 1.0 - np.exp(-last_rest / shape[0])
        return rows(view.sense * grown * (view.still | ends))


class Presliding(Effect):
    """Friction that changes its sign gradually over a small travel (Dahl)."""

    equation = "dM_f/dtheta = k (1 - M_f sgn(omega) / M_ss(omega)), M_ss the Stribeck curve (Dahl)"
    implied = "a stuck contact does not move at all (eq. 9)"
    coordinate = "travel since reversal: friction changes its sign gradually over a small travel"
    parameters = (Quantity("stiffness_Nm_rad", Dimension.STIFFNESS, 50.0, 1e6),)
    look_alikes = ("backlash", "dwell_static_friction", "coupling_hysteresis", "friction_memory")
    experiment = """Small loops of torque below breakaway, of two sizes, after short and after long
        rests: with presliding the joint moves like a spring with hysteresis after any rest, a gap
        is crossed without torque, and static friction that grows at rest allows no motion."""
    separation = Separation.SMALL_LOOPS
    sentence = "the contact deforms like a spring of {stiffness_Nm_rad:N m/deg} before it slides"
    refine = {0: 0.0}
    size = 1.0
    follows = True
    shape_error = CLOSE
    enters = ("torque",)
    nonlinear = ("stiffness_Nm_rad",)

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        level = dry_level(view, nominal)
        return rows(
            dahl(view.angle, level, shape[0], initial_friction(view, nominal)) - view.sense * level
        )

    def shapes(self, context: Context) -> Sequence[Shape]:
        if context.nominal.play:  # the contact is elastic over the travel after the play
            return []
        scale = torque_scale(context.views) / travel_scale(context.views)
        trials = [(float(k * scale),) for k in STIFFNESSES]
        return everywhere(context, lambda view: bool(np.any(reversals(view.sense))), trials)

    def begin(self, nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
        return replace(nominal, presliding_stiffness=shape[0]), shape

    def indistinct(
        self, _parameters: Mapping[str, float], views: Sequence[View]
    ) -> tuple[str, ...]:
        # By the motor's encoder alone, the torque after a reversal rises with the travel of the
        # motor until the joint slips, whether the friction contact, or a shaft or coupling between
        # motor and joint, is elastic.
        channels = [v.recording.channels for v in views]
        one_encoder = all("motor_angle" in c and "angle" not in c for c in channels)
        return ("compliance", "coupling_hysteresis") if one_encoder else ()


class FrictionPlay(Effect):
    """Play between the encoder and a part of friction and inertia: after a reversal this part rests
    until the play is crossed.

    The coefficients are the share of friction and the inertia behind the play.
    """

    equation = """(J - J_s) domega/dt + J_s d(e omega)/dt = i Km I - (1 - s + s e) M_f - M_L; e is 0
        while the play of width g is crossed, else 1"""
    implied = "friction acts as soon as the motion reverses, without clearance (eq. 9)"
    coordinate = """travel since reversal: friction is missing over a fixed travel after each
        reversal, and returns at once"""
    parameters = (
        Quantity("gap_rad", Dimension.ANGLE, 0.0, 1.0),
        Quantity("friction_share", Dimension.NUMBER, 0.0, 1.05),
        Quantity("inertia_kgm2", Dimension.INERTIA, -0.1, 1.0),
    )
    look_alikes = ("backlash", "presliding", "compliance", "coupling_hysteresis")
    experiment = """Slow reversals with encoders on either side of the suspected play: the travel
        over which friction is missing is the difference of their angles. With one encoder, two
        amplitudes show a play by its fixed travel."""
    separation = Separation.SMALL_LOOPS
    sentence = """friction acts only after a play of {gap_rad:deg} at each reversal, with
        {friction_share:%} of the friction and {inertia_kgm2:kg m^2} behind it"""
    refine = {0: 0.0}
    positive = (0,)
    follows = True
    enters = ("torque",)
    nonlinear = ("gap_rad",)

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        lead = play(view.angle, shape[0])
        loose = np.where(lead * view.sense < 0.5 * (1.0 - TOUCHING) * shape[0], 1.0, 0.0)
        # The part behind the play rests, and takes the speed of the rest as a flank meets it.
        missing = central_difference(loose * view.velocity, view.step)
        return rows(-loose * nominal.friction(view), -missing)

    def shapes(self, context: Context) -> Sequence[Shape]:
        if context.nominal.presliding_stiffness or any(v.lag is not None for v in context.views):
            return ()
        travel = max(float(np.ptp(v.angle)) for v in context.views)
        return [(float(share * travel),) for share in PLAY_SHARES]

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        return {
            "gap_rad": shape[0],
            "friction_share": float(c[0]),
            "inertia_kgm2": float(c[1]),
        }

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (values["gap_rad"],), (values["friction_share"], values["inertia_kgm2"])

    def feeds_back(self, nominal: Nominal, shape: Shape, _coefficients: Coefficients) -> Nominal:
        return replace(nominal, play=shape[0])

    def indistinct(
        self, _parameters: Mapping[str, float], _views: Sequence[View]
    ) -> tuple[str, ...]:
        # With one encoder, a gap between motor and joint has this form.
        return ("backlash",)


class PositionDependentFriction(Effect):
    """Friction of a worn patch."""

    equation = "Mc, Ms -> + d exp(-((theta - theta_0) / w)^2 / 2)"
    implied = "friction is the same everywhere on the travel (eq. 9)"
    coordinate = "angle: in one range of the travel, against the motion in both directions"
    parameters = (
        Quantity("torque_Nm", Dimension.TORQUE, -10.0, 20.0),
        Quantity("center_rad", Dimension.ANGLE, -pi, pi),
        Quantity("width_rad", Dimension.ANGLE, 0.005, 1.0),
    )
    look_alikes = ("end_stop", "gravity_imbalance", "load_position_dependence", "cogging")
    experiment = """Slow passes over the whole travel in both directions, without and with load:
        friction changes its sign with the direction, the torque of a spring, a stop or gravity does
        not; the friction of a worn patch of the bearing remains without load."""
    separation = Separation.TRAVEL
    sentence = """friction is {torque_Nm:abs N m} {torque_Nm:?higher/lower} around {center_rad:deg},
        over a width of {width_rad:deg}"""
    refine = {0: 0.1, 1: 0.0}
    at_angle = True
    shape_error = CLOSE
    nonlinear = ("center_rad", "width_rad")
    needs = frozenset({Needs.COMMON_ZERO})

    @staticmethod
    def torque(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return rows(view.sense * np.exp(-0.5 * ((view.angle - shape[0]) / shape[1]) ** 2))

    def shapes(self, context: Context) -> Sequence[Shape]:
        low = min(float(np.min(v.angle)) for v in context.views)
        high = max(float(np.max(v.angle)) for v in context.views)
        centres = np.linspace(low, high, PATCH_CENTRES + 2)[1:-1]
        return [(float(c), w * (high - low)) for c in centres for w in PATCH_WIDTHS]


class ViscousThermalDrift(Effect):
    """Viscous friction that falls with running time."""

    equation = "sigma_2(t) = sigma_2 (1 - f (1 - exp(-t_run / T)))"
    implied = "friction is the same at any temperature (eq. 9)"
    coordinate = """temperature: viscous friction falls with rising temperature, or with running
        time; zero at low speed"""
    parameters = (
        Quantity("fraction", Dimension.NUMBER, 0.0, 0.9),
        Quantity("time_s", Dimension.TIME, 1.0, 5000.0),
    )
    look_alikes = ("coulomb_drift", "winding_heating", "current_drift")
    experiment = """A slow and a fast speed, each cold and hot, with voltage and current logged: a
        drift of viscous friction shows at the fast speed only, a drift of Coulomb friction equally
        at both speeds, a hot winding in the voltage."""
    separation = Separation.SESSION
    sentence = """viscous friction falls by {fraction:%} as the bench runs warm, with a time
        constant of {time_s:s}"""
    refine = {0: 0.0}
    shape_error = EXACT
    start = {"torque": _viscous_start, "breakaway": _viscous_start}

    @staticmethod
    def torque(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return rows(view.velocity * (1.0 - _left_of_the_start(view, shape)))

    def shapes(self, context: Context) -> Sequence[Shape]:
        return WARM_UPS_S if context.nominal.get("sigma_2") > 0.0 else ()

    def read(self, c: Array, shape: Shape, context: Context) -> Mapping[str, float]:
        viscous = max(context.nominal.get("sigma_2"), 1e-300)
        return {"fraction": -float(c[0]) / viscous, "time_s": shape[0]}

    def at(self, values: Mapping[str, float], nominal: Nominal) -> tuple[Shape, Coefficients]:
        return (values["time_s"],), (-values["fraction"] * nominal.get("sigma_2"),)


class CoulombDrift(Effect):
    """Coulomb and static friction that change with running time."""

    equation = "Mc(t) = Mc + r T (1 - exp(-t_run / T)), Ms alike; r t_run where T is long"
    implied = "friction does not change from one recording to the next (eq. 9)"
    coordinate = """time: against the motion in both directions and at any speed, changing from
        recording to recording"""
    parameters = (
        Quantity("rate_Nm_s", Dimension.TORQUE_RATE, -1.0, 1.0),
        Quantity("time_s", Dimension.TIME, 1.0, STEADY_S),
    )
    look_alikes = ("viscous_thermal_drift", "winding_heating", "current_drift")
    experiment = """One recording repeated at the start, in the middle and at the end of a session,
        at two speeds in both directions: a drift of Coulomb friction changes its sign with the
        direction, a drift of the current's zero does not."""
    separation = Separation.SESSION
    sentence = """Coulomb friction {rate_Nm_s:?rises/falls} by {rate_Nm_s:abs N m/h} of running at
        first, levelling off with a time constant of {time_s:s}"""
    refine = {0: 0.0}
    limits = {0: (1.0, STEADY_S)}
    shape_error = EXACT
    nonlinear = ("time_s",)
    trials = (*WARM_UPS_S, (STEADY_S,))
    start = {"torque": _coulomb_start, "breakaway": _coulomb_start}

    @staticmethod
    def torque(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return rows(-view.sense * shape[0] * np.expm1(-view.run_time / shape[0]))
