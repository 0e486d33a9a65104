"""Effects of the sensors: sampling instants, zeros and mounting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np

from identification.effects.effect import (
    EXACT,
    Coefficients,
    Context,
    Dimension,
    Effect,
    Needs,
    Quantity,
    Separation,
    Shape,
    rows,
)
from identification.effects.motor import CurrentLoopLag, has_current
from identification.effects.transmission import Backlash, both_encoders
from identification.numerics.series import delayed_series, sine_cosine
from identification.recording import Array
from identification.signals import central_difference
from identification.views.nominal import Nominal
from identification.views.view import View, lacks_common_origin

DELAYS_S: tuple[Shape, ...] = tuple((float(t),) for t in np.geomspace(2e-4, 0.05, 9))
SKEWS_S: tuple[Shape, ...] = tuple(
    (side * t,) for t in (5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016) for side in (-1.0, 1.0)
)
WITH_VOLTAGE = (1.0,)
"""Last nonlinear parameter of a time skew if the voltage is sampled together with the current.
"""
RIPPLES_PER_TURN = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32, 64)
"""Trial cycles of an encoder's ripple per turn of its shaft: eccentricity, poles, interpolation."""
SLIPS_PER_RECORDING = 12
ZEROED_S = (0.0, 2.0)
"""Limits of the time from the zeroing of the current sensor to the start of a recording, s, during
which power comes on and loops settle.
"""


def _drift(view: View, shape: Shape) -> Array:
    """Return the time since the zero of the current sensor was taken, before the recording, s."""
    return np.asarray(view.time - view.time[0] + shape[0])


