"""Computes the regressors of effects of lever, weight and valve, which eq. 10 to 13 and 17 omit,
and of effects of sampling times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.recent import recent
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.lateness import command_delay_error, voltage_is_computed
from identification.diagnosis.terms.memory import delayed_series
from identification.diagnosis.terms.term import (
    CLOSE,
    EXACT,
    NO_SHAPE,
    Context,
    Shape,
    Term,
    everywhere,
    in_motion,
    of_each_recording,
    one,
    polar,
    rows,
    shaped,
)
from identification.diagnosis.terms.wave import sine_cosine
from identification.recording import Array
from identification.signals import central_difference

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
SKEWS_S: tuple[Shape, ...] = tuple(
    (side * t,) for t in (5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 0.016) for side in (-1.0, 1.0)
)
WITH_VOLTAGE = (1.0,)
"""Last nonlinear parameter of a time skew if the voltage is sampled together with the current.
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


def _is_loaded(view: View) -> bool:
    return view.loaded


def _forces(context: Context) -> set[float]:
    return {round(v.recording.contact_force, 6) for v in context.views if v.loaded}


def _exponent(view: View, nominal: Nominal, shape: Shape) -> Array:
    arm = view.recording.bench.moment_arm or 1.0
    force = np.maximum(view.moment / arm, 1e-9)
    return rows(_load(view, nominal) * ((force / REFERENCE_FORCE_N) ** (shape[0] - 1.0) - 1.0))


def _mislabelled(view: View, nominal: Nominal, shape: Shape) -> Array:
    return rows(_of_the_label(view, nominal) * float(view.index == round(shape[0])))


def _of_the_label(view: View, nominal: Nominal) -> Array:
    """Return the part of the required drive torque that is proportional to the labelled mass, N
    m.
    """
    if view.loaded:
        return _load(view, nominal)
    return np.asarray(-view.known + view.sense * np.abs(view.hanging) * nominal.gear(view))


def _labels(context: Context) -> list[Shape]:
    labelled = [v for v in context.views if v.loaded or _has_weight(v)]
    return [(float(v.index),) for v in labelled] if len(labelled) > 1 else []


def _read_mass(c: Array, shape: Shape, context: Context) -> dict[str, float]:
    view = next(v for v in context.views if v.index == round(shape[0]))
    return {"mass_kg": (1.0 + float(c[0])) * label_kg(view)}


def label_kg(view: View) -> float:
    """Return the labelled mass of a recording, on the lever or turning with the joint, kg."""
    pendulum = view.recording.pendulum
    return view.recording.weight_mass if view.loaded or pendulum is None else pendulum.mass


def _swing(view: View, nominal: Nominal, shape: Shape) -> Array:
    swing = np.zeros((2, len(view.time)))
    if view.loaded:
        since = view.time - view.time[0]
        envelope = _load(view, nominal) * np.exp(-since / shape[1])
        swing = sine_cosine(2.0 * np.pi * shape[0], since) * envelope
    return swing if shape[2] == ONE_PHASE else of_each_recording(view, round(shape[2]), swing)


def _swings(context: Context) -> Sequence[Shape]:
    loaded = [v.index for v in context.views if v.loaded]
    own = (float(1 + max(loaded)),) if len(loaded) > 1 else ()
    return [(f, SWING_DECAY_S, phases) for f in SWINGS_HZ for phases in (ONE_PHASE, *own) if loaded]


def _read_swing(c: Array, shape: Shape, _context: Context) -> dict[str, float]:
    sizes = [
        polar(float(sine), float(cosine))[0] for sine, cosine in zip(c[::2], c[1::2], strict=True)
    ]
    # For recordings without load the columns are zero, and the coefficients are rounding errors.
    least = ROUNDING * max(sizes)
    return {
        "fraction": float(np.median([size for size in sizes if size > least] or [0.0])),
        "frequency_Hz": shape[0],
        "decay_s": shape[1],
    }


def _stop(view: View, _nominal: Nominal, shape: Shape) -> Array:
    side, upper, lower = shape
    above, below = np.maximum(view.angle - upper, 0.0), np.minimum(view.angle - lower, 0.0)
    return rows((side != LOWER) * above + (side != UPPER) * below)


def _stops(context: Context) -> list[Shape]:
    """Return trial parameters of an end stop at either end of the travel, and of a stop at each
    end.
    """
    low = min(float(np.min(v.angle)) for v in context.views)
    high = max(float(np.max(v.angle)) for v in context.views)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return [
        (side, float(middle + share * half), float(middle - share * half))
        for share in np.linspace(0.5, 0.97, STOPS)
        for side in (UPPER, LOWER, BOTH)
    ]


def _read_stop(c: Array, shape: Shape, _context: Context) -> dict[str, float]:
    side, upper, lower = shape
    return {
        "angle_rad": lower if side == LOWER else upper,
        "stiffness_Nm_rad": float(c[0]),
        "other_rad": lower if side == BOTH else 0.0,
    }


