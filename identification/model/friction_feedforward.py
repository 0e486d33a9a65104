"""Feed-forward torque from identified parameters (eq. 15), and torque pulses at the falling branch
of friction.

Friction follows the commanded speed, not the measured one, so that feed-forward does not affect
stability. Where friction falls with speed (eq. 9 and 13 above rest) a softly held joint sticks and
slips even if its mean torque is known: :mod:`identification.model.feedback` returns the damping
that stabilises the falling branch, as far as the delay of a bus allows. Where that is too little,
the torque is pulsed: the joint passes the falling branch many times a second instead of in a slower
limit cycle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.model.feedback import gains
from identification.model.friction import load_coefficient, system_friction
from identification.numerics.arrays import Array

SMOOTHING_RAD_S = 1e-3
"""Commanded speed over which the sign of friction changes smoothly; encoders do not resolve it in
one cycle.
"""
RISE_SHARE = 0.4
"""Share of friction's rise toward rest that the mean torque under pulses contains; less holds the
joint between pulses.
"""
PULSE = (1.0, -0.5, -0.5)
"""One pulse, one value per cycle, in pulse heights; its mean is zero.

Three cycles are the shortest pulse with a rest.
"""
_PULSE_SPEEDS = (
    2.0  # speed that a pulse gives the bare inertia, over the speed up to which friction falls
)
_PULSE_END = 1.5  # commanded speed at which pulses fade, over the same
_GRID_POINTS = 2000
_GRID_SPAN = 4.0  # in Stribeck speeds; beyond, eq. 9 and 13 rise again


def commanded_speed(angle: Array, period: float) -> Array:
    """Return the speed at which each commanded angle is approached from the one before it, rad/s,
    shape (n,).
    """
    return np.diff(angle, prepend=angle[:1]) / period


def motion(angle: Array, period: float) -> Array:
    """Return the smooth sign of the commanded speed: -1 to 1, and 0 at rest, shape (n,)."""
    return np.tanh(commanded_speed(angle, period) / SMOOTHING_RAD_S)


def feedforward(
    angle: Array, period: float, parameters: Mapping[str, float], alpha: float, moment: float
) -> Array:
    """Return the joint torque to feed forward for a commanded motion, by eq. 15: friction, working
    load and inertia.

    Where friction falls faster than damping compensates, a share of the rise and :func:`pulses`
    replace the static friction: fed forward as a whole, it would accelerate a joint that has broken
    away.

    Args:
        angle: Commanded joint angles, rad, one per period, shape (n,); each is reached at the end
            of its period.
        period: s.
        parameters: ``Mc``, ``Ms``, ``omega_sf``, ``sigma_2``, ``J`` and, under load, the four of
        eq. 12; SI.
        alpha: Stribeck exponent.
        moment: Contact moment F_P L1, N m.

    Returns:
        Torque for the period that ends at each angle, N m, shape (n,). At the start of a motion it
        is the static friction.
    """
    beats = pulses(angle, period, parameters, alpha, moment)
    if np.any(beats):
        parameters = _with_rise(parameters, RISE_SHARE, moment)
    speed = commanded_speed(angle, period)
    magnitude = np.abs(speed)
    friction = system_friction(magnitude, parameters, alpha)
    if moment:
        friction = friction + moment * load_coefficient(magnitude, parameters, alpha)
    after, before = np.append(speed[1:], 0.0), np.insert(speed[:-1], 0, 0.0)
    acceleration = (after - before) / (2.0 * period)
    return np.asarray(motion(angle, period) * friction + parameters["J"] * acceleration + beats)


def pulses(
    angle: Array, period: float, parameters: Mapping[str, float], alpha: float, moment: float
) -> Array:
    """Return the torque pulses of a commanded motion, N m, shape (n,); zero where damping outweighs
    friction's fall.

    On the falling branch a joint under a steady torque sticks or runs away. One cycle above the
    static friction and two below the kinetic friction make a small step that ends before it can
    grow. The height of a pulse would accelerate the inertia alone to twice the speed up to which
    friction falls; it is limited so that the torque between pulses does not reverse, which would
    make the gear teeth change sides. Above the falling branch the pulses fade.

    Args:
        angle: As in :func:`feedforward`.
        period: s.
        parameters: As in :func:`feedforward`.
        alpha: Stribeck exponent.
        moment: Contact moment, N m.
    """
    until = falls_until(parameters, alpha, moment, gains(parameters["J"], period).damping)
    if until == 0.0:
        return np.zeros(len(angle))
    kinetic = parameters["Mc"] + (moment * parameters["mu_c"] if moment else 0.0)
    height = min(_PULSE_SPEEDS * parameters["J"] * until / period, kinetic / -min(PULSE))
    fade = np.exp(-((np.abs(commanded_speed(angle, period)) / (_PULSE_END * until)) ** 4))
    beat = np.resize(np.array(PULSE), len(angle))
    return np.asarray(height * beat * fade * motion(angle, period))


def falls_until(
    parameters: Mapping[str, float], alpha: float, moment: float, damping: float
) -> float:
    """Return the speed above which friction falls no faster than ``damping`` compensates, rad/s; 0
    if it never falls faster.

    Args:
        parameters: As in :func:`feedforward`.
        alpha: Stribeck exponent.
        moment: Contact moment, N m.
        damping: Damping of the loop, N m s/rad.
    """
    widest = max(parameters["omega_sf"], parameters["omega_sL"] if moment else 0.0)
    speed = np.linspace(0.0, _GRID_SPAN * widest, _GRID_POINTS)[1:]
    friction = system_friction(speed, parameters, alpha)
    if moment:
        friction = friction + moment * load_coefficient(speed, parameters, alpha)
    fall = -np.diff(friction) / np.diff(speed)
    return float(np.max(speed[1:][fall > damping], initial=0.0))


def _with_rise(parameters: Mapping[str, float], share: float, moment: float) -> dict[str, float]:
    """Return the parameters with this share of the rises Ms - Mc and mu_s - mu_c (eq. 9 and 12)."""
    p = dict(parameters)
    p["Ms"] = p["Mc"] + share * (p["Ms"] - p["Mc"])
    if moment:
        p["mu_s"] = p["mu_c"] + share * (p["mu_s"] - p["mu_c"])
    return p
