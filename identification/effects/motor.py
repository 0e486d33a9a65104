"""Effects of the motor and its electronics: torque other than Km I, and voltage other than R I + Ke
omega (eq. 1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import pi
from typing import Any

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
    everywhere,
    of_each_recording,
    polar,
    rows,
)
from identification.numerics.series import sine_cosine, temperature_rise
from identification.recording import Array
from identification.signals import central_difference, resample, values_at_ends
from identification.views.nominal import Nominal
from identification.views.view import View, lacks_common_origin, recent

COPPER_PER_K = 0.00393
"""Temperature coefficient of the resistance of a copper winding, 1/K."""
MAGNET_PER_K = 0.001
"""Relative loss of the torque constant with temperature, 1/K (ferrite to neodymium: 0.001 to
0.002).
"""
CYCLES_PER_TURN: tuple[Shape, ...] = tuple((float(n),) for n in range(1, 49))
LEAST_GAIN = 0.5
"""Least ratio of the torque of a motor with ripple to its mean torque at the same current."""
KNEES = (1.1, 1.4, 1.8, 2.5, 4.0)
"""Trial knee currents of a torque that saturates, relative to the greatest current."""
STRAY_SHARES = (0.01, 0.04, 0.15)
"""Trial shares of the torque that a stray loss takes at the greatest power."""
TANH_OR_RATIONAL = (0.0, 1.0)
"""Laws of saturation: a hyperbolic tangent (0), or a rational function (1)."""
WITH_MAGNETS = (1.0, 0.0)
"""Whether the magnets heat with the winding (1), or only the winding heats (0)."""
THERMAL_TIMES_S = (15.0, 40.0, 100.0, 250.0, 600.0)
STEP_SHARES = (0.001, 0.03)
"""Limits of the range of current over which a dead-time step is smeared, relative to the greatest
current.

Near zero a noisy sample does not determine the sign of the current, and during the step the winding
has no current.
"""
ROUNDED_SHARES = (0.03, 1.0)
"""Limits of the range of current over which a brush drop is reached, relative to the greatest
current; over a smaller range a brush drop resembles a dead time.
"""
SHARP_A = 1e-9
"""Range of current over which a dead-time step of given voltage is reached, A."""
LEAST_CROSSINGS = 12
"""Least number of passages of the current through zero from which the change of the current in a
passage is computed.
"""
FORGOTTEN = 20.0  # time constants after which a winding has lost its heat
GREATEST_QUANTILE = 0.99
"""Quantile of the magnitude of the current that counts as the greatest current, so that spikes are
ignored.
"""


def _gain(view: View, nominal: Nominal) -> Array:
    """Return the ratio of the motor's torque to its mean torque at the same current, by the ripple
    identified so far.

    The ratio is 1 if each recording has its own origin of angles: in a validation recording the
    phase is then unknown, and regressors that contain the torque divided by this ratio would be
    wrong.
    """
    if not nominal.ripple or len(nominal.ripple[0]) > 1:
        return np.ones(len(view.time))
    shape, coefficients = nominal.ripple
    wave = sine_cosine(shape[0], view.motor)
    return np.asarray(np.maximum(1.0 + np.array(coefficients) @ wave, LEAST_GAIN))


def _by_origin(view: View, shape: Shape, wave: Array) -> Array:
    """Return the two columns of a wave, for each recording if each has its own origin."""
    return wave if len(shape) == 1 else of_each_recording(view, round(shape[1]), wave)


def _waves(context: Context) -> Sequence[Shape]:
    """Return trial cycles per motor turn and, without a common origin, the number of recordings.

    A wave of which no recording contains a period is none: within a part of its period, any smooth
    torque over the angle resembles it.
    """
    turns = max(float(np.ptp(v.motor)) for v in context.views) / (2.0 * pi)
    whole = [shape for shape in CYCLES_PER_TURN if shape[0] * turns >= 1.0]
    if lacks_common_origin(context.views):
        return [(*shape, float(len(context.views))) for shape in whole]
    return whole


@recent
def _loss(view: View) -> Array:
    """Return the heat loss of the winding, W: electrical less mechanical power, I (U - Ke omega).

    Without a voltage, the loss is R I^2, which omits the rise of R, for copper 0.39 % per K.
    """
    assert view.current is not None
    bench = view.recording.bench
    cold = (bench.resistance or 0.0) * view.current**2
    if view.voltage is None or bench.back_emf_constant is None:
        return np.asarray(cold)
    taken = view.current * (view.voltage - bench.back_emf_constant * view.motor_speed)
    return np.where(np.isnan(taken), cold, taken)


@recent
def _rises(view: View, time_constant: float) -> Array:
    """Return the winding's rise over thermal resistance, and the rest of an initial 1 K, (2, m)."""
    return temperature_rise(_loss(view), view.run_time, time_constant)


