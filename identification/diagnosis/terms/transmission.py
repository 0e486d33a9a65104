"""Between motor and valve: what two encoders show of assumption 5, and where the gear loses power."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.nominal import Nominal
from identification.diagnosis.terms.memory import delayed, play
from identification.diagnosis.terms.term import EXACT, Context, Shape, Term, everywhere, in_motion, polar, rows, shaped
from identification.diagnosis.terms.wave import sine_cosine
from identification.diagnosis.view import View
from identification.recording import Array
from identification.signals import BoolArray, central_difference, quantum

TEETH: tuple[Shape, ...] = tuple((float(n),) for n in range(5, 201))
GAPS_RAD = tuple(float(g) for g in np.geomspace(5e-5, 5e-2, 13))
DELAYS_S: tuple[Shape, ...] = tuple((float(t),) for t in np.geomspace(2e-4, 0.05, 9))
TWIST_COUNTS = (0.0, 2.0)
"""Counts of the joint's encoder by which a shaft may twist under the greatest torque and still count as stiff."""
LOOP_SHARES = (0.05, 0.15, 0.4)
"""Torque that closes a hysteresis loop over the greatest torque."""
ROTOR_SHARE = 0.5
"""Of the inertia, which the rotor is first supposed to have; no recording is told which, and a fit seeks it."""
SLIPS_PER_RECORDING = 12
FIRST_SAMPLES = 20
"""Over which the encoders are asked where in its gap, or loop, a recording begins."""


def _both_encoders(view: View) -> bool:
    return view.lag is not None


def transmitted(view: View) -> Array:
    """Return the torque that the transmission carries, declared loads behind it included, N m."""
    return np.asarray(view.torque - view.known)


def carried(view: View, rotor: float) -> Array:
    """Return the torque that comes through the coupling behind a rotor of this inertia at the joint (kg m^2), N m.

    While a loop is crossed the rotor moves alone and takes most of the drive's torque for itself.
    """
    return np.asarray(transmitted(view) - rotor * _rotor_acceleration(view))


def _rotor_acceleration(view: View) -> Array:
    """Return the rotor's acceleration at the joint, rad/s^2."""
    return np.asarray(central_difference(view.motor_speed, view.step) / view.recording.bench.gear_ratio)


