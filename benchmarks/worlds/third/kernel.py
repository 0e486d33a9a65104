"""One recording of the world of :mod:`benchmarks.worlds.third.physics`: steps between two ticks of
the drive, cut at events, and the drive itself.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.worlds.third.physics import (
    AGES,
    COULOMB,
    CURRENT,
    DAHL,
    DEAD,
    E_1,
    E_2,
    GEAR,
    HEAT,
    HEAT_S,
    LAGS,
    LOSSY,
    LOSSY_RAD,
    PHI,
    REST,
    SAG,
    SLIDES,
    SLIDES_M,
    SLOW,
    STATE,
    STATIC,
    SUPPLY,
    TEMPERATURE,
    THETA,
    TORQUE_LAG,
    W_M,
    W_S,
    WORKING,
    R,
    W,
    Z,
    level,
    motor_level,
    pushes,
    rates,
    two_bodies,
)  # fmt: skip
from identification.numerics.compiled import compiled

# The drive's settings and states, by their place.
(TICK, CASCADE, K_P, K_V, K_I, AHEAD, WINDOW, BEAT, PER_A, MOST_A, MOST_V, COUNT, AT_MOTOR,
 R_KNOWN, L_KNOWN, K_KNOWN, HOST, BEGIN, SETTINGS) = range(19)  # fmt: skip
STILL = 1e-12
BARELY = 1e-9
"""Share of a step: an event so early is one of a body that was about to let go."""


@compiled
def settle(p, y, since):
    """Let stuck bodies go whose torque exceeds the static limit."""
    at_motor, at_joint = pushes(p, y, since)
    if y[SLIDES] == 0.0 and p[DAHL] == 0.0:
        way = 1.0 if at_joint > 0.0 else -1.0
        if abs(at_joint) > level(p, y, 0.0, way, since):
            y[SLIDES] = way
    if two_bodies(p) and y[SLIDES_M] == 0.0 and abs(at_motor) > motor_level(p, 0.0):
        y[SLIDES_M] = 1.0 if at_motor > 0.0 else -1.0


@compiled
def runge_kutta(p, y, voltage, since, h, trial):
    """Write the state after a step of ``h`` into ``trial``, bodies staying stuck or sliding."""
    k1, k2, k3, k4 = np.zeros(W + 1), np.zeros(W + 1), np.zeros(W + 1), np.zeros(W + 1)
    rates(p, y, voltage, since, k1)
    trial[:] = y
    for j in range(W + 1):
        trial[j] = y[j] + 0.5 * h * k1[j]
    rates(p, trial, voltage, since + 0.5 * h, k2)
    for j in range(W + 1):
        trial[j] = y[j] + 0.5 * h * k2[j]
    rates(p, trial, voltage, since + 0.5 * h, k3)
    for j in range(W + 1):
        trial[j] = y[j] + h * k3[j]
    rates(p, trial, voltage, since + h, k4)
    for j in range(W + 1):
        trial[j] = y[j] + h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])


@compiled
def crossing(before, after, way):
    """Return the share of a step after which a sliding body's speed reaches zero; 2 if it does
    not.
    """
    if way == 0.0 or after * way >= 0.0 or before * way < 0.0:
        return 2.0
    return before / (before - after)


@compiled
def step(p, y, voltage, since, h, trial):
    """Advance the state by ``h``; at most eight events."""
    left = h
    for _ in range(8):
        if left <= STILL:
            break
        settle(p, y, since)
        runge_kutta(p, y, voltage, since, left, trial)
        joint = 2.0 if p[DAHL] > 0.0 else crossing(y[W], trial[W], y[SLIDES])
        motor = crossing(y[W_M], trial[W_M], y[SLIDES_M]) if two_bodies(p) else 2.0
        first = min(joint, motor)
        took = left
        if first <= BARELY:
            # It would let go and come to rest within this step: it does not let go.
            if joint <= BARELY:
                y[W], y[SLIDES] = 0.0, 0.0
            if motor <= BARELY:
                y[W_M], y[SLIDES_M] = 0.0, 0.0
            runge_kutta(p, y, voltage, since, left, trial)
            joint = motor = first = 2.0
        if first <= 1.0:
            took = first * left
            runge_kutta(p, y, voltage, since, took, trial)
        for j in range(W + 1):
            y[j] = trial[j]
        if first <= 1.0:
            if joint <= motor:
                y[W], y[SLIDES] = 0.0, 0.0
            if motor <= joint:
                y[W_M], y[SLIDES_M] = 0.0, 0.0
        memories(p, y, took)
        since += took
        left -= took
    if not two_bodies(p):
        y[PHI], y[W_M] = y[THETA], y[W]


@compiled
def memories(p, y, h):
    """Advance what remembers: lags, rest, bristles, sliders and heat; each exact for constant
    input.
    """
    if p[TORQUE_LAG] > 0.0:
        y[WORKING] += (y[CURRENT] - y[WORKING]) * -math.expm1(-h / p[TORQUE_LAG])
    if p[LAGS] > 0.0:
        y[SLOW] += (y[W] - y[SLOW]) * -math.expm1(-h / p[LAGS])
    if p[AGES] > 0.0:
        if y[SLIDES] == 0.0:
            y[REST] += h
        elif abs(y[W]) > 4.0 * p[W_S]:
            y[REST] = 0.0
    if p[DAHL] > 0.0 and y[W] != 0.0:
        fall = math.exp(-((y[W] / p[W_S]) ** 2))
        most = (p[COULOMB] + (p[STATIC] - p[COULOMB]) * fall) / p[DAHL]
        goal = most if y[W] > 0.0 else -most
        y[Z] = goal + (y[Z] - goal) * math.exp(-abs(y[W]) * h / most)
    if p[LOSSY] > 0.0:
        twist, yields = y[PHI] - y[THETA], p[LOSSY_RAD]
        for j, share in ((E_1, 0.3), (E_2, 0.9)):
            if twist - y[j] > share * yields:
                y[j] = twist - share * yields
            elif twist - y[j] < -share * yields:
                y[j] = twist + share * yields
    if p[HEAT] > 0.0:
        power = p[R] * (1.0 + 0.00393 * y[TEMPERATURE]) * y[CURRENT] ** 2
        goal = p[HEAT] * power
        y[TEMPERATURE] += (goal - y[TEMPERATURE]) * -math.expm1(-h / p[HEAT_S])


@compiled
def stage(p, y, voltage):
    """Return the voltage of the supply, and that at the motor for an asked ``voltage``."""
    supply = p[SUPPLY] - p[SAG] * voltage * y[CURRENT] / p[SUPPLY]
    terminal = voltage * supply / p[SUPPLY]
    if y[CURRENT] != 0.0:
        terminal -= p[DEAD] if y[CURRENT] > 0.0 else -p[DEAD]
    return supply, terminal


@compiled
def replay(p, y, inner, tick, voltage, out):
    """Play one recording without a drive: the voltage that the power stage is asked for at each
    tick is given.

    Args:
        p: Values of the physics.
        y: State at the start; the state at the end.
        inner: Steps between two ticks.
        tick: Time between two ticks.
        voltage: Voltage asked, shape (n,).
        out: Current, angle of the motor's side and of the joint, shape (3, n).
    """
    trial, h = np.zeros(STATE), tick / inner
    for k in range(len(voltage)):
        out[0, k], out[1, k], out[2, k] = y[CURRENT], y[PHI], y[THETA]
        terminal = stage(p, y, voltage[k])[1]
        for j in range(inner):
            step(p, y, terminal, k * tick + j * h, h, trial)


@compiled
def play(p, d, y, inner, sent, noise, mesh, out):
    """Play one recording.

    A host, if there is one, reads the encoder at its own ticks and sends a torque, which the drive
    makes from the host's next tick on.

    Args:
        p: Values of the physics.
        d: Settings of the drive.
        y: State at the start; the state at the end.
        inner: Steps between two ticks.
        sent: At each tick the angle sent, rad, the torque that the host has planned, N m, and
            whether it is a tick of the host, shape (3, n).
        noise: Of current and encoder, shape (2, n).
        mesh: Amplitude, count and phase of the teeth's error.
        out: Current, voltage asked, at the motor and of the supply, shaft and joint, shape (6, n).
    """
    command, push, ticks = sent[0], sent[1], sent[2]
    n, window = len(command), int(d[WINDOW])
    seen, total, sum_error = np.zeros(n), 0.0, 0.0
    if d[CASCADE] > 0.0:
        sum_error = d[BEGIN] / (d[K_I] * d[TICK])
    now = sends = d[BEGIN]
    trial = np.zeros(STATE)
    h = d[TICK] / inner
    for k in range(n):
        since = k * d[TICK]
        teeth = mesh[0] * math.sin(mesh[1] * y[THETA] + mesh[2])
        shaft = y[PHI] + teeth
        read = shaft if d[AT_MOTOR] > 0.0 else y[THETA]
        seen[k] = math.floor((read + noise[1, k]) / d[COUNT] + 0.5) * d[COUNT]
        back = min(k, window)
        speed = (seen[k] - seen[k - back]) / (back * d[TICK]) if back else 0.0
        asked_speed = (command[k] - command[k - 1]) / d[TICK] if k else 0.0
        if d[HOST] > 0.0:
            if ticks[k] > 0.0:
                now = sends
                sends = push[k] + d[K_P] * (command[k] - seen[k]) - d[K_V] * speed
            torque = now
        elif d[CASCADE] > 0.0:
            # Speed enters the proportional part alone; its error is summed up.
            wanted = d[K_P] * (command[k] - seen[k]) + d[AHEAD] * asked_speed
            sum_error += wanted - speed
            torque = d[K_I] * d[TICK] * sum_error + d[K_V] * (wanted - speed)
            if abs(torque) > d[MOST_A] * d[PER_A]:
                sum_error -= wanted - speed
        else:
            torque = d[K_P] * (command[k] - seen[k]) - d[K_V] * speed
        goal = min(max(torque / d[PER_A], -d[MOST_A]), d[MOST_A])
        # The voltage that brings the current there in some ticks, from the known motor.
        measured = y[CURRENT] + noise[0, k]
        total += (goal - measured) * d[TICK]
        need = d[R_KNOWN] * goal + d[K_KNOWN] * p[GEAR] * speed
        need += d[L_KNOWN] * (goal - measured) / (d[BEAT] * d[TICK])
        need += 20.0 * d[R_KNOWN] * total
        if abs(need) > d[MOST_V]:
            total -= (goal - measured) * d[TICK]
        voltage = min(max(need, -d[MOST_V]), d[MOST_V])
        supply, terminal = stage(p, y, voltage)
        out[0, k], out[1, k], out[2, k], out[3, k] = y[CURRENT], voltage, terminal, supply
        out[4, k], out[5, k] = shaft * p[GEAR], y[THETA]
        for j in range(inner):
            step(p, y, terminal, since + j * h, h, trial)
