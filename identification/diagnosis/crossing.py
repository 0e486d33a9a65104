"""What tells a gap from a coupling's hysteresis: the torque that passes while one side moves and
the other stands.

Where friction holds the valve until the loop is closed both move alike, to within the encoders. But
a gap is crossed without torque, T = J_r domega_m/dt, and a loop with one that rises: T = J_r
domega_m/dt + w (s + u), where J_r is the rotor's inertia, w the torque that closes the loop, s the
direction, and u from -1 to 1 how far it has come.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnosis.contest import Contender, Round, preference
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.result import Step
from identification.diagnosis.rows.marks import QUICK_SAMPLES
from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.term import Term
from identification.diagnosis.terms.transmission import (
    ROTOR_SHARE,
    TWIST_COUNTS,
    Gap,
    Loop,
    count_of_twist,
    lead,
)
from identification.recording import Array

PAIR = ("backlash", "coupling_hysteresis")
INNER = 0.6
"""Share of the way that counts, about its middle: at the flanks torque has begun to pass."""
LEAST_SPEED_RAD_S = 0.02
LEAST_SAMPLES = 5
LEAST_CROSSINGS = 10
CARRIED = 0.06
"""Torque that closes the loop, over that of the motion, from which it is no gap."""
SLACK = 0.02
"""Standard deviation of that share where there is a gap, as measured on simulated rigs."""


@dataclass(frozen=True)
class Crossing:
    """What the crossings of a gap say.

    Attributes:
        inertia: Of the rotor at the joint, kg m^2.
        torque: That closes the loop, N m; about zero for a gap.
        share: Of the torque of the motion.
        error: Standard error of the share, by crossings, and what a gap itself came to.
    """

    inertia: float
    torque: float
    share: float
    error: float


def crossed(views: Sequence[View], nominal: Nominal, gap: float, rotor: float) -> Crossing | None:
    """Return what the torque does while a gap of this size is crossed; None where too few crossings
    last long enough.

    Args:
        views: On the valve's side.
        nominal: Of which a gap under a weight needs friction and inertia.
        gap: rad; twice the deflection of a loop.
        rotor: The rotor's inertia at the joint, as far as it is known, kg m^2.
    """
    parts, torques, moving = [], [], []
    for view in views:
        if view.lag is None:
            continue
        columns, way = _columns(view, nominal, gap, rotor)
        parts += [columns[a:b] for a, b in way]
        torques += [(view.raw_torque - view.known)[a:b] for a, b in way]
        moving.append(np.abs(view.transmitted[~view.still]))
    if len(parts) < LEAST_CROSSINGS:
        return None
    columns, torque = np.concatenate(parts), np.concatenate(torques)
    bread = np.linalg.pinv(columns.T @ columns, hermitian=True)
    found = bread @ (columns.T @ torque)
    scores = np.stack([c.T @ (t - c @ found) for c, t in zip(parts, torques, strict=True)])
    spread = math.sqrt(float((bread @ (scores.T @ scores) @ bread)[1, 1]))
    usual = float(np.median(np.concatenate(moving)))
    return Crossing(
        float(found[0]), float(found[1]), float(found[1]) / usual, math.hypot(spread / usual, SLACK)
    )


def _columns(
    view: View, nominal: Nominal, gap: float, rotor: float
) -> tuple[Array, list[tuple[int, int]]]:
    """Return (regressors of the drive's torque, shape (m, 2)) and from where to where each crossing
    lasts.
    """
    gear = view.recording.bench.gear_ratio
    speed = view.motor_speed / gear
    way = lead(view, nominal, gap, rotor) / (0.5 * gap)
    # A joint that falls closes a loop by its weight, not by the motor's way.
    held = np.abs(nominal.helping(view)) < np.abs(nominal.friction(view))
    inside = held & (np.abs(way) < INNER) & (np.abs(speed) > LEAST_SPEED_RAD_S)
    turns = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    columns = np.stack([_quick_acceleration(view), np.sign(speed) + way], axis=1)
    return columns, [(int(a), int(b)) for a, b in turns.reshape(-1, 2) if b - a >= LEAST_SAMPLES]


def _quick_acceleration(view: View) -> Array:
    """Return the motor's acceleration at the joint within a few samples, hardly filtered, rad/s^2.

    A crossing of ten samples is over before a filter shows it; what the filter takes from the rotor
    passes for torque.
    """
    motor, span = view.motor / view.recording.bench.gear_ratio, QUICK_SAMPLES
    padded = np.pad(motor, span, mode="edge")
    return np.asarray(
        (padded[2 * span :] - 2.0 * motor + padded[: -2 * span]) / (span * view.step) ** 2
    )


def told_apart(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    rounds: list[Round],
    terms: Sequence[Term],
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Decide between a gap and a coupling's loop, where one of them was named, by what passes
    during a crossing.
    """
    named = [e for e in joint.effects if e.term.name in PAIR]
    by_name = {t.name: t for t in terms}
    if not named or not set(PAIR) <= by_name.keys():
        return joint, rounds
    own = min(named, key=lambda e: PAIR.index(e.term.name))
    if len(named) > 1:
        # A gap and a loop in one transmission add up to what one of them alone could be.
        joint = fit(
            views,
            unit,
            joint.nominal,
            [e for e in joint.effects if e is own or e not in named],
            baseline,
        )
        rounds = [r for r in rounds if r.name == own.term.name or r.name not in PAIR]
        own = next(e for e in joint.effects if e.term.name == own.term.name)
    gap, rotor = _gap_and_rotor(own)
    seen = crossed(views, joint.nominal, gap, rotor)
    other = _other(
        own, by_name, gap, seen, ROTOR_SHARE * joint.nominal.get("J"), count_of_twist(views)
    )
    rest = tuple(e for e in joint.effects if e is not own)
    beside = fit(views, unit, joint.nominal, (*rest, other), baseline)
    prefers_other = _preference(views, own, joint, beside, seen)
    best, loser, name = (
        (beside, joint, other.term.name) if prefers_other > 0.0 else (joint, beside, own.term.name)
    )
    rival = Contender(next(n for n in PAIR if n != name), loser, abs(prefers_other), "")
    if seen is None:
        note = "no crossing lasts long enough to tell a gap from a loop"
    else:
        note = (
            f"closes with {seen.torque:.2g} {unit}, {100.0 * seen.share:.1f} % of the motion's "
            f"torque"
        )
    steps.append(Step("crossing", name, None, loser.cost - best.cost, note))
    out = [
        Round(name, (rival, *(r for r in taken.rivals if r.name not in PAIR)))
        if taken.name == own.term.name
        else taken
        for taken in rounds
    ]
    return best, out


def _preference(
    views: Sequence[View], own: Added, joint: Joint, beside: Joint, seen: Crossing | None
) -> float:
    """Return how far the other of the pair is preferred to the one that was named, in standard
    errors.

    Args:
        views: Recordings.
        own: The one that was named.
        joint: Fit with it.
        beside: Fit with the other in its place, which is its last effect.
        seen: What the crossings say; None where none lasts long enough.
    """
    loop = Loop(*(own if own.term.name != "backlash" else beside.effects[-1]).shape)
    prefers_loop = (
        _empty(views, loop.torque) if seen is None else (seen.share - CARRIED) / seen.error
    )
    prefers_other = prefers_loop if own.term.name == "backlash" else -prefers_loop
    if _falls(views, joint.nominal):
        # Under such a weight the two do not move alike, and the angles tell as well: Stouffer's
        # sum.
        prefers_other = (prefers_other - preference(joint, beside)) / (
            1.0 if seen is None else math.sqrt(2.0)
        )
    return prefers_other


def _gap_and_rotor(effect: Added) -> tuple[float, float]:
    """Return how far one side moves alone, rad, and the inertia of the rotor, kg m^2, as a gap or a
    loop says.
    """
    if effect.term.name == "backlash":
        return Gap(*effect.shape).width, Gap(*effect.shape).rotor
    return 2.0 * Loop(*effect.shape).deflection, Loop(*effect.shape).rotor


def _empty(views: Sequence[View], torque: float) -> float:
    """Return how far a loop is preferred to a gap, in standard errors, by the torque (N m) that the
    angles give it.

    Never above zero: a loop that closes without torque is a gap with one number more; of one that
    closes with some the angles have judged already.
    """
    usual = float(
        np.median(
            np.concatenate([np.abs(v.transmitted[~v.still]) for v in views if v.lag is not None])
        )
    )
    return min(0.0, (torque / usual - CARRIED) / SLACK)


def _falls(views: Sequence[View], nominal: Nominal) -> bool:
    """Whether a weight turns with the joint throughout that in motion is more than its friction
    holds.

    Where it does so in some recordings only, the crossings in the others tell more than any model
    of a fall.
    """
    if not all(v.burdened for v in views):
        return False
    return any(
        np.any((np.abs(nominal.helping(v)) > np.abs(nominal.friction(v))) & ~v.still) for v in views
    )


def _other(
    own: Added,
    by_name: dict[str, Term],
    gap: float,
    seen: Crossing | None,
    rotor: float,
    twist: float,
) -> Added:
    """Return the other of the pair, as large as the one that was named; the loop with the torque
    that was seen.

    Its fit begins from the rotor's inertia that was seen as well, or from a supposed one,
    ``rotor``, kg m^2; a gap's from a shaft that twists by ``twist``, rad/(N m), for each count.
    """
    counts = 0.5 * TWIST_COUNTS[1]
    if own.term.name != "backlash":
        return Added(by_name["backlash"], Gap(gap, counts, twist, rotor), (1.0,))
    term, loop = by_name["coupling_hysteresis"], Loop(1.0, rotor, 0.5 * gap, counts, twist)
    if seen is None or seen.torque <= 0.0:
        return Added(term, loop, (1.0,))
    loop = loop._replace(torque=seen.torque, rotor=seen.inertia if seen.inertia > 0.0 else rotor)
    # Of the torque a crossing says more than the angles do; what else a shape says is sought.
    sought = {k: reach for k, reach in term.refine.items() if Loop._fields[k] != "torque"}
    return Added(replace(term, refine=sought), loop, (1.0,))
