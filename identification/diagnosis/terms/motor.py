"""Computes the regressors of effects of motor and supply on the drive's torque or voltage, which
eq. 1 omits.

Regressors that depend on the torque use the torque of the nominal model. The measured torque is the
quantity to be explained, and as a regressor would explain every mismatch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.recent import recent
from identification.diagnosis.rows.view import View, lacks_common_origin, torque_per_ampere
from identification.diagnosis.terms.memory import temperature_rise
from identification.diagnosis.terms.term import (
    EXACT,
    NO_SHAPE,
    Context,
    Reader,
    Shape,
    Term,
    everywhere,
    in_motion,
    of_each_recording,
    one,
    polar,
    rows,
)
from identification.diagnosis.terms.voltage_drop import (
    BRUSH_SHARES,
    DEAD_SHARES,
    ROUNDED_SHARES,
    STEP_SHARES,
    about_zero,
    at_zero,
    drop,
    has_current,
)
from identification.diagnosis.terms.wave import sine_cosine
from identification.recording import Array
from identification.signals import central_difference

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
TANH_OR_RATIONAL = (0.0, 1.0)
"""Laws of saturation: a hyperbolic tangent (0), or a rational function (1)."""
WITH_MAGNETS = (1.0, 0.0)
"""Whether the magnets heat with the winding (1), or only the winding heats (0)."""
THERMAL_TIMES_S = (15.0, 40.0, 100.0, 250.0, 600.0)
KEPT = 64
"""Number of cached temperature rises; they depend on recording and time constant, which a fit
changes less often than the nominal values.
"""
ZEROED_S = (0.0, 2.0)
"""Limits of the time from the zeroing of the current sensor to the start of a recording, s, during
which power comes on and loops settle.
"""


def _cogging(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return _by_origin(view, shape, -sine_cosine(shape[0], view.motor))


# The torque of the mean torque constant is the required torque divided by one plus the ripple. If
# the divisor does not contain the ripple identified so far, the square of the ripple remains, which
# is a hundredth for a ripple of 12 %.
def _ripple(view: View, nominal: Nominal, shape: Shape) -> Array:
    wave = _by_origin(view, shape, sine_cosine(shape[0], view.motor))
    return np.asarray(wave * (-nominal.drive(view) / _gain(view, nominal)))


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
    """Return the two columns of a wave, or two columns for each recording if each recording has its
    own origin of angles.
    """
    if len(shape) == 1:
        return wave
    out = np.zeros((2 * round(shape[1]), wave.shape[1]))
    if 2 * view.index < len(out):  # in a recording that is not fitted the phase is unknown
        out[2 * view.index : 2 * view.index + 2] = wave
    return out


def _waves(context: Context) -> Sequence[Shape]:
    """Return trial cycles per motor turn and, if recordings have no common origin of angles, the
    number of recordings.
    """
    if lacks_common_origin(context.views):
        return [(*shape, float(len(context.views))) for shape in CYCLES_PER_TURN]
    return CYCLES_PER_TURN


def _cycles(context: Context) -> Sequence[Shape]:
    """Return the trial parameters of :func:`_waves` except one cycle per turn of the joint, because
    such a wave is the torque of a weight that turns with the joint.
    """
    gear = context.views[0].recording.bench.gear_ratio
    return [shape for shape in _waves(context) if len(shape) > 1 or shape[0] * gear != 1.0]


def _saturation(view: View, nominal: Nominal, shape: Shape) -> Array:
    """Return the torque, without saturation, of the additional current that saturation requires.

    With saturation the torque is Km I_k tanh(I / I_k), or (rational) Km I / (1 + (I / I_k)^2),
    which cannot exceed half of Km I_k.
    """
    knee, rational = shape
    gain = torque_per_ampere(view)
    share = nominal.drive(view) / (gain * knee)
    if rational:
        share = np.clip(share, -0.4999, 0.4999)
        needed = 2.0 * share / (1.0 + np.sqrt(1.0 - 4.0 * share**2))
    else:
        share = np.clip(share, -0.999, 0.999)
        needed = np.arctanh(share)
    return rows(gain * knee * (needed - share))


def _knees(context: Context) -> list[Shape]:
    greatest = max(
        float(np.max(np.abs(context.nominal.drive(v)))) / torque_per_ampere(v)
        for v in context.views
    )
    return [(k * greatest, rational) for rational in TANH_OR_RATIONAL for k in KNEES]


def _loop_lag(view: View, nominal: Nominal, _shape: Shape) -> Array:
    return rows(central_difference(nominal.drive(view), view.step))


@recent
def _loss(view: View) -> Array:
    """Return the heat loss of the winding, W: electrical less mechanical power, I (U - Ke omega).

    Without a voltage, the loss is R I^2, which omits the rise of R, some per cent in a warm
    winding.
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
    """Return the winding's temperature rise over thermal resistance, W, and the remainder of an
    initial temperature rise of 1 K, shape (2, m).
    """
    return temperature_rise(_loss(view), view.run_time, time_constant)


def _by_recording(view: View, shape: Shape, rises: Array) -> Array:
    """Return the regressors of :func:`_rises`, with one regressor for the initial temperature of
    each recording, shape (1 + recordings, m).
    """
    return np.concatenate([rises[:1], of_each_recording(view, round(shape[1]), rises[1:])])


