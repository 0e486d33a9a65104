"""Between motor and valve: what two encoders show of assumption 5, and where the gear loses
power.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.memory import delayed, falling_play, first_swing, play
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

TEETH: tuple[Shape, ...] = tuple((float(n),) for n in range(5, 201))
GAPS_RAD = tuple(float(g) for g in np.geomspace(5e-5, 5e-2, 13))
DELAYS_S: tuple[Shape, ...] = tuple((float(t),) for t in np.geomspace(2e-4, 0.05, 9))
TWIST_COUNTS = (0.0, 2.0)
"""Counts of the joint's encoder by which a shaft may twist under the greatest torque and still
count as stiff.
"""
LOOP_SHARES = (0.05, 0.15, 0.4)
"""Torque that closes a hysteresis loop over the greatest torque."""
LEAST_JOINT_SHARE = 0.1
"""Of the inertia, that is the joint's at least."""
LOOPS_RAD = tuple(float(x) for x in np.geomspace(5e-5, 1e-2, 5))
ROTOR_SHARE = 0.5
"""Of the inertia, which the rotor is first supposed to have; no recording is told which, and a fit
seeks it.
"""
SLIPS_PER_RECORDING = 12
KEPT = 128
"""Series that are kept, of a recording and what they were built from: a search moves one entry of a
shape at a time.
"""
FIRST_SAMPLES = 20
"""Over which the encoders are asked where in its gap, or loop, a recording begins."""


class Gap(NamedTuple):
    """Shape of a gap: how wide it is, rad, and the shaft about it and the rotor before it."""

    width: float
    counts: float
    """By which the shaft twists under the greatest torque."""
    per_torque: float
    """Twist of one count, rad/(N m)."""
    rotor: float
    """Its inertia at the joint, kg m^2."""


class Loop(NamedTuple):
    """Shape of a coupling's loop: the torque that closes it, N m, and how far it gives, rad; else
    as a gap's.
    """

    torque: float
    rotor: float
    deflection: float
    counts: float
    per_torque: float


def _both_encoders(view: View) -> bool:
    return view.lag is not None


def carried(view: View, rotor: float) -> Array:
    """Return the torque that comes through the coupling behind a rotor of this inertia at the joint
    (kg m^2), N m.

    While a loop is crossed the rotor moves alone and takes most of the drive's torque for itself.
    """
    out = rotor * view.rotor_acceleration
    return np.asarray(np.subtract(view.transmitted, out, out=out))