def _twist(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    """Return what twists a springy shaft: the drive's torque, less what the rotor and the shaft's damping take of it.

    Neither the rotor's inertia nor the damping is known; a soft shaft shows both, up to a hundred times the encoders'
    noise where the joint sets off or turns.
    """
    torque = transmitted(view)
    return rows(torque, -_rotor_acceleration(view), -central_difference(torque, view.step))


def _play(view: View, _nominal: Nominal, shape: Shape) -> Array:
    gap, counts, per_torque = shape
    return rows(lead(view, gap) + counts * per_torque * transmitted(view))


def count_of_twist(views: Sequence[View]) -> float:
    """Return the compliance that twists a shaft by one count of the joint's encoder at the greatest torque, rad/(N m).

    The stiffest shaft twists to the flank that carries, and what it twists by adds itself to a narrow gap.
    """
    known = [v for v in views if v.lag is not None]
    greatest = max((float(np.max(np.abs(transmitted(v)))) for v in known), default=0.0)
    return max(quantum(v.recording.channels["angle"]) for v in known) / greatest if greatest > 0.0 else 0.0


def _gaps(context: Context) -> Sequence[Shape]:
    per_torque = count_of_twist(context.views)
    return everywhere(context, _both_encoders, [(gap, 0.5 * TWIST_COUNTS[1], per_torque) for gap in GAPS_RAD])


def lead(view: View, gap: float) -> Array:
    """Return how far the motor leads through a gap that its own encoders show where it begins in, rad, shape (m,)."""
    motor = view.motor / view.recording.bench.gear_ratio
    middle = play(motor, gap)
    known = _forgotten(motor, gap)
    if view.lag is None or not known.any():
        return middle
    zero = float(np.mean((view.lag - middle)[known]))
    return play(motor, gap, float(np.mean(view.lag[:FIRST_SAMPLES])) - zero)


def _loop(view: View, _nominal: Nominal, shape: Shape) -> Array:
    torque, width = carried(view, shape[1]), shape[0]
    state = _sheared(torque, width)
    known = _forgotten(torque, 2.0 * width)
    if view.lag is None or not known.any():
        return rows(state)
    mean = float(np.mean(state[known]))
    spread = state[known] - mean
    slope = float(spread @ view.lag[known]) / max(float(spread @ spread), 1e-300)
    if slope <= 0.0:
        return rows(state)
    first = mean + (float(np.mean(view.lag[:FIRST_SAMPLES])) - float(np.mean(view.lag[known]))) / slope
    return rows(_sheared(torque, width, float(torque[0]) - width * min(max(first, -1.0), 1.0)))


def _sheared(torque: Array, width: float, start: float = 0.0) -> Array:
    """Return the loop's deflection over its greatest one, from the torque by which the play leads at first."""
    return np.asarray(np.clip((torque - play(torque, 2.0 * width, start)) / width, -1.0, 1.0))


def _forgotten(series: Array, gap: float) -> BoolArray:
    """Mark samples by which a play has been crossed, so that where it began no longer matters."""
    return np.asarray(np.maximum.accumulate(series) - np.minimum.accumulate(series) >= gap)


def _loops(context: Context) -> list[Shape]:
    known = [v for v in context.views if v.lag is not None]
    if not known:
        return []
    greatest = max(float(np.max(np.abs(transmitted(v)))) for v in known)
    return [(share * greatest, ROTOR_SHARE * context.nominal.get("J")) for share in LOOP_SHARES]


def _mesh(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return sine_cosine(shape[0], view.angle)


def _mesh_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    # Power passes whole: where the teeth make the motor run ahead, i.e. faster, it needs as much less torque.
    sine, cosine = sine_cosine(shape[0], view.angle)
    torque = shape[0] * nominal.drive(view)
    return rows(-torque * cosine, torque * sine)


def _read_mesh(c: Array, shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {"amplitude_rad": amplitude, "per_turn": shape[0], "phase_rad": phase}


def _eccentric(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(-np.sin(view.angle), -np.cos(view.angle))


def _read_eccentric(c: Array, _shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {"amplitude_rad": amplitude, "phase_rad": phase}


def _late(view: View, _nominal: Nominal, shape: Shape) -> Array:
    # Not the speed times the delay: where the speed changes within the delay that leaves far more than encoders' noise.
    logged = view.motor / view.recording.bench.gear_ratio - (0.0 if view.lag is None else view.lag)
    return rows(delayed(logged, view.step, -shape[0]) - logged)


def _late_torque(view: View, nominal: Nominal, shape: Shape) -> Array:
    torque = nominal.drive(view)
    return rows(delayed(torque, view.step, -shape[0]) - torque)


def on_the_joint(terms: Iterable[Term]) -> list[Term]:
    """Return effects as they show where friction follows the joint's encoder: what is late in it is late in friction.

    Left out, the torque that is ahead of such angles passes for a current that lags.
    """
    return [
        replace(t, columns={**t.columns, "torque": _late_torque}, follows=True) if t.name == "transport_delay" else t
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
    torque = nominal.drive(view)
    return rows(torque * np.where(torque * view.velocity >= 0.0, 1.0, -1.0))


TERMS = (
    Term(
        "backlash",
        {"transmission": _play},
        shaped("gap_rad"),
        _gaps,
        refine={0: 0.0, 1: 0.5 * TWIST_COUNTS[1]},
        limits={1: TWIST_COUNTS},
        positive=(0,),
        size=1.0,
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
        follows=True,
    ),
    Term(
        "coupling_hysteresis",
        {"transmission": _loop},
        lambda c, shape, _context: {"deflection_rad": float(c[0]), "torque_Nm": shape[0]},
        _loops,
        refine={0: 0.0, 1: 0.0},
        positive=(0,),
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
    ),
    Term(
        "encoder_eccentricity",
        {"transmission": _eccentric},
        _read_eccentric,
        lambda context: everywhere(context, _both_encoders, ((),)),
    ),
    Term(
        "encoder_slip",
        {"transmission": _slip},
        lambda c, shape, _context: {"angle_rad": float(c[0]), "at_s": shape[1]},
        _slips,
        place=0,
        refine={1: 3.0},
    ),
)