def _warmth(view: View, magnet: float) -> Array:
    """Return the change of the voltage by 1 K in winding and, with ``magnet`` 1, magnets, V."""
    assert view.current is not None
    resistance = view.recording.bench.resistance or 0.0
    warmer = COPPER_PER_K * resistance * view.current
    # Torque and back-EMF are both proportional to the flux of the magnets, which falls with
    # temperature.
    weaker = (
        magnet * MAGNET_PER_K * (view.recording.bench.back_emf_constant or 0.0) * view.motor_speed
    )
    return np.asarray(warmer - weaker)


def has_current(view: View) -> bool:
    """Whether a recording has a current channel, and its bench a torque constant."""
    return view.current is not None and view.recording.bench.torque_constant is not None


def mean_over_sample(
    view: View,
    zero_A: float,
    antiderivative: Callable[[Array], Array],
    function: Callable[[Array], Array],
) -> Array:
    """Return the mean of a function of the current over each sample's period, for a current that is
    linear in time.

    The mean is needed because the current may change by more than I_b within one period when it
    reverses. ``zero_A`` is the reading at zero current. The function is applied to the logged
    samples, and its result is resampled like the voltage, because interpolation of the current
    would widen the step.
    """
    recording = view.recording
    current = recording.channels["current"] - zero_A
    ends = 0.5 * (current[1:] + current[:-1])
    before, after = np.concatenate((current[:1], ends)), np.concatenate((ends, current[-1:]))
    change = after - before
    small = np.abs(change) < 1e-9
    mean = (antiderivative(after) - antiderivative(before)) / np.where(small, 1.0, change)
    values = np.where(small, function(current), mean)
    if "current" in recording.averaged:
        values = values_at_ends(recording.time, values, recording.period)
    return resample(recording.time, values, view.time)


def drop(view: View, _nominal: Nominal, shape: Shape) -> Array:
    """Return the regressor of a drop with the sign of the current: tanh(I / I_b), dimensionless,
    shape (1, n).

    Args:
        view: The recording.
        shape: I_b relative to the greatest current; the reading at zero current, A; the greatest
            current, A.
    """
    share, zero_A, greatest_A = shape
    knee = share * greatest_A

    def log_cosh(current: Array) -> Array:
        size = np.abs(current) / knee
        return np.asarray(knee * (size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)))

    return rows(
        mean_over_sample(
            view, zero_A, log_cosh, lambda current: np.asarray(np.tanh(current / knee))
        )
    )


def change_at_zero(views: Sequence[View]) -> float:
    """Return the change of the current from one sample to the next during a passage through zero,
    A: the greatest change in each passage, and of these the median over the passages of all
    recordings; 0 with fewer than :data:`LEAST_CROSSINGS` passages.

    A step of the voltage over a smaller range of current is smeared over a sample period. In a
    passage the current changes its sign, from a magnitude beyond the current of a dead-time step to
    a magnitude beyond it, so that noise around zero at rest is no passage.
    """
    currents = [v.current for v in views if v.current is not None]
    if not currents:
        return 0.0
    greatest_A = float(np.nanquantile(np.abs(np.concatenate(currents)), GREATEST_QUANTILE))
    changes: list[float] = []
    for current in currents:
        places = np.flatnonzero(np.abs(current) > STEP_SHARES[1] * greatest_A)
        beyond = current[places]
        passed = beyond[1:] * beyond[:-1] < 0.0
        steps = np.abs(np.diff(current))
        changes += [float(np.max(steps[places[k] : places[k + 1]])) for k in np.flatnonzero(passed)]
    return float(np.median(changes)) if len(changes) >= LEAST_CROSSINGS else 0.0