def _twist(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    """Return what twists a springy shaft: the drive's torque, less what the rotor and the shaft's
    damping take of it.

    Neither the rotor's inertia nor the damping is known; a soft shaft shows both, up to a hundred
    times the encoders' noise where the joint sets off or turns.
    """
    torque = view.transmitted
    return rows(torque, -view.rotor_acceleration, -central_difference(torque, view.step))


def _play(view: View, nominal: Nominal, shape: Shape) -> Array:
    gap, counts, per_torque, rotor = Gap(*shape)
    return rows(lead(view, nominal, gap, rotor) + counts * per_torque * carried(view, rotor))


def count_of_twist(views: Sequence[View]) -> float:
    """Return the compliance that twists a shaft by one count of the joint's encoder at the greatest
    torque, rad/(N m).

    The stiffest shaft twists to the flank that carries, and what it twists by adds itself to a
    narrow gap.
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
        [(gap, 0.5 * TWIST_COUNTS[1], per_torque, rotor) for gap in GAPS_RAD],
    )


def lead(view: View, nominal: Nominal, gap: float, rotor: float) -> Array:
    """Return how far the motor leads through a gap that its own encoders show where it begins in,
    rad, shape (m,).

    The joint stands while the gap is open; under a weight that is more than its friction holds it
    falls.

    Args:
        view: The recording.
        nominal: Of which friction and inertia count where a weight turns with the joint.
        gap: rad.
        rotor: The rotor's inertia at the joint, kg m^2.
    """
    if not nominal.helped(view) or nominal.get("J") <= 0.0:
        return _lead(view, None, gap, 0.0)
    return _lead(view, nominal, gap, rotor)


@lru_cache(maxsize=KEPT)
def _lead(view: View, nominal: Nominal | None, gap: float, rotor: float) -> Array:
    """Return :func:`lead`, without a nominal model where no weight turns with the joint."""
    motor = view.drive_angle
    through = _through(view, nominal, motor, gap, rotor)
    middle = through(len(motor), 0.0)
    crossed = first_swing(motor, gap)
    if view.lag is None or crossed == len(motor):
        return middle
    zero = float(np.mean(view.lag[crossed:] - middle[crossed:]))
    # From there on both are the same: a flank has carried.
    middle[: crossed + 1] = through(crossed + 1, float(np.mean(view.lag[:FIRST_SAMPLES])) - zero)
    return middle


def _through(
    view: View, nominal: Nominal | None, motor: Array, gap: float, rotor: float
) -> Callable[[int, float], Array]:
    """Return the lead over so many samples as a function of the one at the first of them, rad."""
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
        begun = _sheared(here, width, float(torque[0]) - width * min(max(first, -1.0), 1.0))
        out[: closed + 1] = deflection * begun + compliance * here
    return rows(out)


@lru_cache(maxsize=KEPT)
def _closing(view: View, width: float, rotor: float) -> tuple[Array, Array, int, Array | None]:
    """Return what a loop is built from, whatever its deflection and its twist.

    Returns:
        Torque carried, N m; the loop's deflection from its middle; from where on any beginning ends
        in it; means of lag, torque and deflection over the first samples and over those from there
        on, shape (2, 3), or None.
    """
    torque = carried(view, rotor)
    state, closed = _sheared(torque, width), first_swing(torque, 2.0 * width)
    if view.lag is None or closed == len(torque):
        return torque, state, closed, None
    stretches = slice(FIRST_SAMPLES), slice(closed, None)
    means = np.array(
        [[np.mean(series[s]) for series in (view.lag, torque, state)] for s in stretches]
    )
    return torque, state, closed, means


def _sheared(torque: Array, width: float, start: float = 0.0) -> Array:
    """Return the loop's deflection over its greatest one, from the torque by which the play leads
    at first.
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
    sizes = [(share * greatest, deflection) for share in LOOP_SHARES for deflection in LOOPS_RAD]
    return [
        (width, rotor, deflection, 0.5 * TWIST_COUNTS[1], per_torque) for width, deflection in sizes
    ]


def _mesh(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return sine_cosine(shape[0], view.angle)


def _mesh_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    # Power passes whole: where the teeth make the motor run ahead, i.e. faster, it needs as much
    # less torque.
    sine, cosine = sine_cosine(shape[0], view.angle)
    torque = shape[0] * nominal.drive(view)
    out = np.empty((2, len(torque)))
    np.multiply(torque, cosine, out=out[0])
    np.multiply(torque, sine, out=out[1])
    np.negative(out[0], out=out[0])
    return out


def _read_mesh(c: Array, shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {"amplitude_rad": amplitude, "per_turn": shape[0], "phase_rad": phase}


def _eccentric(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(-np.sin(view.angle), -np.cos(view.angle))


def _read_eccentric(c: Array, _shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {"amplitude_rad": amplitude, "phase_rad": phase}


def _late(view: View, _nominal: Nominal, shape: Shape) -> Array:
    # Not the speed times the delay: where the speed changes within the delay that leaves far more
    # than encoders' noise.
    logged = view.drive_angle - (0.0 if view.lag is None else view.lag)
    return rows(delayed(logged, view.step, -shape[0]) - logged)


def _late_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    torque = nominal.drive(view)
    return rows(delayed(torque, view.step, -shape[0]) - torque)


def on_the_joint(terms: Iterable[Term]) -> list[Term]:
    """Return effects as they show where friction follows the joint's encoder: what is late in it is
    late in friction.

    Left out, the torque that is ahead of such angles passes for a current that lags.
    """
    return [
        replace(t, columns={**t.columns, "torque": _late_torque}, follows=True)
        if t.name == "transport_delay"
        else t
        for t in terms
    ]


def _slip(view: View, _nominal: Nominal, shape: Shape) -> Array:
    here = view.index == round(shape[0])
    return rows(np.where(here & (view.time - view.time[0] >= shape[1]), -1.0, 0.0))


def _slips(context: Context) -> list[Shape]:
    shapes: list[Shape] = []
    for view in context.views:
        if view.lag is not None:
            length = float(view.time[-1] - view.time[0])
            times = np.linspace(0.0, length, SLIPS_PER_RECORDING + 2)[1:-1]
            shapes += [(float(view.index), float(t)) for t in times]
    return shapes


def _efficiency(view: View, nominal: Nominal, _shape: Shape) -> Array:
    # Driven back, eta of the torque comes through; driving, 1 / eta is asked for, and 1 / eta - 1
    # is the coefficient.
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
    Term(
        "encoder_eccentricity",
        {"transmission": _eccentric},
        _read_eccentric,
        lambda context: everywhere(context, _both_encoders, ((),)),
        shape_error=EXACT,
    ),
    Term(
        "encoder_slip",
        {"transmission": _slip},
        lambda c, shape, _context: {"angle_rad": float(c[0]), "at_s": shape[1]},
        _slips,
        place=0,
        refine={1: 3.0},
        shape_error=EXACT,
    ),
)