def _gravity(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(np.sin(view.angle), -np.cos(view.angle))


def _read_gravity(c: Array, _shape: Shape, _context: Context) -> dict[str, float]:
    torque = float(np.hypot(c[0], c[1]))
    return {"torque_Nm": torque, "zero_rad": float(np.arctan2(c[1], c[0]))}


def _spring(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(view.angle, -np.ones(len(view.time)))


def _read_spring(c: Array, _shape: Shape, _context: Context) -> dict[str, float]:
    return {"stiffness_Nm_rad": float(c[0]), "rest_rad": float(c[1] / c[0]) if c[0] else 0.0}


def _has_weight(view: View) -> bool:
    return view.recording.pendulum is not None


def _is_borne(view: View) -> bool:
    """Whether a known load that turns with the joint, or a known constant torque, acts on the
    joint.
    """
    return _has_weight(view) or view.recording.steady_torque != 0.0


def _skew(view: View, nominal: Nominal, shape: Shape) -> Array:
    if voltage_is_computed(view.recording):
        return rows(command_delay_error(view, -shape[0]))
    torque = nominal.drive(view)
    return rows(delayed_series(torque, view.step, shape[0]) - torque)


def _skew_voltage(view: View, _nominal: Nominal, shape: Shape) -> Array:
    bench = view.recording.bench
    assert view.current is not None
    if shape[1:] == WITH_VOLTAGE:
        speed = view.motor_speed
        return rows(
            (bench.back_emf_constant or 0.0) * (delayed_series(speed, view.step, shape[0]) - speed)
        )
    change = delayed_series(view.current, view.step, -shape[0]) - view.current
    return rows(
        (bench.resistance or 0.0) * change
        + (bench.inductance or 0.0) * central_difference(change, view.step)
    )


def _skews(context: Context) -> list[Shape]:
    """Return trial time skews of the current alone and, if a voltage is known, of current and
    voltage together, for which the angles are delayed.
    """
    alone = [(*shape, 0.0) for shape in SKEWS_S]
    if all(v.voltage is None for v in context.views):
        return alone
    return [*alone, *((*shape, *WITH_VOLTAGE) for shape in SKEWS_S)]


TERMS = (
    Term("gravity_imbalance", in_motion(_gravity), _read_gravity, shape_error=EXACT),
    Term("return_spring", in_motion(_spring), _read_spring, positive=(0,), shape_error=EXACT),
    Term(
        "end_stop",
        in_motion(_stop),
        _read_stop,
        _stops,
        refine={1: 0.08, 2: 0.08},
        forms={0: (UPPER, LOWER, BOTH)},
        positive=(0,),
        at_angle=True,
    ),
    Term(
        "load_exponent",
        in_motion(_exponent),
        shaped("exponent"),
        lambda context: EXPONENTS if len(_forces(context)) > 1 else (),
        refine={0: 0.0},
        positive=(0,),
        size=1.0,
        follows=True,
        shape_error=CLOSE,
    ),
    Term(
        "load_position_dependence",
        in_motion(lambda v, n, _s: rows(_load(v, n) * v.angle)),
        one("slope_per_rad"),
        lambda context: everywhere(context, _is_loaded, ((),)),
        follows=True,
        shape_error=CLOSE,
    ),
    Term(
        "wrong_weight",
        in_motion(_mislabelled),
        _read_mass,
        _labels,
        place=0,
        follows=True,
        shape_error=EXACT,
    ),
    Term(
        "load_swing",
        in_motion(_swing),
        _read_swing,
        _swings,
        refine={0: 0.0, 1: 0.0},
        follows=True,
        shape_error=CLOSE,
    ),
    Term(
        "load_inertia",
        in_motion(
            lambda v, _n, _s: rows(v.acceleration * (v.recording.weight_mass / REFERENCE_MASS_KG))
        ),
        one("inertia_kgm2"),
        lambda context: everywhere(context, lambda v: v.recording.weight_mass > 0.0, ((),)),
        positive=(0,),
        shape_error=EXACT,
    ),
    Term(
        "lever_pivot_friction",
        in_motion(lambda v, _n, _s: rows(v.sense * float(v.loaded))),
        one("torque_Nm"),
        lambda context: ((),) if len(_forces(context)) > 1 else (),
        positive=(0,),
        shape_error=CLOSE,
    ),
    Term(
        "load_dependent_friction",
        in_motion(lambda v, n, _s: rows(v.sense * n.borne(v))),
        one("coefficient"),
        lambda context: (
            NO_SHAPE
            if any(context.nominal.undeclared)
            else everywhere(context, _is_borne, NO_SHAPE)
        ),
        positive=(0,),
        follows=True,
    ),
    Term(
        "time_skew",
        {"torque": _skew, "voltage": _skew_voltage},
        shaped("time_s"),
        _skews,
        refine={0: 2e-3},
        positive=(0,),
        size=1.0,
        begin=lambda nominal, shape: (replace(nominal, late_s=shape[0]), shape),
        follows=True,
    ),
)
