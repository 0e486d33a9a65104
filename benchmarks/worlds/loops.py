"""Computes one step of a drive around a machine that another package simulates: encoder, position
loop, velocity loop and current loop, or the torque that a host sends.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.worlds.gains import gains
from benchmarks.worlds.world import Array, World
from identification.numerics.compiled import compiled

(
    PERIOD,
    CASCADE,
    POSITION,
    VELOCITY,
    INTEGRAL,
    FORWARD,
    FILTER,
    CURRENT,
    CURRENT_INTEGRAL,
    PER_A,
    LIMIT,
    SUPPLY,
    COUNT,
    HOST,
    SETTINGS,
) = range(15)
LAST, SPEED, SUM, CURRENT_SUM, HELD, STATES = range(6)


def settings(world: World) -> Array:
    """Return the settings of the loops, in the order of the names at the top of this module."""
    drive, motor, gain = world.drive, world.motor, gains(world)
    out = np.zeros(SETTINGS)
    out[[POSITION, VELOCITY, INTEGRAL]] = gain.position, gain.velocity, gain.integral
    out[[CURRENT, CURRENT_INTEGRAL]] = gain.current, gain.current_integral
    out[PERIOD], out[CASCADE] = 1.0 / drive.rate_Hz, float(drive.kind == "cascade")
    out[HOST] = float(drive.kind in ("host", "torque"))
    out[FORWARD] = drive.feedforward
    out[FILTER] = 1.0 - math.exp(-gain.filter_rad_s / drive.rate_Hz)
    out[PER_A], out[LIMIT], out[SUPPLY] = motor.torque_per_A, motor.limit_A, motor.supply_V
    out[COUNT] = world.loop_count_rad
    return out


@compiled
def asked(p: Array, s: Array, sent: Array, angle: float, current: float) -> float:
    """Return the voltage that the drive commands, and update the states of the drive.

    Args:
        p: Settings.
        s: States.
        sent: Angle sent, rad, its speed, rad/s, torque sent, N m, and whether the host sends now,
            shape (4,).
        angle: Angle at the encoder before quantisation, rad at the joint.
        current: Measured current, A.
    """
    seen = round(angle / p[COUNT]) * p[COUNT]
    s[SPEED] += p[FILTER] * ((seen - s[LAST]) / p[PERIOD] - s[SPEED])
    s[LAST] = seen
    command, speed, given = sent[0], sent[1], sent[2]
    if p[HOST] > 0.0:
        # The drive holds the torque until the host sends the next torque.
        if sent[3] > 0.0:
            s[HELD] = given + p[POSITION] * (command - seen) - p[VELOCITY] * s[SPEED]
        torque = s[HELD]
    elif p[CASCADE] > 0.0:
        error = p[POSITION] * (command - seen) + p[FORWARD] * speed - s[SPEED]
        torque = p[VELOCITY] * error + s[SUM]
        most = p[LIMIT] * p[PER_A]
        if abs(torque) < most or torque * error < 0.0:
            s[SUM] += p[INTEGRAL] * error * p[PERIOD]
    else:
        torque = p[POSITION] * (command - seen) - p[VELOCITY] * s[SPEED]
    goal = min(max(torque / p[PER_A], -p[LIMIT]), p[LIMIT])
    gap = goal - current
    voltage = p[CURRENT] * gap + s[CURRENT_SUM]
    if abs(voltage) < p[SUPPLY] or voltage * gap < 0.0:
        s[CURRENT_SUM] += p[CURRENT_INTEGRAL] * gap * p[PERIOD]
    return float(min(max(voltage, -p[SUPPLY]), p[SUPPLY]))
