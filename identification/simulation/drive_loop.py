"""Estimates the drive's loop from recordings (M33).

With the position error e, command less angle, a drive with position P and velocity PI controllers
commands the torque Kv (e' + (Kp + Ki) e + Kp Ki int e). The logged command reaches the loop with a
delay of some cycles. The whole number of cycles is searched; the command and its derivatives are
regressors, which represent the remaining fraction of a cycle. Encoder steps and the loop's own
delay would bias Kv to lower values; therefore the regression uses means over a few samples, and the
joint angle with the delay that fits best.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.model.friction import friction, static_friction
from identification.model.parameters import INERTIA, pack
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled
from identification.numerics.least_squares import unit_columns
from identification.recording import Recording

STEPS = 20
"""Integration steps per sample at 1 kHz; under load friction falls within 100 microseconds."""
_VELOCITY_BANDWIDTH = 2.0 * math.pi * 95.0


@dataclass(frozen=True)
class Loop:
    """A drive: position P and velocity PI controller with feedforward of the commanded speed."""

    position_gain: float  # 1/s
    velocity_gain: float  # N m s/rad at the joint
    integral: float  # integral gain of the velocity loop, 1/s
    filter_Hz: float  # cut-off of the first-order filter on the measured speed
    torque_limit: float  # N m
    # Joint angle of one step of the drive's encoder, rad; 0 for an encoder without quantisation.
    # The quantised angle affects the torque through the speed filter, the quantised command through
    # the feedforward.
    count: float = 0.0
    lag: float = 0.0  # lag of the torque behind the loop's output, s; 0 for none


def usual_loop(inertia: float, torque_limit: float, count: float = 0.0) -> Loop:
    """Return a stiff servo loop: velocity bandwidth 95 Hz, position bandwidth a tenth of it."""
    position = 0.1 * _VELOCITY_BANDWIDTH
    return Loop(position, inertia * _VELOCITY_BANDWIDTH, position, 400.0, torque_limit, count)


@dataclass(frozen=True)
class Response:
    """The response of the nominal model. Arrays have shape (n,), at the joint."""

    angle: Array  # joint angle at each sample, rad
    torque: Array  # mean torque over the period that ends at each sample, N m


def respond(
    command: Array,
    period: float,
    parameters: Mapping[str, float],
    moment: float,
    alpha: float,
    loop: Loop,
    disturbance: Array | None = None,
    known: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Response:
    """Simulate the response to a command, from rest at the first value of the command, where the
    drive holds the known load.

    Args:
        command: Commanded joint angle at each sample, rad, shape (n,); linear between samples.
        period: s.
        parameters: The nine nominal parameters by name; the load parameters have no effect without
            load.
        moment: F_P L1, N m (eq. 13).
        alpha: Stribeck exponent.
        loop: The drive.
        disturbance: Logged torque less true torque on the joint in each period, N m, shape (n,),
            because the drive's current loop follows the noise of its own sensor; None for no noise.
        known: Known load on the joint: torque c - a sin(angle - b) with c, N m; a, N m; b, rad.
    """
    steps = max(1, math.ceil(STEPS * period / 1e-3))
    share = 1.0 - math.exp(-2.0 * math.pi * loop.filter_Hz * period / steps)
    lag = 1.0 - math.exp(-period / steps / loop.lag) if loop.lag > 0.0 else 1.0
    gains = [
        loop.position_gain,
        loop.velocity_gain,
        loop.integral,
        share,
        loop.torque_limit,
        loop.count,
        lag,
        *known,
    ]
    angle, torque = np.empty_like(command), np.zeros_like(command)
    lost = np.zeros_like(command) if disturbance is None else disturbance
    if loop.count > 0.0:
        command = np.rint(command / loop.count) * loop.count
    p = pack(parameters, alpha)
    _follow(command, period, p, moment, np.array(gains), steps, lost, angle, torque)
    return Response(angle, torque)


@compiled
def _follow(
    command: Array,
    period: float,
    p: Array,
    moment: float,
    gains: Array,
    steps: int,
    lost: Array,
    angle: Array,
    torque: Array,
) -> None:
    """Fill ``angle`` and ``torque``; the speed by a linearly implicit rule."""
    h = period / steps
    static = static_friction(moment, p)
    theta, omega, seen, measured, count = command[0], 0.0, 0.0, command[0], gains[5]
    integral = -(gains[7] - gains[8] * math.sin(theta - gains[9])) / gains[1]
    given = gains[1] * integral
    angle[0] = theta
    for k in range(1, len(command)):
        rate = (command[k] - command[k - 1]) / period
        total = 0.0
        for i in range(steps):
            target = command[k - 1] + rate * h * (i + 0.5)
            last, measured = measured, theta
            if count > 0.0:
                measured = count * math.floor(theta / count)
            seen += gains[3] * ((measured - last) / h - seen)
            error = gains[0] * (target - measured) + rate - seen
            drive = gains[1] * (error + integral)
            if abs(drive) <= gains[4] or drive * error < 0.0:
                integral += gains[2] * h * error
            drive = min(max(drive, -gains[4]), gains[4])
            given += gains[6] * (drive - given)
            drive = given
            total += drive
            drive += gains[7] - gains[8] * math.sin(theta - gains[9]) - lost[k]
            before = omega
            side = 1.0 if omega > 0.0 else -1.0
            if omega == 0.0:
                side = 1.0 if drive > 0.0 else -1.0
            speed = abs(omega)
            if speed == 0.0 and abs(drive) <= static:
                omega = 0.0
            else:
                force, grade = friction(speed, moment, 0.0, p)
                speed += (
                    h
                    * (side * drive - force)
                    / p[INERTIA]
                    / max(1.0 + 0.5 * h * grade / p[INERTIA], 0.5)
                )
                omega = side * max(speed, 0.0)
            theta += 0.5 * h * (before + omega)
        angle[k] = theta
        torque[k] = total / steps


_MEAN = 4  # number of samples over which torque and regressors are averaged
_LATENESSES = range(7)  # delays of the command that are tried, in cycles
_DELAYS_S = tuple(2e-4 * k for k in range(8))
"""Delays between the joint's motion and the loop's response that are tried, s."""
_MISFIT = 0.15  # greatest rms of the residual over that of the torque's changes of an accepted loop
_GAINS = 3


def drive_loop(recordings: Sequence[Recording], torque_limit: float, count: float) -> Loop | None:
    """Return the drive loop, or None if the recordings lack the signals of the loop, or if no loop
    fits the recordings.

    Args:
        recordings: Recordings of one bench; recordings that lack command, motor angle or current
            are omitted.
        torque_limit: Torque limit of the loop, N m.
        count: Joint angle of one step of the encoder that the drive follows, rad.
    """
    usable = [r for r in recordings if {"command", "motor_angle", "current"} <= r.channels.keys()]
    if not usable:
        return None
    middle = _DELAYS_S[len(_DELAYS_S) // 2]
    late = min(_LATENESSES, key=lambda cycles: _fit(usable, cycles, middle)[1])
    fits = [_fit(usable, late, delay) for delay in _DELAYS_S]
    best = min(range(len(fits)), key=lambda k: fits[k][1])
    gains, misfit = fits[best]
    if misfit > _MISFIT or np.any(gains <= 0.0):
        return None
    velocity, total, product = (
        float(gains[0]),
        float(gains[1] / gains[0]),
        float(gains[2] / gains[0]),
    )
    # Kp and Ki are the roots of a quadratic equation; if noise makes the roots complex, equal
    # values are the nearest real solution.
    half = 0.5 * total
    apart = math.sqrt(max(half * half - product, 0.0))
    usual = usual_loop(1.0, torque_limit, count)
    # The part of the delay that the speed filter does not explain is attributed to the lag of the
    # torque.
    lag = max(
        _least(_DELAYS_S, [m for _, m in fits], best) - 1.0 / (2.0 * math.pi * usual.filter_Hz), 0.0
    )
    return Loop(half + apart, velocity, half - apart, usual.filter_Hz, torque_limit, count, lag)


def _least(places: Sequence[float], misfits: Sequence[float], best: int) -> float:
    """Return the minimum of the parabola through the least squared misfit and its neighbours."""
    if not 0 < best < len(places) - 1:
        return places[best]
    before, here, after = (m * m for m in misfits[best - 1 : best + 2])
    bend = before - 2.0 * here + after
    return places[best] + (0.5 * (before - after) / bend if bend > 0.0 else 0.0) * (
        places[1] - places[0]
    )


def _fit(recordings: Sequence[Recording], late: int, delay: float) -> tuple[Array, float]:
    """Return the gains of e', e and the integral of e for these delays, and the relative misfit."""
    rows, torques = [], []
    for number, recording in enumerate(recordings):
        own, torque = _regressors(recording, late, delay)
        others = np.zeros((len(torque), len(recordings)))
        others[:, number] = 1.0
        rows.append(np.column_stack([own, others]))
        torques.append(torque)
    design, torque = np.concatenate(rows), np.concatenate(torques)
    even, scale = unit_columns(design)
    solution = np.linalg.lstsq(even, torque, rcond=None)[0]
    left = torque - even @ solution
    return (solution / scale)[:_GAINS], float(np.std(left) / max(float(np.std(torque)), 1e-12))


def _regressors(recording: Recording, late: int, delay: float) -> tuple[Array, Array]:
    """Return the regressors, those of the gains first, (n, 6), and the joint torque, N m, (n,)."""
    time, period, channels = recording.time, recording.period, recording.channels
    angle = np.interp(time - delay, time, channels["motor_angle"]) / recording.bench.gear_ratio
    command = np.concatenate([np.full(late, channels["command"][0]), channels["command"]])[
        : len(time)
    ]
    away = command - angle
    middle = 0.5 * (away[1:] + away[:-1])
    pace = np.diff(command) / period
    columns = [
        np.diff(away) / period,
        middle,
        np.cumsum(middle) * period,
        pace,
        0.5 * (command[1:] + command[:-1]),
        np.gradient(pace, period),
    ]
    torque = recording.bench.ampere_torque * channels["current"][1:]
    share = np.full(_MEAN, 1.0 / _MEAN)
    return np.column_stack([np.convolve(c, share, "valid") for c in columns]), np.convolve(
        torque, share, "valid"
    )
