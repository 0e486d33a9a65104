"""Computes the regressors of effects between motor and valve: violations of assumption 5, which two
encoders show, and power loss of the gear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.recent import recent
from identification.diagnosis.rows.scales import at_scale
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.memory import delayed_series, falling_play, first_swing, play
from identification.diagnosis.terms.term import (
    EXACT,
    Context,
    Shape,
    Term,
    everywhere,
    in_motion,
    polar,
    rows,
    shaped,
)
from identification.diagnosis.terms.wave import sine_cosine
from identification.recording import Array
from identification.signals import central_difference, quantum

WITH_TORQUE = (1.0, 0.0)
TEETH: tuple[Shape, ...] = tuple((float(n), WITH_TORQUE[0]) for n in range(5, 201))
GAPS_RAD = tuple(float(g) for g in np.geomspace(5e-5, 5e-2, 13))
DELAYS_S: tuple[Shape, ...] = tuple((float(t),) for t in np.geomspace(2e-4, 0.05, 9))
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
FIRST_SAMPLES = 20
"""Number of samples at the start of a recording whose encoder readings determine the initial
position in a gap or a hysteresis loop.
"""


class Gap(NamedTuple):
    """Nonlinear parameters of a gap: width, rad, compliance of the shaft, and inertia of the
    rotor.
    """

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


def _both_encoders(view: View) -> bool:
    return view.lag is not None


def coupling_torque(view: View, rotor: float) -> Array:
    """Return the torque through the coupling, N m, for a rotor of this inertia at the joint, kg
    m^2.

    While a hysteresis loop is crossed, the rotor moves alone, and its acceleration requires most of
    the drive's torque.
    """
    out = rotor * view.rotor_acceleration
    return np.asarray(np.subtract(view.transmitted, out, out=out))


def _twist(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    """Return the regressors of a shaft's elastic twist: drive torque, and torques of rotor inertia,
    shaft damping, and the rotor's dry and viscous friction.

    Of these torques only the drive torque is known. With a soft shaft the effect of all other
    torques is up to a hundred times the noise of the encoders.
    """
    torque, speed = view.transmitted, view.motor_speed / view.recording.bench.gear_ratio
    damping = -central_difference(torque, view.step)
    return rows(torque, -view.rotor_acceleration, damping, -view.sense, -speed)


def _play(view: View, nominal: Nominal, shape: Shape) -> Array:
    gap, counts, per_torque, rotor = Gap(*shape)
    return rows(
        lead(view, nominal, gap, rotor) + counts * per_torque * coupling_torque(view, rotor)
    )


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


def _gaps(context: Context) -> Sequence[Shape]:
    per_torque, rotor = count_of_twist(context.views), ROTOR_SHARE * context.nominal.get("J")
    return everywhere(
        context,
        _both_encoders,
        [
            (gap, 0.5 * TWIST_COUNTS[1], per_torque, rotor)
            for gap in at_scale(GAPS_RAD, context.views)
        ],
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
    """Return a function of a number of samples and an initial lead, rad, that returns the lead at
    these samples.
    """
    if nominal is None:
        return lambda count, start: play(motor[:count], gap, start)
    weight = nominal.helping(view)
    inertia = max(nominal.get("J") - rotor, LEAST_JOINT_SHARE * nominal.get("J"))
    pull, hold = weight / inertia, np.abs(nominal.friction(view)) / inertia
    speed = view.motor_speed / view.recording.bench.gear_ratio
    return lambda count, start: falling_play(
        motor[:count], speed, view.step, gap, pull, hold, start
    )


def _loop(view: View, _nominal: Nominal, shape: Shape) -> Array:
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
    np.subtract(torque, out, out=out)
    out /= width
    return np.asarray(np.clip(out, -1.0, 1.0, out=out))


def _loops(context: Context) -> list[Shape]:
    known = [v for v in context.views if v.lag is not None]
    if not known:
        return []
    greatest = max(float(np.max(np.abs(v.transmitted))) for v in known)
    rotor, per_torque = ROTOR_SHARE * context.nominal.get("J"), count_of_twist(known)
    deflections = at_scale(LOOPS_RAD, context.views)
    sizes = [(share * greatest, deflection) for share in LOOP_SHARES for deflection in deflections]
    return [
        (width, rotor, deflection, 0.5 * TWIST_COUNTS[1], per_torque) for width, deflection in sizes
    ]


def _mesh(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return sine_cosine(shape[0], view.angle)


def _mesh_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    # Where the teeth make the motor turn faster, it needs less torque in the same proportion: power
    # is conserved. An error of the angle alone, as of an encoder, makes no torque.
    sine, cosine = sine_cosine(shape[0], view.angle)
    torque = shape[1] * shape[0] * nominal.drive(view)
    out = np.empty((2, len(torque)))
    np.multiply(torque, cosine, out=out[0])
    np.multiply(torque, sine, out=out[1])
    np.negative(out[0], out=out[0])
    return out


def _read_mesh(c: Array, shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {
        "amplitude_rad": amplitude,
        "per_turn": shape[0],
        "phase_rad": phase,
        "with_torque": shape[1],
    }


def _late(view: View, _nominal: Nominal, shape: Shape) -> Array:
    # Speed times delay is not accurate enough: if the speed changes within the delay, the error of
    # this product is far above the noise of the encoders.
    logged = view.drive_angle - (0.0 if view.lag is None else view.lag)
    return rows(delayed_series(logged, view.step, -shape[0]) - logged)


def _late_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    torque = nominal.drive(view)
    return rows(delayed_series(torque, view.step, -shape[0]) - torque)


def on_the_joint(terms: Iterable[Term]) -> list[Term]:
    """Return the effects for torques that are computed with the motion of the joint encoder. A
    delay of this encoder also delays the friction in the torque equation.

    If the friction were not delayed, the torque would lead the delayed angles, as it does with a
    lag of the current.
    """
    return [
        replace(t, columns={**t.columns, "torque": _late_torque}, follows=True)
        if t.name == "transport_delay"
        else t
        for t in terms
    ]


def _efficiency(view: View, nominal: Nominal, _shape: Shape) -> Array:
    # If the load drives the motor, the share eta of the torque is transmitted; if the motor drives
    # the load, 1 / eta of the torque is required. The coefficient is 1 / eta - 1.
    torque = nominal.drive(view)
    return rows(torque * np.where(torque * view.velocity >= 0.0, 1.0, -nominal.efficiency))


TERMS = (
    Term(
        "backlash",
        {"transmission": _play},
        shaped("gap_rad"),
        _gaps,
        refine={0: 0.0, 1: 0.5 * TWIST_COUNTS[1], 3: 0.0},
        limits={1: TWIST_COUNTS},
        positive=(0,),
        size=1.0,
        varies=("transmission",),
    ),
    Term(
        "compliance",
        {"transmission": _twist},
        lambda c, _shape, _context: {"stiffness_Nm_rad": 1.0 / float(c[0])},
        lambda context: everywhere(context, _both_encoders, ((),)),
        positive=(0,),
        shape_error=EXACT,
    ),
    Term(
        "gear_mesh_ripple",
        {"transmission": _mesh, "torque": _mesh_torque},
        _read_mesh,
        lambda context: everywhere(context, _both_encoders, TEETH),
        forms={1: WITH_TORQUE},
        at_angle=True,
        follows=True,
    ),
    Term(
        "coupling_hysteresis",
        {"transmission": _loop},
        lambda _c, shape, _context: {
            "deflection_rad": Loop(*shape).deflection,
            "torque_Nm": Loop(*shape).torque,
        },
        _loops,
        refine={2: 0.0, 0: 0.0, 1: 0.0, 3: 0.5 * TWIST_COUNTS[1]},
        limits={3: TWIST_COUNTS},
        positive=(0,),
        size=1.0,
    ),
    Term(
        "transmission_efficiency",
        in_motion(_efficiency),
        lambda c, _shape, _context: {"efficiency": 1.0 / (1.0 + float(c[0]))},
        positive=(0,),
        follows=True,
    ),
    Term(
        "transport_delay",
        {"transmission": _late},
        shaped("time_s"),
        lambda context: everywhere(context, _both_encoders, DELAYS_S),
        refine={0: 0.0},
        positive=(0,),
        size=1.0,
        shape_error=EXACT,
    ),
)
