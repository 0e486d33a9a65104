"""Feed-forward torque from identified friction (eq. 15), and torque pulses.

Friction follows the commanded speed, not the measured speed, so that feed-forward does not affect
stability. The falling branch is the range of speeds in which friction falls with speed (eq. 9 and
13, from rest on). On the falling branch a joint with soft position gains sticks and slips, even if
the mean friction torque is compensated. :mod:`identification.model.feedback` returns the damping
that stabilises the falling branch, as far as the delay of a bus allows. If this damping is too
small, the feed-forward torque is pulsed: the joint then crosses the falling branch many times a
second, and not in a slower limit cycle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.model.feedback import gains
from identification.model.friction import load_coefficient, system_friction
from identification.numerics.arrays import Array

SMOOTHING_RAD_S = 1e-3
"""Commanded speed over which the sign of friction changes smoothly; an encoder does not resolve
this speed in one cycle.
"""
RISE_SHARE = 0.4
"""Share of the rise from Coulomb to static friction that the mean torque with pulses contains; with
a smaller share the joint stops between pulses.
"""
PULSE = (1.0, -0.5, -0.5)
"""One pulse, one value per control cycle, as multiples of the pulse height; the mean is zero.

A pulse after which the joint comes to rest takes at least three control cycles.
"""
_PULSE_SPEEDS = 2.0
"""Speed to which a pulse accelerates the inertia without friction, relative to the speed up to
which friction falls.
"""
_PULSE_END = 1.5
"""Commanded speed at which pulses fade, relative to the speed up to which friction falls."""
_GRID_POINTS = 2000
_GRID_SPAN = 4.0
"""Speed, in Stribeck speeds, beyond which the friction of eq. 9 and 13 rises again."""


def commanded_speed(angle: Array, period: float) -> Array:
    """Return the speed at which each commanded angle is approached from the previous angle, rad/s,
    shape (n,).
    """
    return np.diff(angle, prepend=angle[:1]) / period


def motion(angle: Array, period: float) -> Array:
    """Return the smooth sign of the commanded speed: -1 to 1, and 0 at rest, shape (n,)."""
    return np.tanh(commanded_speed(angle, period) / SMOOTHING_RAD_S)


def feedforward(
    angle: Array, period: float, parameters: Mapping[str, float], alpha: float, moment: float
) -> Array:
    """Return the feed-forward torque of a commanded motion at the joint by eq. 15: friction,
    working load and inertia.

    At speeds where friction falls with speed more steeply than the damping of
    :mod:`~identification.model.feedback` can stabilise, the static friction is replaced by a share
    of the rise from Coulomb to static friction, plus :func:`pulses`. The whole static friction as
    feed-forward torque would accelerate a joint that has broken away.

    Args:
        angle: Commanded joint angles, rad, one per period, shape (n,); each is reached at the end
            of its period.
        period: s.
        parameters: ``Mc``, ``Ms``, ``omega_sf``, ``sigma_2``, ``J`` and, under load, the four of
            eq. 12; SI.
        alpha: Stribeck exponent.
        moment: Contact moment F_P L1, N m.

    Returns:
        Torque for the period that ends at each angle, N m, shape (n,). At the start of a motion
        this torque is the static friction.
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
    """Return the torque pulses of a commanded motion, N m, shape (n,); zero where the damping is
    greater than the fall of friction with speed.

    On the falling branch of friction a joint under a steady torque sticks or runs away. With a
    torque above the static friction for one control cycle, and below the kinetic friction for two,
    the joint makes a small step that ends before the joint runs away. A pulse is as high as is
    needed to accelerate the inertia without friction to twice the speed up to which friction falls.
    The height is limited so that the torque does not reverse between pulses, because after a
    reversal the other flanks of the gear teeth would be in contact. At commanded speeds above the
    falling branch of friction the height of the pulses falls to zero.

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
    if friction never falls faster.

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