def _current_offset(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(np.full(len(view.time), view.recording.bench.ampere_torque))


def _current_offset_voltage(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(np.full(len(view.time), -(view.recording.bench.resistance or 0.0)))


class TimeSkew(Effect):
    """Current that was sampled before or after the angles.

    The nonlinear parameters are the time, and 1 if the voltage is sampled together with the current
    (the angles are then late), else 0.
    """

    equation = """I_logged(t) = I(t - T), angles at t; where U was computed from angles by the
        controller's law: U_logged(t) = U of command(t), U = that of command(t + T)"""
    implied = "all channels are sampled at the same instant"
    shows_in = "voltage"
    coordinate = """torque rate: proportional to the rate of change of the current, at any load and
        in both directions; without a measured voltage, in the torque equation"""
    parameters = (Quantity("time_s", Dimension.TIME, -0.05, 0.05),)
    look_alikes = ("current_loop_lag", "friction_memory", "transport_delay")
    experiment = CurrentLoopLag.experiment
    separation = Separation.FREQUENCIES
    not_simulated = "a shift between the time stamps of channels, which no machine has"
    sentence = """the {channel} is sampled {time_s:abs ms} {time_s:?before/after} the angles that
        carry its time stamp"""
    refine = {0: 2e-3}
    size = 1.0
    follows = True
    enters = ("torque", "voltage")
    nonlinear = ("time_s", 0.0)
    on_drive = True
    # The parameters of the catalogue do not state whether the voltage has the skew.
    modelled = ("torque",)

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        if view.voltage_is_computed:
            return rows(view.command_delay_error(-shape[0]))
        torque = nominal.drive(view)
        return rows(delayed_series(torque, view.step, shape[0]) - torque)

    @staticmethod
    def voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
        bench = view.recording.bench
        assert view.current is not None
        if shape[1:] == WITH_VOLTAGE:
            speed = view.motor_speed
            return rows(
                (bench.back_emf_constant or 0.0)
                * (delayed_series(speed, view.step, shape[0]) - speed)
            )
        change = delayed_series(view.current, view.step, -shape[0]) - view.current
        return rows(
            (bench.resistance or 0.0) * change
            + (bench.inductance or 0.0) * central_difference(change, view.step)
        )

    def shapes(self, context: Context) -> Sequence[Shape]:
        alone = [(*shape, 0.0) for shape in SKEWS_S]
        if all(v.voltage is None for v in context.views):
            return alone
        return [*alone, *((*shape, *WITH_VOLTAGE) for shape in SKEWS_S)]

    def begin(self, nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
        return replace(nominal, late_s=shape[0]), shape


class TransportDelay(Effect):
    """Delay of the angle of the joint encoder."""

    equation = "theta_logged(t) = theta(t - T), phi_logged(t) = phi(t)"
    implied = "both angles are sampled at the same instant"
    shows_in = "transmission"
    coordinate = """speed: the difference of the angles of motor and joint is proportional to the
        speed, and zero at rest"""
    parameters = (Quantity("time_s", Dimension.TIME, 0.0, 0.1),)
    look_alikes = ("backlash", "compliance", "time_skew")
    experiment = Backlash.experiment
    separation = Separation.LOADS_AND_SPEEDS
    not_simulated = "a delay of the reading of the joint's encoder, not of the joint"
    sentence = "the joint's encoder reports the angle of the joint {time_s:ms} ago"
    refine = {0: 0.0}
    size = 1.0
    shape_error = EXACT
    enters: tuple[str, ...] = ("transmission",)
    nonlinear = ("time_s",)
    trials = DELAYS_S
    shown_by = staticmethod(both_encoders)

    @staticmethod
    def transmission(view: View, _nominal: Nominal, shape: Shape) -> Array:
        # Speed times delay is not accurate enough: if the speed changes within the delay, the error
        # of this product is far above the noise of the encoders.
        logged = view.drive_angle - (0.0 if view.lag is None else view.lag)
        return rows(delayed_series(logged, view.step, -shape[0]) - logged)

    def on_the_joint(self) -> Effect:
        return _DelayOfFriction()


class _DelayOfFriction(TransportDelay):
    """Delay of the joint encoder where torques are computed with its motion: the friction in the
    torque equation has the delay too.

    If the friction were not delayed, the torque would lead the delayed angles, as it does with a
    lag of the current.
    """

    enters = ("transmission", "torque")
    follows = True

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        torque = nominal.drive(view)
        return rows(delayed_series(torque, view.step, -shape[0]) - torque)


class CurrentOffset(Effect):
    """Zero of the current sensor that is wrong."""

    equation = "I_logged = I + I_0"
    implied = "the current's zero is right"
    coordinate = """direction: one constant torque in motion and at rest, at any speed, angle and
        load"""
    parameters = (Quantity("current_A", Dimension.CURRENT, -5.0, 5.0),)
    look_alikes = ("asymmetric_coulomb", "constant_torque", "gravity_imbalance", "current_drift")
    experiment = """The logged current with the power stage off, while holding at rest after
        approaches from either side, and during full turns: an offset is the same in all these
        cases."""
    separation = Separation.HOLD
    sentence = "the current reads {current_A:abs mA} too {current_A:?high/low}"
    shape_error = EXACT
    enters = ("torque", "breakaway", "voltage")
    shown_by = staticmethod(has_current)
    on_drive = True
    torque = staticmethod(_current_offset)
    voltage = staticmethod(_current_offset_voltage)

    def feeds_back(self, nominal: Nominal, _shape: Shape, coefficients: Coefficients) -> Nominal:
        return replace(nominal, zero_A=nominal.zero_A + coefficients[0])


class CurrentDrift(Effect):
    """Zero of the current sensor that drifts within a recording; the nonlinear parameter is the
    time from its zeroing to the start of the recording.
    """

    equation = """I_logged = I + r (t + t_0), t since the recording's start, t_0 since the zero was
        taken before it"""
    implied = "the current's zero does not change"
    coordinate = """time: a torque that grows from the start of each recording, the same in both
        directions and at rest"""
    parameters = (Quantity("rate_A_s", Dimension.CURRENT_RATE, -0.1, 0.1),)
    look_alikes = ("coulomb_drift", "viscous_thermal_drift", "current_offset", "winding_heating")
    experiment = """The logged current with the power stage off before and after a long recording,
        with slow motion in both directions between: a drift of the zero keeps its sign, a drift of
        friction changes its sign with the direction."""
    separation = Separation.SESSION
    sentence = """the current's zero {rate_A_s:?rises/falls} by {rate_A_s:abs mA/min} within a
        recording"""
    refine = {0: 0.5 * ZEROED_S[1]}
    limits = {0: ZEROED_S}
    shape_error = EXACT
    enters = ("torque", "breakaway", "voltage")
    nonlinear = (0.0,)
    trials = ((0.5 * ZEROED_S[1],),)
    shown_by = staticmethod(has_current)
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        return _current_offset(view, nominal, shape) * _drift(view, shape)

    @staticmethod
    def voltage(view: View, nominal: Nominal, shape: Shape) -> Array:
        return _current_offset_voltage(view, nominal, shape) * _drift(view, shape)


class EncoderEccentricity(Effect):
    """Encoder of the joint that sits off centre."""

    equation = "theta_logged = theta + A sin(theta + p)"
    implied = "the joint's encoder is centred on its shaft"
    shows_in = "transmission"
    coordinate = """angle: one period per joint turn, the same in both directions and at any speed
        and load"""
    parameters = (
        Quantity("amplitude_rad", Dimension.ANGLE, 0.0, 0.1),
        Quantity("phase_rad", Dimension.PHASE, -pi, pi),
    )
    look_alikes = ("gear_mesh_ripple", "compliance", "gravity_imbalance")
    experiment = """Slow motion over the widest travel in both directions, repeated after the
        encoder was turned on its shaft: this changes the phase of an eccentricity of the encoder,
        but not the phase of an error of the gear or of a load."""
    sentence = """the joint's encoder sits off centre and reads up to {amplitude_rad:deg} wrong,
        once per turn (phase {phase_rad:deg})"""
    shape_error = EXACT
    enters = ("transmission",)
    polar = ("amplitude_rad", "phase_rad")
    shown_by = staticmethod(both_encoders)
    needs = frozenset({Needs.JOINT_TURN})

    def shows_a_period(self, views: Sequence[View]) -> bool:
        return max(float(np.ptp(v.angle)) for v in views) >= 2.0 * pi

    @staticmethod
    def transmission(view: View, _nominal: Nominal, _shape: Shape) -> Array:
        return rows(-np.sin(view.angle), -np.cos(view.angle))


class EncoderRipple(Effect):
    """Reading of the only encoder that swings within each turn of its shaft."""

    equation = "phi_logged = phi + A sin(n phi + p), phi the angle of the encoder's shaft"
    implied = "the encoder reads the angle of its shaft"
    coordinate = """speed: periodic in the encoder's angle, with an amplitude proportional to the
        square of the speed; zero in slow motion"""
    parameters = (
        Quantity("amplitude_rad", Dimension.PHASE, 0.0, 0.3),
        Quantity("per_turn", Dimension.CYCLES, 1.0, 64.0),
        Quantity("phase_rad", Dimension.PHASE, -pi, pi),
        Quantity("at_motor", Dimension.NUMBER, 0.0, 1.0),
    )
    look_alikes = ("cogging", "torque_ripple", "gear_mesh_ripple")
    experiment = """Steady turns at three speeds without load: the torque of cogging is the same at
        any speed, an error of the reading needs none in slow motion and grows with the square of
        the speed."""
    separation = Separation.SPEEDS
    sentence = """the reading of the encoder ({at_motor:}; 1: at the motor, 0: at the joint) swings
        by {amplitude_rad:deg} of its shaft, {per_turn:} times per turn (phase {phase_rad:deg})"""
    follows = True
    fast = True
    enters = ("torque",)
    nonlinear = ("per_turn", "at_motor")
    polar = ("amplitude_rad", "phase_rad")

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        cycles, at_motor = shape
        gear = view.recording.bench.gear_ratio if at_motor else 1.0
        wave = sine_cosine(cycles, view.motor if at_motor else view.angle) / gear
        damping = nominal.get("sigma_2") + nominal.get("mu_2") * view.moment
        out = []
        for error in wave:
            speed = central_difference(error, view.step)
            out.append(nominal.get("J") * central_difference(speed, view.step) + damping * speed)
        return -rows(*out)

    def shapes(self, context: Context) -> Sequence[Shape]:
        views = context.views
        if context.nominal.get("J") <= 0.0 or lacks_common_origin(views):
            return []
        if any(v.lag is not None for v in views):
            return []
        at_motor = all("motor_angle" in v.recording.channels for v in views)
        turns = max(float(np.ptp(v.motor if at_motor else v.angle)) for v in views) / (2.0 * pi)
        return [(float(n), float(at_motor)) for n in RIPPLES_PER_TURN if n * turns >= 1.0]


class EncoderSlip(Effect):
    """Single slip of the joint encoder in one recording."""

    equation = "theta_logged = theta + a for t > t_0, in one recording and those after it"
    implied = "the joint's encoder is fixed to its shaft"
    shows_in = "transmission"
    coordinate = "time: one lasting step of the difference of motor and joint angle"
    parameters = (
        Quantity("angle_rad", Dimension.ANGLE, -1.0, 1.0),
        Quantity("at_s", Dimension.TIME, 0.0, 1e5),
    )
    look_alikes = ("backlash", "coupling_hysteresis")
    experiment = """The start position approached from the same side before and after the recording:
        after a slip the readings of the joint encoder differ, after the crossing of a gap they are
        equal."""
    not_simulated = "one slip in one recording, not a property of the machine"
    sentence = """the joint's encoder slipped on its shaft by {angle_rad:deg}, {at_s:s} into
        {recordings}"""
    place = 0
    refine = {1: 3.0}
    shape_error = EXACT
    enters = ("transmission",)
    nonlinear = ("recording", "at_s")

    @staticmethod
    def transmission(view: View, _nominal: Nominal, shape: Shape) -> Array:
        here = view.index == round(shape[0])
        return rows(np.where(here & (view.time - view.time[0] >= shape[1]), -1.0, 0.0))

    def shapes(self, context: Context) -> Sequence[Shape]:
        shapes: list[Shape] = []
        for view in context.views:
            if view.lag is not None:
                length = float(view.time[-1] - view.time[0])
                times = np.linspace(0.0, length, SLIPS_PER_RECORDING + 2)[1:-1]
                shapes += [(float(view.index), float(t)) for t in times]
        return shapes
