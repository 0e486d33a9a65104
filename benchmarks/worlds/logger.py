"""Logger of a world: converts signals at the rate of the loops to columns at the rate of the log.

Effects of sensors and logger are applied here, because they change the logged values and not the
motion.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from benchmarks.worlds.world import LINE_M, LINES_PER_TURN, Array, Signals, World

Columns = dict[str, Array]
Rows = NDArray[np.int64]


def columns(world: World, k: int, signals: Signals, rng: np.random.Generator) -> Columns:
    """Return the logged columns of recording ``k``: canonical names, SI units, one row for each
    time stamp.

    Args:
        world: The world.
        k: Number of the recording, from 0.
        signals: Signals of the plant in this recording.
        rng: Generator of the noise of this recording.
    """
    step = world.drive.rate_Hz // world.log.rate_Hz
    rows: Rows = np.arange(step, len(signals.current), step, dtype=np.int64)
    time = rows / world.drive.rate_Hz
    jitter = world.log.jitter / world.log.rate_Hz * rng.standard_normal(len(rows))
    limit = 0.45 / world.log.rate_Hz
    start = signals.start_s if world.log.clock else 0.0
    out = {
        "time": start + time - time[0] + np.clip(jitter, -limit, limit),
        "current": _current(world, signals, rows, step, rng),
    }
    if world.recordings[k].torque is None:
        out["command"] = signals.command[rows]
    if world.log.voltage != "absent":
        out["voltage"] = _voltage(world, signals, rows, step, rng)
    if world.log.supply:
        noise = world.sensing.voltage_noise_V * rng.standard_normal(len(rows))
        out["supply_voltage"] = signals.supply[rows] + noise
    if (count := world.motor_count_rad) is not None:
        shaft = _late(world, signals.motor_angle, "angles")
        out["motor_angle"] = _counted(shaft[rows], count, world.sensing.flicker, rng)
    if (count := world.joint_count_rad) is not None:
        joint = _joint(world, k, signals, rows)
        out["angle"] = _counted(joint, count, world.sensing.flicker, rng)
    return out


def _current(
    world: World, signals: Signals, rows: Rows, step: int, rng: np.random.Generator
) -> Array:
    current = _late(world, signals.current, "current")
    log, sensing = world.log, world.sensing
    if log.current == "averaged":
        between = 0.5 * (current[1:] + current[:-1])
        if signals.mean_current is not None:
            between = _late(world, signals.mean_current, "current")[:-1]
        sums = np.concatenate(([0.0], np.cumsum(between)))
        logged = (sums[rows] - sums[rows - step]) / step
        noise = sensing.current_noise_A / np.sqrt(step)
    else:
        if log.current == "filtered":
            a = 1.0 - np.exp(-2.0 * np.pi * log.filter_Hz / world.drive.rate_Hz)
            current = lfilter([a], [1.0, a - 1.0], current, zi=[(1.0 - a) * current[0]])[0]
        logged, noise = current[rows], sensing.current_noise_A
    logged = logged + noise * rng.standard_normal(len(rows))
    logged += world.effects.get("current_offset", {}).get("current_A", 0.0)
    logged += world.effects.get("current_drift", {}).get("rate_A_s", 0.0) * (
        rows / world.drive.rate_Hz
    )
    quantum = sensing.current_quantum_A
    return np.asarray(np.round(logged / quantum) * quantum)


def _voltage(
    world: World, signals: Signals, rows: Rows, step: int, rng: np.random.Generator
) -> Array:
    if world.log.voltage == "commanded":
        return np.asarray(signals.voltage[rows])
    sums = np.concatenate(([0.0], np.cumsum(signals.terminal)))
    mean = (sums[rows] - sums[rows - step]) / step
    return np.asarray(mean + world.sensing.voltage_noise_V * rng.standard_normal(len(rows)))


def _joint(world: World, k: int, signals: Signals, rows: Rows) -> Array:
    """Return the angle at the joint encoder before counts are taken, at the rows of the log."""
    late = world.effects.get("transport_delay", {}).get("time_s", 0.0)
    angle = _late(world, signals.angle, "angles", late)[rows]
    seat: Mapping[str, float] = world.effects.get("encoder_eccentricity", {})
    angle = angle + seat.get("amplitude_rad", 0.0) * np.sin(angle + seat.get("phase_rad", 0.0))
    slip = world.effects.get("encoder_slip")
    if slip is not None:
        number = round(slip["recording"])
        after = rows / world.drive.rate_Hz > slip["at_s"] if k + 1 == number else k + 1 > number
        angle = angle + slip["angle_rad"] * after
    pitch = 2.0 * np.pi / LINES_PER_TURN if world.motion == "rotary" else LINE_M
    return np.asarray(
        angle + world.sensing.lines_error * pitch * np.sin(2.0 * np.pi * angle / pitch)
    )


def _counted(angle: Array, count: float, flicker: float, rng: np.random.Generator) -> Array:
    """Return an angle in whole counts; noise makes an angle near the edge of a count flicker."""
    noise = flicker * rng.standard_normal(len(angle))
    return np.asarray(np.round(angle / count + noise) * count)


def _late(world: World, signal: Array, channel: str, further_s: float = 0.0) -> Array:
    """Return a signal delayed by the sampling delay of its channel.

    With a positive ``time_skew``, the current is late relative to the angles; with a negative
    ``time_skew``, the angles are late relative to current and voltage.
    """
    skew = world.effects.get("time_skew", {}).get("time_s", 0.0)
    late_s = further_s + (max(skew, 0.0) if channel == "current" else max(-skew, 0.0))
    if late_s == 0.0:
        return signal
    at = np.arange(len(signal)) - late_s * world.drive.rate_Hz
    return np.asarray(np.interp(at, np.arange(len(signal)), signal))
