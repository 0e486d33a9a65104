"""Torque that a drive is to add, from identified parameters: what the commanded motion will meet, and damping.

Friction follows the commanded speed, not the measured one, so that this part changes no stability. It cannot: where
friction falls as speed rises (eq. 9 and 13 above rest) a joint that is held softly sticks and slips however well its
mean torque is known. What the falling branch takes away is given back by damping against the commanded speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.model.friction import load_coefficient, system_friction
from identification.recording import Array

SMOOTHING_RAD_S = 1e-3
"""Commanded speed over which the sign of friction changes: below what any encoder of this kind resolves in a cycle."""
PHASE_MARGIN_RAD = math.pi / 4.0
"""What damping may leave of the quarter turn that an inertia and a delay share."""
DELAY_CYCLES = 2.0
"""From the middle of the interval whose speed is measured to that of the one in which the torque acts."""
RISE_SHARE = 0.75
"""Share of friction's rise toward rest that is fed forward where damping cannot outweigh the fall that follows it."""
_GRID_POINTS = 2000
_GRID_SPAN = 4.0  # in Stribeck speeds; beyond, eq. 9 and 13 rise again


def commanded_speed(angle: Array, period: float) -> Array:
    """Return the speed at which each commanded angle is approached from the one before it, rad/s, shape (n,)."""
    return np.diff(angle, prepend=angle[:1]) / period


def motion(angle: Array, period: float) -> Array:
    """Return the smooth sign of the commanded speed: -1 to 1, and 0 at rest, shape (n,)."""
    return np.tanh(commanded_speed(angle, period) / SMOOTHING_RAD_S)


def feedforward(angle: Array, period: float, parameters: Mapping[str, float], alpha: float, moment: float) -> Array:
    """Return the joint torque to feed forward for a commanded motion, by eq. 15: friction, working load and inertia.

    Where friction falls by more than :func:`damping` gives back, the joint will slip whatever is done, and its whole
    static friction fed forward drives the slip on; a part of the rise is left to the loop then.

    Args:
        angle: Commanded joint angles, rad, one a period, shape (n,); each is reached at the end of its period.
        period: s.
        parameters: ``Mc``, ``Ms``, ``omega_sf``, ``sigma_2``, ``J`` and, under load, the four of eq. 12; SI.
        alpha: Stribeck exponent.
        moment: Contact moment F_P L1, N m.

    Returns:
        N m, shape (n,), for the period that ends at each angle. At the start of a motion it is the static friction.
    """
    tame = damping(parameters, alpha, moment, period) >= steepest_fall(parameters, alpha, moment)
    parameters = _with_rise(parameters, 1.0 if tame else RISE_SHARE, moment)
    speed = commanded_speed(angle, period)
    magnitude = np.abs(speed)
    friction = system_friction(magnitude, parameters, alpha)
    if moment:
        friction = friction + moment * load_coefficient(magnitude, parameters, alpha)
    after, before = np.append(speed[1:], 0.0), np.insert(speed[:-1], 0, 0.0)
    acceleration = (after - before) / (2.0 * period)
    return np.asarray(motion(angle, period) * friction + parameters["J"] * acceleration)


def _with_rise(parameters: Mapping[str, float], share: float, moment: float) -> dict[str, float]:
    """Return the parameters with this share of the rise from Coulomb to static friction, eq. 9 and 12."""
    p = dict(parameters)
    p["Ms"] = p["Mc"] + share * (p["Ms"] - p["Mc"])
    if moment:
        p["mu_s"] = p["mu_c"] + share * (p["mu_s"] - p["mu_c"])
    return p


def steepest_fall(parameters: Mapping[str, float], alpha: float, moment: float) -> float:
    """Return how fast friction falls with speed where it falls fastest, N m s/rad; 0 where it never does."""
    widest = max(parameters["omega_sf"], parameters["omega_sL"] if moment else 0.0)
    speed = np.linspace(0.0, _GRID_SPAN * widest, _GRID_POINTS)[1:]
    friction = system_friction(speed, parameters, alpha)
    if moment:
        friction = friction + moment * load_coefficient(speed, parameters, alpha)
    return max(0.0, -float(np.min(np.diff(friction) / np.diff(speed))))


def damping(parameters: Mapping[str, float], alpha: float, moment: float, period: float) -> float:
    """Return the damping to add against the commanded speed, N m s/rad.

    A quarter more than friction falls by, so that what is left still damps; but no more than leaves 45 degrees of
    phase at the crossover D/J of the inertia alone, over the delay from the speed's measurement to the torque's effect.
    """
    allowed = PHASE_MARGIN_RAD * parameters["J"] / (DELAY_CYCLES * period)
    return min(1.25 * steepest_fall(parameters, alpha, moment), allowed)
