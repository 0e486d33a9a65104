"""Distinguishes backlash from coupling hysteresis by the torque that is transmitted while the motor
moves and the valve rests.

If friction holds the valve until the gap or the hysteresis loop is closed, the angles with a gap
and with a loop are equal within the encoders' resolution. In a gap the drive supplies only the
rotor's torque, T = J_r domega_m/dt + M_r s. In a hysteresis loop the torque rises with the angle, T
= J_r domega_m/dt + M_r s + w (s + u), that is (D8) with M = M_r + w. Here J_r is the rotor's
inertia, M_r the friction on the motor's side, w the torque that closes the loop, s the direction,
and u from -1 to 1 the position in the loop. The part w u, which rises with the angle, distinguishes
a loop from a gap; a constant part may occur with a gap too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.comparison import Contender, Round, advantage
from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.significance import runs
from identification.effects.effect import Clearance, Effect
from identification.effects.transmission import ROTOR_SHARE, count_of_twist, lead
from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import QUICK_SAMPLES, View

INNER = 0.6
"""Central share of a crossing that is used, because near its ends a gap transmits torque too."""
LEAST_SPEED_RAD_S = 0.02
LEAST_SAMPLES = 5
INERTIA, RISE = 0, 2
"""Indices of the regressors of the rotor's inertia and of the torque that rises in a crossing."""


@dataclass(frozen=True)
class Crossing:
    """Torque estimated from the crossings of a gap or a hysteresis loop."""

    inertia: float  # inertia of the rotor at the joint, kg m^2
    torque: float  # torque that closes the loop, N m; about zero for a gap
    torque_error: float  # standard error of this torque, N m
    share: float  # ratio of this torque to the torque of the motion
    error: float  # standard error of the ratio, from the scatter over crossings and `gap_scatter`


def crossing_torque(
    views: Sequence[View], nominal: Nominal, gap: float, rotor: float
) -> Crossing | None:
    """Return the torque during crossings of a gap of width ``gap``, or None if too few crossings
    have enough samples.

    Args:
        views: Recordings, with friction as a function of the motion of the valve.
        nominal: Nominal values, whose friction and inertia are used if a weight turns with the
            joint.
        gap: Width of the gap, or twice the deflection of a loop, rad.
        rotor: Assumed inertia of the rotor at the joint, kg m^2.
    """
    parts, torques, moving = [], [], []
    for view in views:
        if view.lag is None:
            continue
        columns, way = _columns(view, nominal, gap, rotor)
        parts += [columns[a:b] for a, b in way]
        torques += [(view.raw_torque - view.known)[a:b] for a, b in way]
        moving.append(np.abs(view.transmitted[~view.still]))
    if len(parts) < RULES.least_crossings:
        return None
    columns, torque = np.concatenate(parts), np.concatenate(torques)
    bread = np.linalg.pinv(columns.T @ columns, hermitian=True)
    found = bread @ (columns.T @ torque)
    scores = np.stack([c.T @ (t - c @ found) for c, t in zip(parts, torques, strict=True)])
    spread = math.sqrt(float((bread @ (scores.T @ scores) @ bread)[RISE, RISE]))
    usual = float(np.median(np.concatenate(moving)))
    inertia, rise = float(found[INERTIA]), float(found[RISE])
    error = math.hypot(spread / usual, RULES.gap_scatter)
    return Crossing(inertia, rise, error * usual, rise / usual, error)


def _columns(
    view: View, nominal: Nominal, gap: float, rotor: float
) -> tuple[Array, list[tuple[int, int]]]:
    """Return regressors of the torque, shape (m, 3), and first and last sample of each crossing."""
    gear = view.recording.bench.gear_ratio
    speed = view.motor_speed / gear
    way = lead(view, nominal, gap, rotor) / (0.5 * gap)
    # If the joint falls, its weight and not the motion of the motor closes the loop.
    held = np.abs(nominal.helping(view)) < np.abs(nominal.friction(view))
    inside = held & (np.abs(way) < INNER) & (np.abs(speed) > LEAST_SPEED_RAD_S)
    columns = np.stack([_quick_acceleration(view), np.sign(speed), way], axis=1)
    return columns, [(a, b) for a, b in runs(inside) if b - a >= LEAST_SAMPLES]


def _quick_acceleration(view: View) -> Array:
    """Return the motor acceleration over the gear ratio, by differences over few samples, rad/s^2.

    A crossing lasts about ten samples. A filter does not resolve this time, and the acceleration
    that the filter removes would appear as transmitted torque.
    """
    motor, span = view.motor / view.recording.bench.gear_ratio, QUICK_SAMPLES
    padded = np.pad(motor, span, mode="edge")
    return np.asarray(
        (padded[2 * span :] - 2.0 * motor + padded[: -2 * span]) / (span * view.step) ** 2
    )


