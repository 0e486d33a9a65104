"""Feed-forward torque from identified friction (eq. 15), torque pulses, and the gains of a position
loop that the host closes over the bus.

Friction follows the commanded speed, not the measured speed, so that feed-forward does not affect
stability. The falling branch is the range of speeds in which friction falls with speed (eq. 9 and
13, from rest on). On the falling branch a joint with soft position gains sticks and slips, even if
the mean friction torque is compensated. :func:`gains` returns the damping that stabilises the
falling branch, as far as the delay of a bus allows. If this damping is too small, the feed-forward
torque is pulsed: the joint then crosses the falling branch many times a second, and not in a slower
limit cycle.

A host that sends a torque with every cycle can close a position loop around the joint: K (commanded
- measured angle) + D (commanded - measured speed). For a bare inertia J and a delay tau from
measurement to effect, the open loop is L(s) = (K + D s) exp(-tau s) / (J s^2). With K = J omega^2
sin(delta), D = J omega cos(delta) the gain of the open loop is exactly one at omega, and the phase
margin is 90 deg - delta - omega tau. The crossover omega is the frequency at which the delay causes
a phase lag of 45 deg, and delta is 10 deg; the phase margin is then 35 deg and the gain margin 5.6
dB. The drive's own loops and viscous friction increase the phase margin; the lag of a current loop
reduces the phase margin (by 6 deg at 0.26 ms and 1 kHz).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.model.friction import load_coefficient, system_friction
from identification.numerics.arrays import Array

DELAY_CYCLES = 2.0
"""Delay in control cycles, from the middle of the interval over which the speed is measured to the
middle of the interval in which the torque acts.
"""
LAG_RAD = math.pi / 4.0  # phase lag of the open loop due to the delay, at the crossover
DELTA_RAD = math.pi / 18.0
"""Phase lag delta of the open loop due to the stiffness, at the crossover."""


@dataclass(frozen=True)
class Gains:
    """Stiffness and damping that a host adds at the joint."""

    stiffness: float  # K, N m/rad
    damping: float  # D, N m s/rad


def gains(inertia: float, period: float) -> Gains:
    """Return stiffness and damping for an inertia in kg m^2 and a control cycle in s."""
    crossover = LAG_RAD / (DELAY_CYCLES * period)
    return Gains(
        inertia * crossover**2 * math.sin(DELTA_RAD), inertia * crossover * math.cos(DELTA_RAD)
    )


SMOOTHING_RAD_S = 1e-3
"""Commanded speed over which friction changes sign smoothly; no encoder resolves it in a cycle."""
RISE_SHARE = 0.4
"""Share of the rise from Coulomb to static friction that the mean torque with pulses contains; with
a smaller share the joint stops between pulses.
"""
PULSE = (1.0, -0.5, -0.5)
"""One pulse, one value per control cycle, as multiples of the pulse height; the mean is zero.

A pulse after which the joint comes to rest takes at least three control cycles.
"""
_PULSE_SPEEDS = 2.0
"""Speed that a pulse gives the inertia without friction, over that up to which friction falls."""
_PULSE_END = 1.5
"""Commanded speed at which pulses fade, relative to the speed up to which friction falls."""
_GRID_POINTS = 2000
_GRID_SPAN = 4.0
"""Speed, in Stribeck speeds, beyond which the friction of eq. 9 and 13 rises again."""


def commanded_speed(angle: Array, period: float) -> Array:
    """Return the speed at which each commanded angle is approached, rad/s, shape (n,)."""
    return np.diff(angle, prepend=angle[:1]) / period


def motion(angle: Array, period: float) -> Array:
    """Return the smooth sign of the commanded speed: -1 to 1, and 0 at rest, shape (n,)."""
    return np.tanh(commanded_speed(angle, period) / SMOOTHING_RAD_S)


def feedforward(
    angle: Array, period: float, parameters: Mapping[str, float], alpha: float, moment: float
) -> Array:
    """Return the feed-forward torque of a commanded motion at the joint by eq. 15: friction,
    working load and inertia.

    At speeds where friction falls with speed more steeply than the damping of the host's loop can
    stabilise, the static friction is replaced by a share of the rise from Coulomb to static
    friction, plus :func:`pulses`. The whole static friction as feed-forward torque would accelerate
    a joint that has broken away.

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
