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
from collections.abc import Sequence

import numpy as np

from identification.numerics.arrays import Array
from identification.recording import Recording
from identification.simulate.servo_loop import Loop, usual_loop

_MEAN = 4
"""Number of samples over which torque and regressors are averaged."""
_LATENESSES = range(7)
"""Delays of the command that are tried, in cycles."""
_DELAYS_S = tuple(2e-4 * k for k in range(8))
"""Delays between the joint's motion and the loop's response that are tried, s."""
_MISFIT = 0.15
"""Greatest ratio of the rms of the residual to the rms of the torque's changes at which the
estimated loop is accepted.
"""
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
    """Return the place of the minimum of the parabola through the least of the squared misfits and
    its two neighbours; ``places`` are evenly spaced.
    """
    if not 0 < best < len(places) - 1:
        return places[best]
    before, here, after = (m * m for m in misfits[best - 1 : best + 2])
    bend = before - 2.0 * here + after
    return places[best] + (0.5 * (before - after) / bend if bend > 0.0 else 0.0) * (
        places[1] - places[0]
    )


def _fit(recordings: Sequence[Recording], late: int, delay: float) -> tuple[Array, float]:
    """Return the gains of e', e and the integral of e, and the relative misfit.

    Args:
        recordings: One or more recordings.
        late: Cycles by which the command reaches the loop late.
        delay: Delay between the joint's motion and the loop's response, s.
    """
    rows, torques = [], []
    for number, recording in enumerate(recordings):
        own, torque = _regressors(recording, late, delay)
        others = np.zeros((len(torque), len(recordings)))
        others[:, number] = 1.0
        rows.append(np.column_stack([own, others]))
        torques.append(torque)
    design, torque = np.concatenate(rows), np.concatenate(torques)
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(design / scale, torque, rcond=None)[0]
    left = torque - design / scale @ solution
    return (solution / scale)[:_GAINS], float(np.std(left) / max(float(np.std(torque)), 1e-12))


def _regressors(recording: Recording, late: int, delay: float) -> tuple[Array, Array]:
    """Return the regressors, with those of the gains first, shape (n, 6), and the torque at the
    joint, N m, shape (n,).
    """
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