def has_voltage(view: View) -> bool:
    """Whether a recording has current and voltage, and its bench a torque constant."""
    return has_current(view) and view.voltage is not None


def _by_recording(view: View, shape: Shape, rises: Array) -> Array:
    """Return the regressors of :func:`_rises`, with one regressor for the initial temperature of
    each recording, shape (1 + recordings, m); without recordings the initial temperature is that
    left by the losses of earlier recordings, shape (1, m).
    """
    count = round(shape[1])
    if count:
        return np.concatenate([rises[:1], of_each_recording(view, count, rises[1:])])
    return np.asarray(rises[:1] + _rise_before(view, shape[0]) * rises[1:])


def _rise_before(view: View, time_constant: float) -> Any:
    """Return the winding's rise over thermal resistance at the start of a recording, W: what is
    left of the losses in the recordings before it, between which the power was off. Before the
    first one of all, the mean loss since the zero of the running time counts; after a pause in
    which the winding cools completely, the rise is zero.
    """
    chain = [view]
    while (before := chain[-1].before) is not None:
        if view.run_time[0] - before.run_time[-1] > FORGOTTEN * time_constant:
            break
        chain.append(before)
    first = chain[-1]
    rise = 0.0
    if first.before is None:
        rise = np.mean(_loss(first)) * (1.0 - np.exp(-first.run_time[0] / time_constant))
    for k in range(len(chain) - 1, 0, -1):
        gained, kept = _rises(chain[k], time_constant)[:, -1]
        pause = chain[k - 1].run_time[0] - chain[k].run_time[-1]
        rise = (gained + kept * rise) * np.exp(-pause / time_constant)
    return rise


def _warm_start_voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(_warmth(view, shape[2]) * _rises(view, shape[0])[1])


def _warm_start_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    return rows(shape[2] * MAGNET_PER_K * nominal.drive(view) * _rises(view, shape[0])[1])


class _Wave(Effect):
    """Torque that is periodic in the motor's angle."""

    enters = ("torque",)
    nonlinear = ("per_motor_turn",)
    on_drive = True
    fast = True
    needs = frozenset({Needs.MOTOR_TURN})
    at_angle = True

    def shapes(self, context: Context) -> Sequence[Shape]:
        return _waves(context)

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        waves = [
            polar(float(sine), float(cosine)) for sine, cosine in zip(c[::2], c[1::2], strict=True)
        ]
        amplitude = float(np.median([amplitude for amplitude, _ in waves]))
        return {
            self.parameters[0].name: amplitude,
            "per_motor_turn": shape[0],
            "phase_rad": waves[0][1],
        }