def gap_or_loop(
    baseline: Joint, joint: Joint, rounds: list[Round], terms: Sequence[Effect], steps: list[Step]
) -> tuple[Joint, list[Round]]:
    """If backlash or coupling hysteresis was identified, select one of the two by the torque that
    is transmitted during crossings; return the fit and the selection rounds.
    """
    kinds = [t for t in terms if isinstance(t, Clearance)]
    named = [e for e in joint.effects if isinstance(e.term, Clearance)]
    if not named or len(kinds) < 2:
        return joint, rounds
    views, own = baseline.views, min(named, key=_rises)
    if len(named) > 1:
        # If a transmission has both a gap and a loop, the angles resemble those of one larger gap
        # or loop.
        kept = [e for e in joint.effects if e is own or e not in named]
        joint = baseline.again(joint.nominal, kept)
        others = {e.term.name for e in named if e is not own}
        rounds = [r for r in rounds if r.name not in others]
        own = next(e for e in joint.effects if e.term.name == own.term.name)
    gap, rotor = _kind(own).travel_and_rotor(own.shape)
    seen = crossing_torque(views, joint.nominal, gap, rotor)
    kind = next(k for k in kinds if k.torque_rises != _rises(own))
    assumed = ROTOR_SHARE * joint.nominal.get("J")
    other = _with_travel(kind, gap, seen, assumed, count_of_twist(views))
    rest = tuple(e for e in joint.effects if e is not own)
    beside = baseline.again(joint.nominal, (*rest, other))
    prefers_other = _preference(views, own, joint, beside, seen)
    best, loser, name = (
        (beside, joint, other.term.name) if prefers_other > 0.0 else (joint, beside, own.term.name)
    )
    both = {own.term.name, other.term.name}
    rival = Contender((both - {name}).pop(), loser, abs(prefers_other), "")
    if seen is None:
        note = "too few crossings last long enough to distinguish a gap from a hysteresis loop"
    else:
        note = (
            f"closes with a torque of {seen.torque:.2g} {baseline.unit}, "
            f"{100.0 * seen.share:.1f} % of the torque of the motion"
        )
    steps.append(Step("crossing", name, None, loser.cost - best.cost, note))
    out = [
        Round(name, (rival, *(r for r in taken.rivals if r.name not in both)), taken.unconfirmed)
        if taken.name == own.term.name
        else taken
        for taken in rounds
    ]
    return best, out


def _preference(
    views: Sequence[View], own: Added, joint: Joint, beside: Joint, seen: Crossing | None
) -> float:
    """Return by how many standard errors the other effect of the pair is preferred to ``own``."""
    loop = own if _rises(own) else beside.effects[-1]
    prefers_loop = (
        _loop_preference(views, _kind(loop).closing_torque(loop.shape))
        if seen is None
        else (seen.share - RULES.loop_share) / seen.error
    )
    prefers_other = -prefers_loop if _rises(own) else prefers_loop
    if _weight_exceeds_friction(views, joint.nominal):
        # If a weight exceeds the friction, a gap and a loop differ in the angles too; the tests by
        # angles and by torque are combined by Stouffer's sum.
        prefers_other = (prefers_other - advantage(joint, beside)) / (
            1.0 if seen is None else math.sqrt(2.0)
        )
    return prefers_other


def _loop_preference(views: Sequence[View], torque: float) -> float:
    """Return by how many standard errors a loop with this closing ``torque`` (N m), fitted to the
    angles, is preferred to a gap.

    The result is at most zero. A loop that closes without torque equals a gap, which has one
    parameter less; a loop that closes with a torque is compared with a gap by the angles elsewhere.
    """
    usual = float(
        np.median(
            np.concatenate([np.abs(v.transmitted[~v.still]) for v in views if v.lag is not None])
        )
    )
    return min(0.0, (torque / usual - RULES.loop_share) / RULES.gap_scatter)


def _weight_exceeds_friction(views: Sequence[View], nominal: Nominal) -> bool:
    """Whether in all recordings a weight turns with the joint and its torque in motion exceeds the
    friction.

    If only some recordings have such a weight, the crossings in the other recordings determine the
    torque better than a model of the falling joint.
    """
    if not all(v.burdened for v in views):
        return False
    return any(
        np.any((np.abs(nominal.helping(v)) > np.abs(nominal.friction(v))) & ~v.still) for v in views
    )


def _with_travel(
    kind: Clearance, travel: float, seen: Crossing | None, rotor: float, twist: float
) -> Added:
    """Return start values of the other effect of the pair, with the travel of the first."""
    if not kind.torque_rises or seen is None or seen.torque <= 0.0:
        return Added(*kind.of_travel(travel, rotor, twist, None), (1.0,))
    found = seen.inertia if seen.inertia > 0.0 else rotor
    return Added(*kind.of_travel(travel, found, twist, (seen.torque, seen.torque_error)), (1.0,))


def distinguished_by_crossings(one: Effect, other: Effect) -> bool:
    """Whether the torque during crossings distinguishes two effects."""
    pair = isinstance(one, Clearance) and isinstance(other, Clearance)
    return pair and one.name != other.name


def _kind(effect: Added) -> Clearance:
    assert isinstance(effect.term, Clearance)
    return effect.term


def _rises(effect: Added) -> bool:
    """Whether the torque rises while the travel of an effect is crossed."""
    return _kind(effect).torque_rises