def _warmth(view: View, magnet: float) -> Array:
    """Return the change of the voltage if the winding is 1 K warmer, V; with ``magnet`` 1 the
    magnets are 1 K warmer too.
    """
    assert view.current is not None
    resistance = view.recording.bench.resistance or 0.0
    warmer = COPPER_PER_K * resistance * view.current
    # Torque and back-EMF are both proportional to the flux of the magnets, which falls with
    # temperature.
    weaker = (
        magnet * MAGNET_PER_K * (view.recording.bench.back_emf_constant or 0.0) * view.motor_speed
    )
    return np.asarray(warmer - weaker)


def _heating_voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return _by_recording(view, shape, _warmth(view, shape[2]) * _rises(view, shape[0]))


def _heating_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    weaker = shape[2] * MAGNET_PER_K * nominal.drive(view)
    return _by_recording(view, shape, _rises(view, shape[0]) * weaker)


def _warm_start_voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(_warmth(view, shape[2]) * _rises(view, shape[0])[1])


def _warm_start_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    return rows(shape[2] * MAGNET_PER_K * nominal.drive(view) * _rises(view, shape[0])[1])


def _warm_ups(context: Context) -> Sequence[Shape]:
    count = float(1 + max(v.index for v in context.views))
    return _with_voltage([(t, count, WITH_MAGNETS[0]) for t in THERMAL_TIMES_S])(context)


def _sag(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    assert view.current is not None
    assert view.voltage is not None
    volts = np.where(np.isnan(view.voltage), 0.0, view.voltage)
    supply = (
        float(np.median(view.supply)) if view.supply is not None else float(np.max(np.abs(volts)))
    )
    return rows(volts**2 * view.current / supply**2)


def _drift(view: View, shape: Shape) -> Array:
    """Return the time since the zero of the current sensor was taken, before the recording, s."""
    return np.asarray(view.time - view.time[0] + shape[0])


def _current_offset(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(np.full(len(view.time), torque_per_ampere(view)))


def _current_offset_voltage(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(np.full(len(view.time), -(view.recording.bench.resistance or 0.0)))


def _with_current(shapes: Sequence[Shape]) -> Callable[[Context], Sequence[Shape]]:
    return lambda context: everywhere(context, has_current, shapes)


def _with_voltage(shapes: Sequence[Shape]) -> Callable[[Context], Sequence[Shape]]:
    return lambda context: everywhere(
        context, lambda v: has_current(v) and v.voltage is not None, shapes
    )


def _wave(name: str) -> Reader:
    def read(c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        waves = [
            polar(float(sine), float(cosine)) for sine, cosine in zip(c[::2], c[1::2], strict=True)
        ]
        amplitude = float(np.median([amplitude for amplitude, _ in waves]))
        return {name: amplitude, "per_motor_turn": shape[0], "phase_rad": waves[0][1]}

    return read


TERMS = (
    Term(
        "cogging",
        {"torque": _cogging},
        _wave("torque_Nm"),
        _cycles,
        at_angle=True,
        shape_error=EXACT,
    ),
    Term(
        "torque_ripple", {"torque": _ripple}, _wave("fraction"), _waves, at_angle=True, follows=True
    ),
    Term(
        "torque_saturation",
        in_motion(_saturation),
        lambda _coefficients, shape, _context: {"knee_A": shape[0], "rational": shape[1]},
        lambda context: _knees(context) if any(has_current(v) for v in context.views) else (),
        refine={0: 0.0},
        forms={1: TANH_OR_RATIONAL},
        positive=(0,),
        size=1.0,
        follows=True,
    ),
    Term(
        "current_loop_lag",
        {"torque": _loop_lag},
        one("time_s"),
        _with_current(NO_SHAPE),
        positive=(0,),
        follows=True,
        shape_error=EXACT,
    ),
    Term(
        "inverter_dead_time",
        {"voltage": drop},
        one("voltage_V"),
        about_zero(DEAD_SHARES),
        refine={0: 0.0},
        limits={0: STEP_SHARES},
        positive=(0,),
        begin=at_zero,
    ),
    Term(
        "brush_drop",
        {"voltage": drop},
        lambda c, shape, _context: {"voltage_V": float(c[0]), "current_A": shape[0] * shape[2]},
        about_zero(BRUSH_SHARES),
        refine={0: 0.0},
        limits={0: ROUNDED_SHARES},
        positive=(0,),
        begin=at_zero,
    ),
    Term(
        "winding_heating",
        {"voltage": _heating_voltage, "torque": _heating_torque},
        lambda c, shape, _context: {
            "rise_K_per_W": float(c[0]),
            "time_s": shape[0],
            "magnet": shape[2],
        },
        _warm_ups,
        refine={0: 0.0},
        forms={2: WITH_MAGNETS},
        positive=(0,),
        follows=True,
        start={"voltage": _warm_start_voltage, "torque": _warm_start_torque},
    ),
    Term(
        "supply_sag",
        {"voltage": _sag},
        one("resistance_ohm"),
        _with_voltage(NO_SHAPE),
        positive=(0,),
    ),
    Term(
        "current_offset",
        {
            "torque": _current_offset,
            "breakaway": _current_offset,
            "voltage": _current_offset_voltage,
        },
        one("current_A"),
        _with_current(NO_SHAPE),
        shape_error=EXACT,
    ),
    Term(
        "current_drift",
        {
            "torque": lambda v, n, s: _current_offset(v, n, s) * _drift(v, s),
            "breakaway": lambda v, n, s: _current_offset(v, n, s) * _drift(v, s),
            "voltage": lambda v, n, s: _current_offset_voltage(v, n, s) * _drift(v, s),
        },
        one("rate_A_s"),
        _with_current(((0.5 * ZEROED_S[1],),)),
        refine={0: 0.5 * ZEROED_S[1]},
        limits={0: ZEROED_S},
        shape_error=EXACT,
    ),
)