class _Drop(Effect):
    """Voltage that is lost with the sign of the current: the nonlinear parameters are the range of
    current over which the drop is reached, relative to the greatest current; the reading of the
    current at zero current, A; the greatest current, A.
    """

    enters = ("voltage",)
    linear = "voltage_V"
    refine = {0: 0.0}
    positive = (0,)
    shares: tuple[float, ...]
    voltage = staticmethod(drop)

    def shapes(self, context: Context) -> Sequence[Shape]:
        currents = [np.abs(v.current) for v in context.views if v.current is not None]
        if not currents:
            return ()
        greatest_A = float(np.nanquantile(np.concatenate(currents), GREATEST_QUANTILE))
        zero_A = context.nominal.zero_A
        return everywhere(
            context, has_voltage, [(share, zero_A, greatest_A) for share in self.shares]
        )

    def begin(self, nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
        # The drop has the sign of the true current: the offset of the current sensor may exceed the
        # range of the step.
        return nominal, (shape[0], nominal.zero_A, *shape[2:])


class Cogging(_Wave):
    """Torque without current, periodic in the motor's angle."""

    equation = "J domega/dt = i Km I + A sin(n phi + p) - M_f - M_L"
    implied = "the motor's torque is Km I, and none without current (eq. 1)"
    coordinate = """motor angle: periodic in the motor's angle, with the same amplitude at any
        current and load"""
    parameters = (
        Quantity("torque_Nm", Dimension.TORQUE, 0.0, 20.0),
        Quantity("per_motor_turn", Dimension.CYCLES, 1.0, 200.0),
        Quantity("phase_rad", Dimension.PHASE, -pi, pi),
    )
    look_alikes = ("torque_ripple", "gear_mesh_ripple", "encoder_eccentricity")
    experiment = """One slow turn without load and under two weights: the torque of cogging is
        constant, that of ripple grows with the current."""
    separation = Separation.LOADS
    sentence = """a torque of {torque_Nm:N m} swings {per_motor_turn:} times per motor turn whatever
        the current (phase {phase_rad:deg})"""
    shape_error = EXACT
    polar = ("torque_Nm", "phase_rad")

    @staticmethod
    def torque(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return _by_origin(view, shape, -sine_cosine(shape[0], view.motor))

    def shapes(self, context: Context) -> Sequence[Shape]:
        # A wave with one cycle per turn of the joint is the torque of a weight that turns with the
        # joint.
        gear = context.views[0].recording.bench.gear_ratio
        return [shape for shape in _waves(context) if len(shape) > 1 or shape[0] * gear != 1.0]


class TorqueRipple(_Wave):
    """Torque constant that is periodic in the motor's angle."""

    equation = "J domega/dt = i Km I (1 + f sin(n phi + p)) - M_f - M_L"
    implied = "the torque constant Km is constant over a turn (eq. 1)"
    coordinate = """motor angle: periodic in the motor's angle, with an amplitude proportional to
        the current"""
    parameters = (
        Quantity("fraction", Dimension.NUMBER, 0.0, 0.5),
        Quantity("per_motor_turn", Dimension.CYCLES, 1.0, 200.0),
        Quantity("phase_rad", Dimension.PHASE, -pi, pi),
    )
    look_alikes = ("cogging", "gear_mesh_ripple", "encoder_eccentricity")
    experiment = Cogging.experiment
    separation = Separation.LOADS
    sentence = """the motor's torque per ampere swings by {fraction:%} of itself, {per_motor_turn:}
        times per motor turn (phase {phase_rad:deg})"""
    follows = True
    polar = ("fraction", "phase_rad")

    # The torque of the mean torque constant is the required torque divided by one plus the ripple.
    # If the divisor does not contain the ripple identified so far, the square of the ripple
    # remains, which is a hundredth for a ripple of 12 %.
    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        wave = _by_origin(view, shape, sine_cosine(shape[0], view.motor))
        return np.asarray(wave * (-nominal.drive(view) / _gain(view, nominal)))

    def feeds_back(self, nominal: Nominal, shape: Shape, coefficients: Coefficients) -> Nominal:
        return replace(nominal, ripple=(shape, coefficients))


class TorqueSaturation(Effect):
    """Torque that grows less than in proportion to the current."""

    equation = """J domega/dt = i Km I_k tanh(I / I_k) - M_f - M_L, or (rational = 1) i Km I / (1 +
        (I / I_k)^2) - M_f - M_L"""
    implied = "torque is proportional to current at any current (eq. 1)"
    coordinate = "torque: grows as the cube of the current, zero at small currents"
    parameters = (
        Quantity("knee_A", Dimension.CURRENT, 2.0, 500.0),
        Quantity("rational", Dimension.NUMBER, 0.0, 1.0),
    )
    look_alikes = ("load_exponent", "stray_loss", "transmission_efficiency", "winding_heating")
    experiment = """High currents without load, by the greatest accelerations that the limits allow,
        and high currents under load: saturation depends on the current, load friction on the
        weight."""
    separation = Separation.LOADS
    sentence = """torque per ampere falls as the current rises, with a knee at {knee_A:A} (rational
        {rational:}; 0: I_k tanh(I / I_k), 1: I / (1 + (I / I_k)^2) in place of I)"""
    refine = {0: 0.0}
    forms = {1: TANH_OR_RATIONAL}
    size = 1.0
    follows = True
    nonlinear = ("knee_A", "rational")
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        """Return the torque, without saturation, of the additional current that saturation
        requires.

        With saturation the torque is Km I_k tanh(I / I_k), or (rational) Km I / (1 + (I / I_k)^2),
        which cannot exceed half of Km I_k.
        """
        knee, rational = shape
        gain = view.recording.bench.ampere_torque
        share = nominal.drive(view) / (gain * knee)
        if rational:
            share = np.clip(share, -0.4999, 0.4999)
            needed = 2.0 * share / (1.0 + np.sqrt(1.0 - 4.0 * share**2))
        else:
            share = np.clip(share, -0.999, 0.999)
            needed = np.arctanh(share)
        return rows(gain * knee * (needed - share))

    def shapes(self, context: Context) -> Sequence[Shape]:
        if not any(has_current(v) for v in context.views):
            return ()
        greatest = max(
            float(np.max(np.abs(context.nominal.drive(v)))) / v.recording.bench.ampere_torque
            for v in context.views
        )
        return [(k * greatest, rational) for rational in TANH_OR_RATIONAL for k in KNEES]


class StrayLoss(Effect):
    """Drag of the motor in proportion to its speed and the square of its current, as of eddy
    currents in iron and conductors.
    """

    equation = "J domega/dt = i Km I - c I^2 omega - M_f - M_L"
    implied = "the motor's torque is Km I at any speed (eq. 1)"
    coordinate = """speed: a drag in proportion to the speed and the square of the current, zero at
        rest and without load"""
    parameters = (Quantity("coefficient_Nms_A2rad", Dimension.STRAY, 0.0, 0.5),)
    look_alikes = ("torque_saturation", "transmission_efficiency", "quadratic_drag")
    experiment = """The same two currents at two speeds, by two loads: a stray loss grows with the
        speed, saturation is the same at any speed; drag of the joint is the same at any current."""
    separation = Separation.LOADS_AND_SPEEDS
    sentence = """the motor loses {coefficient_Nms_A2rad:N m s/(A^2 rad)} times the square of its
        current times the joint's speed of its torque, as by eddy currents"""
    refine = {0: 0.0}
    limits = {0: (0.0, np.inf)}
    size = 1.0
    follows = True
    nonlinear = ("coefficient_Nms_A2rad",)
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        """Return the torque, without loss, of the additional current that the loss requires: I of
        k I - c omega I^2 = M, k the torque per ampere.
        """
        gain, torque = view.recording.bench.ampere_torque, nominal.drive(view)
        share = 4.0 * shape[0] * view.velocity * torque / gain**2
        needed = 2.0 / (1.0 + np.sqrt(1.0 - np.minimum(share, 0.99)))
        return rows(torque * (needed - 1.0))

    def shapes(self, context: Context) -> Sequence[Shape]:
        seen = [v for v in context.views if has_current(v)]
        greatest = max(
            (
                float(np.max(np.abs(context.nominal.drive(v) * v.velocity)))
                / v.recording.bench.ampere_torque**2
                for v in seen
            ),
            default=0.0,
        )
        return [(share / greatest,) for share in STRAY_SHARES] if greatest > 0.0 else []


class CurrentLoopLag(Effect):
    """First-order lag of the torque behind the logged current."""

    equation = "J domega/dt = i Km I_true - M_f - M_L, T dI_true/dt = I - I_true"
    implied = "the torque follows the measured current at once (eq. 1)"
    coordinate = """torque rate: grows with the rate of change of the current, most at reversals of
        torque"""
    parameters = (Quantity("time_s", Dimension.TIME, 0.0, 0.05),)
    look_alikes = ("time_skew", "friction_memory", "transport_delay")
    experiment = """Fast sines of two frequencies without load, with command and current on one
        clock, and slow ramps under load: a lag attenuates the torque, and its phase grows less than
        in proportion to the frequency; a time skew is a pure delay."""
    separation = Separation.FREQUENCIES
    sentence = "the motor's torque lags the measured {channel} by {time_s:ms}, first order"
    follows = True
    shape_error = EXACT
    enters = ("torque",)
    shown_by = staticmethod(has_current)
    on_drive = True

    @staticmethod
    def torque(view: View, nominal: Nominal, _shape: Shape) -> Array:
        return rows(central_difference(nominal.drive(view), view.step))


class InverterDeadTime(_Drop):
    """Voltage that the dead time of the inverter takes: a step with the sign of the current."""

    equation = "R I + L dI/dt = U - U_d sgn(I) - Ke dphi/dt"
    implied = "the voltage at the winding is the logged one (eq. 1)"
    shows_in = "voltage"
    coordinate = """current direction: a sharp step with the sign of the current, at any speed, in
        proportion to the supply voltage"""
    parameters = (Quantity("voltage_V", Dimension.VOLTAGE, 0.0, 5.0),)
    look_alikes = ("brush_drop", "winding_heating", "supply_sag")
    experiment = """Small currents through zero, at rest and in motion, at two supply voltages: dead
        time causes a sharp step in proportion to the supply voltage; a brush drop is a rounded step
        that does not depend on the supply voltage."""
    sentence = """the voltage at the winding is {voltage_V:V} less than the logged one, a sharp step
        with the sign of the current"""
    limits = {0: STEP_SHARES}

    shares = (0.005, 0.02)
    nonlinear = (SHARP_A, 0.0, 1.0)


class BrushDrop(_Drop):
    """Voltage that the brushes take: a rounded step with the sign of the current."""

    equation = "R I + L dI/dt = U - U_b tanh(I / I_b) - Ke dphi/dt"
    implied = "voltage falls over R, L and Ke omega alone (eq. 1)"
    shows_in = "voltage"
    coordinate = """current direction: a rounded step with the sign of the current, at any speed and
        supply voltage"""
    parameters = (
        Quantity("voltage_V", Dimension.VOLTAGE, 0.0, 5.0),
        Quantity("current_A", Dimension.CURRENT, 0.01, 10.0),
    )
    look_alikes = ("inverter_dead_time", "winding_heating", "supply_sag")
    experiment = InverterDeadTime.experiment
    sentence = """{voltage_V:V} are lost between logged voltage and winding, reached over
        {current_A:A} around zero current"""
    limits = {0: ROUNDED_SHARES}

    shares = (0.05, 0.1, 0.2)
    nonlinear = ("current_A", 0.0, 1.0)

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        return {"voltage_V": float(c[0]), "current_A": shape[0] * shape[2]}

    def physical_range(self, name: str) -> tuple[float, float]:
        # The limits are shares of the greatest current.
        return (0.0, np.inf) if name in self.nonlinear else super().physical_range(name)

    def indistinct(self, parameters: Mapping[str, float], views: Sequence[View]) -> tuple[str, ...]:
        # Over a range of current that passes within one sample period, the drop may be the step of
        # a dead time.
        return ("inverter_dead_time",) if parameters["current_A"] <= change_at_zero(views) else ()


class WindingHeating(Effect):
    """Resistance and, if the magnets heat too, torque constant and back-EMF that change with the
    heat loss of the winding.

    The nonlinear parameters are the time constant, the number of recordings, each of which has an
    initial temperature of its own (0 for initial temperatures that the losses of earlier recordings
    leave), and whether the magnets heat too.
    """

    equation = """R(dT) = R (1 + 0.00393 dT), Km and Ke (dT) = those (1 - 0.001 dT) (if magnet = 1),
        T d(dT)/dt = r R(dT) I^2 - dT"""
    implied = "the motor's constants R and Km are constant (eq. 1)"
    shows_in = "voltage"
    coordinate = """time: grows with the heat that the current has produced since the start, and
        falls at rest"""
    parameters = (
        Quantity("rise_K_per_W", Dimension.THERMAL_RESISTANCE, 0.0, 20.0),
        Quantity("time_s", Dimension.TIME, 1.0, 5000.0),
        Quantity("magnet", Dimension.NUMBER, 0.0, 1.0),
    )
    look_alikes = ("viscous_thermal_drift", "coulomb_drift", "current_drift", "supply_sag")
    experiment = """One sequence at two speeds, with the machine cold, after minutes at high
        current, and after a rest, with voltage and current logged: a hot winding changes U - Ke
        omega per ampere, hot grease changes the current only."""
    separation = Separation.SESSION
    sentence = """the winding heats by {rise_K_per_W:K/W} of loss with a time constant of
        {time_s:s}, its resistance rises and, if the magnets heat with it ({magnet:}; 1: they do, 0:
        they do not), its torque per ampere falls"""
    refine = {0: 0.0}
    forms = {2: WITH_MAGNETS}
    follows = True
    enters = ("voltage", "torque")
    nonlinear = ("time_s", 0.0, "magnet")
    on_drive = True
    start = {"voltage": _warm_start_voltage, "torque": _warm_start_torque}

    @staticmethod
    def voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
        return _by_recording(view, shape, _warmth(view, shape[2]) * _rises(view, shape[0]))

    @staticmethod
    def torque(view: View, nominal: Nominal, shape: Shape) -> Array:
        weaker = shape[2] * MAGNET_PER_K * nominal.drive(view)
        return _by_recording(view, shape, _rises(view, shape[0]) * weaker)

    def shapes(self, context: Context) -> Sequence[Shape]:
        count = float(1 + max(v.index for v in context.views))
        return everywhere(
            context, has_voltage, [(t, count, WITH_MAGNETS[0]) for t in THERMAL_TIMES_S]
        )


class SupplySag(Effect):
    """Supply voltage that falls with the supply current.

    The resistance follows from the supply voltage without load, which is one value of the campaign.
    """

    equation = "R I + L dI/dt = U (1 - Rs I_bus / U_nominal) - Ke dphi/dt"
    implied = "the supply's voltage is constant"
    shows_in = "voltage"
    coordinate = """torque: grows with the power of the motor, the product of voltage and supply
        current"""
    parameters = (
        Quantity("resistance_ohm", Dimension.RESISTANCE, 0.0, 3.0),
        Quantity("supply_V", Dimension.VOLTAGE, 0.0, 1000.0),
    )
    look_alikes = ("winding_heating", "inverter_dead_time", "brush_drop")
    experiment = """One high current at rest, where the supply delivers little power, and in fast
        motion, where it delivers much power. A log of the supply voltage shows the effect
        directly."""
    sentence = """the supply voltage, {supply_V:V} without load, falls by {resistance_ohm:ohm} times
        the supply current, and the voltage at the winding with it (a supply that was neither logged
        nor declared counts as the greatest voltage; the true resistance is then greater)"""
    enters = ("voltage",)
    nonlinear = ("supply_V",)

    @staticmethod
    def voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
        assert view.current is not None
        assert view.voltage is not None
        volts = np.where(np.isnan(view.voltage), 0.0, view.voltage)
        return rows(volts**2 * view.current / shape[0] ** 2)

    def shapes(self, context: Context) -> Sequence[Shape]:
        seen = [v for v in context.views if has_voltage(v)]
        logged = [float(np.median(v.supply)) for v in seen if v.supply is not None]
        declared = [s for v in seen if (s := v.recording.bench.supply_voltage) is not None]
        # A supply that is neither logged nor declared has at least the greatest voltage.
        greatest = [float(np.nanmax(np.abs(v.voltage))) for v in seen if v.voltage is not None]
        supply = max(logged or declared or greatest, default=0.0)
        return [(supply,)] if supply > 0.0 else []
