"""Prepares a recording for the equation error: torque, velocity and acceleration at one stated
bandwidth.

Torque and regressors must pass the same filter, or every parameter is biased. The filter is a
symmetric FIR filter, whose outputs depend on a known range of samples. Outputs that depend on a
sample at rest are omitted, because at rest friction is not a function of speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from identification.model.gas_generator import impacted_area
from identification.model.parameters import torque_word, unit_on
from identification.numerics.arrays import Array, BoolArray
from identification.recording import Recording, RecordingError
from identification.signals import (
    Decimator,
    central_difference,
    decimator,
    derivative,
    quantum,
    reach,
    resample,
    smooth,
)


def contact_force(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return F_P on ``grid``, N, shape (n,).

    If the recording has a `load_force` channel, F_P is this channel. Otherwise, in a hot firing,
    F_P is (p_g - p_c0) A_s(theta_r) (eq. 10), with the pressure p_g of the `pressure` channel; F_P
    is zero where p_g is below the downstream pressure p_c0. In all other cases F_P is the force of
    the weight (eq. 17).

    ``angle``: valve angle at those times, rad, shape (n,).
    """
    generator = recording.bench.gas_generator
    if "load_force" in recording.channels:
        return resample(recording.time, recording.channels["load_force"], grid)
    if not recording.hot_fire:
        return np.full(len(grid), recording.contact_force)
    if generator is None:
        raise RecordingError(
            f"{recording.name}: the contact force of a hot firing, F_P = (p_g - p_c0) A_s, is "
            "computed from valve and p_c0 of bench.gas_generator, which the bench does not have"
        )
    pressure = resample(recording.time, recording.channels["pressure"], grid)
    return np.asarray(
        np.maximum(pressure - generator.p_c0, 0.0) * impacted_area(angle, generator.valve)
    )


def contact_moment(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return the contact moment F_P L1 (eq. 13, m_L), N m; arguments as :func:`contact_force`."""
    force = contact_force(recording, grid, angle)
    arm = recording.bench.moment_arm
    if arm is None:
        if np.any(force != 0.0):
            raise RecordingError(
                f"{recording.name}: a loaded recording needs bench.moment_arm (L1)"
            )
        return np.zeros(len(grid))
    return np.asarray(force * arm)


POSITION_BANDWIDTH = 2.5
"""Ratio of the position filter's cut-off to the bandwidth (EMPS benchmark: 100 Hz, 40 Hz)."""
DEFAULT_SHARE_OF_RATE = 1.0 / 25.0
"""Ratio of the default bandwidth to the sample rate, unless quantisation requires a lower one."""
SLOW_BANDWIDTH_HZ = 20.0
"""Default bandwidth of slowly sampled recordings, at most a sixth of their sample rate; the motion
of a servo drive has components up to about 20 Hz.
"""
RATE_TOLERANCE = 1e-6  # greatest relative error of the sample rate due to rounded time stamps
IRREGULAR, STANDS_OUT = 0.25, 8.0
"""Least deviation of an irregular sample interval from the median interval: as a share of the
median interval, and as a multiple of the median absolute deviation.
"""
LEAST_CLEAN = 0.1
"""Samples near a bad sample are removed if this share of the moving samples remains."""
REST_PERIODS = 6.0  # shortest rest in noise, in periods of the cut-off frequency
REST_NOISES = (
    5.0  # greatest change of a smoothed angle at rest, in standard deviations of its noise
)
REST_SAMPLES = 8  # successive samples at rest over which the angle changes by at most one step


@dataclass(frozen=True)
class Prepared:
    """The signals of one recording for the equation error.

    Arrays have shape (n,), are in SI units at the joint, and have passed the same filter;
    ``raw_velocity`` and ``raw_load`` have not.
    """

    recording: Recording  # the recording from which the signals were computed
    time: Array  # s
    angle: Array  # rad
    velocity: Array  # rad/s
    acceleration: Array  # rad/s^2
    # Drive torque plus the torque of the known loads, less the inertia torque of these loads, N m;
    # A if no torque constant is known.
    torque: Array
    drive_torque: Array  # drive torque alone, N m
    moment: Array  # contact moment F_P L1, which multiplies m_L in eq. 13, N m; zero when unloaded
    # Mask of the samples in motion whose filter window contains no sample at rest and no sample
    # near a late or missing sample.
    used: BoolArray
    bandwidth_Hz: float  # bandwidth of the filter
    filter: Decimator  # the filter, to be applied to regressors that are not linear in the velocity
    # Velocity before the filter, rad/s, shape (m,), for regressors that are not linear in the
    # velocity.
    raw_velocity: Array
    raw_load: Array  # magnitude of the known loads' torque before the filter, N m, shape (m,)


def uniform_grid(recording: Recording) -> Array:
    """Return evenly spaced times that span the recording at its median period, shape (m,)."""
    time, period = recording.time, recording.period
    return np.asarray(time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1))


def joint_angle(recording: Recording) -> Array | None:
    """Return the joint angle from the finer of the two encoders, rad, or None if neither was
    recorded.

    A motor angle is divided by the gear ratio (assumption 5) and shifted to the zero of the joint
    encoder.
    """
    channels = recording.channels
    joint = channels.get("angle")
    if "motor_angle" not in channels:
        return joint
    motor = channels["motor_angle"] / recording.bench.gear_ratio
    if joint is None:
        return motor
    if finer_joint(recording):
        return joint
    return np.asarray(motor + np.median(joint - motor))


def finer_joint(recording: Recording) -> bool:
    """Whether the joint angle is recorded with finer steps than the motor angle."""
    joint, motor = (recording.channels.get(name) for name in ("angle", "motor_angle"))
    if joint is None or motor is None:
        return joint is not None
    return 0.0 < quantum(joint) < quantum(motor / recording.bench.gear_ratio)


def drive_torque(recording: Recording, grid: Array, velocity: Array) -> Array:
    """Return the drive's torque at the joint on ``grid``, N m (N on a linear bench; A if the torque
    constant is unknown).

    The torque is computed from the torque channel; without a torque channel from the current;
    without a current from the voltage, with I = (U - Ke omega_motor)/R, and I = 0 while the power
    stage is off. Averaged channels are shifted by half a period.
    """
    channels, bench = recording.channels, recording.bench
    for name in ("torque", "current", "voltage"):
        if name not in channels:
            continue
        offset = -0.5 * recording.period if name in recording.averaged else 0.0
        values = channels[name]
        if name == "voltage":
            if bench.resistance is None or bench.back_emf_constant is None:
                raise RecordingError(
                    f"{recording.name}: torque from voltage needs bench.resistance and "
                    f"bench.back_emf_constant"
                )
            off = ~np.isfinite(values)
            if "enabled" in channels:
                off |= channels["enabled"] < 0.5
            powered = resample(recording.time, 1.0 - off, grid, offset) > 0.5
            volts = resample(recording.time, np.where(off, 0.0, values), grid, offset)
            emf = bench.back_emf_constant * bench.gear_ratio * velocity
            return powered * (volts - emf) / bench.resistance * bench.ampere_torque
        series = resample(recording.time, values, grid, offset)
        return series if name == "torque" else series * bench.ampere_torque
    raise RecordingError(f"{recording.name}: no torque, current or voltage channel")


def torque_unit(recording: Recording) -> str:
    """Return the unit of torque in the fit: N m, N on a linear bench, A if Km is unknown."""
    if "torque" not in recording.channels and recording.bench.torque_constant is None:
        return "A"
    return unit_on(recording.bench.motion, "N m")


def drive_channel(recording: Recording) -> str:
    """Return the name of the logged quantity from which the drive's torque is computed."""
    if "torque" in recording.channels:
        return torque_word(recording.bench.motion)
    return "current" if "current" in recording.channels else "voltage"


def volts_per_torque(recording: Recording) -> float | None:
    """Return the voltage R I per joint torque, if the voltage gives the torque; else None."""
    if {"torque", "current"} & recording.channels.keys() or recording.bench.resistance is None:
        return None
    return recording.bench.resistance / recording.bench.ampere_torque


def resting(angle: Array, samples: int = REST_SAMPLES) -> BoolArray:
    """Mark runs of at least ``samples`` samples in which the angle changes by at most one encoder
    step.

    Samples between two such runs are also marked if the encoder only alternates between
    neighbouring readings: the angles of these samples and of the second run lie within one step of
    the last angle of the first run.
    """
    tolerance = max(1.01 * quantum(angle), 1e-9 * float(np.ptp(angle)) if len(angle) else 0.0)
    if len(angle) <= samples:
        return np.zeros(len(angle), dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(angle, samples)
    still = windows.max(axis=1) - windows.min(axis=1) <= tolerance
    marks = np.zeros(len(angle) + 1)
    np.add.at(marks, np.flatnonzero(still), 1.0)
    np.add.at(marks, np.flatnonzero(still) + samples, -1.0)
    found = np.asarray(np.cumsum(marks)[:-1] > 0.5)
    ends = np.flatnonzero(found[:-1] & ~found[1:])
    begins = np.flatnonzero(~found[:-1] & found[1:]) + 1
    for last in ends:
        after = begins[np.searchsorted(begins, last) :]
        if len(after):
            level = float(np.median(angle[max(last + 1 - samples, 0) : last + 1]))
            apart = np.abs(angle[last : after[0] + samples] - level)
            if np.all(apart[:-samples] <= tolerance) and np.median(apart[-samples:]) <= tolerance:
                found[last : after[0]] = True
    return found


def within_noise(angle: Array, smoothed: Array, rate: float, cutoff: float) -> BoolArray:
    """Mark stretches in which the smoothed angle changes by no more than its noise.

    The speed at such a rest is noise, whose sign would give the joint friction without a torque.

    Args:
        angle: Measured angle, shape (n,), rad.
        smoothed: The same after a low-pass filter.
        rate: Sample rate, Hz.
        cutoff: Cut-off frequency of the filter, Hz.
    """
    marks = np.zeros(len(angle), dtype=bool)
    noise = 1.4826 * float(np.median(np.abs(angle - smoothed)))
    if noise == 0.0:
        return marks
    samples = round(REST_PERIODS * rate / cutoff)
    whole = len(angle) // samples * samples
    change = np.ptp(smoothed[:whole].reshape(-1, samples), axis=1)
    left = noise * math.sqrt(min(1.0, 2.0 * cutoff / rate))
    marks[:whole] = np.repeat(change <= REST_NOISES * left, samples)
    return marks


def irregular(time: Array, grid: Array) -> BoolArray:
    """Mark grid samples at which the recording's own samples came too early, too late, or not at
    all.

    In a real-time run a few control cycles are late, and near a late cycle the joint accelerates
    faster than the samples resolve. If the sampling of the whole recording is uneven, no sample is
    marked.
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    apart = np.abs(steps - median)
    off = apart > max(IRREGULAR * median, STANDS_OUT * float(np.median(apart)))
    first = np.searchsorted(grid, time[:-1][off] - median)
    last = np.searchsorted(grid, time[1:][off] + median)
    marks = np.zeros(len(grid) + 1)
    np.add.at(marks, first, 1.0)
    np.add.at(marks, last, -1.0)
    return np.asarray(np.cumsum(marks)[:-1] > 0.5)


def without_rare(low_pass: Decimator, bad: BoolArray, rare: BoolArray) -> BoolArray:
    """Return a mask of the outputs that depend on neither ``bad`` nor ``rare`` samples; if too few
    such outputs remain, the mask includes outputs that depend on ``rare`` samples.
    """
    every = low_pass.untouched(bad)
    clean = low_pass.untouched(bad | rare)
    return clean if np.sum(clean) >= LEAST_CLEAN * np.sum(every) else every


def widened(marks: BoolArray, samples: int) -> BoolArray:
    """Return the marks widened to where a filter sees both rest and motion."""
    spread = np.convolve(marks.astype(np.float64), np.ones(2 * samples + 1), mode="same")
    return np.asarray(spread[: len(marks)] > 0.5) if len(marks) > 2 * samples else marks


def default_bandwidth(recording: Recording) -> float:
    """Return the default bandwidth, Hz: 1/25 of the sample rate (at slow rates 20 Hz or a sixth of
    the rate), or less if encoder quantisation would dominate the acceleration.

    Quantisation noise of rms q/sqrt(12), with the quantum q, is taken as white. At a bandwidth b
    its second derivative has the rms (2 pi b)^2 q/sqrt(12) sqrt(2 b / (5 rate)). The bandwidth is
    the highest of those tried at which this rms is below a tenth of the rms of the acceleration at
    that bandwidth.
    """
    rate = 1.0 / recording.period
    top = max(DEFAULT_SHARE_OF_RATE * rate, min(SLOW_BANDWIDTH_HZ, rate / 6.0))
    angle = joint_angle(recording)
    if angle is None:
        return top
    noise = quantum(angle) / math.sqrt(12.0)
    if noise == 0.0:
        return top
    grid = uniform_grid(recording)
    series = resample(recording.time, angle, grid)
    for bandwidth in np.geomspace(top, 0.1 * top, 11):
        cutoff = POSITION_BANDWIDTH * bandwidth
        acceleration = derivative(derivative(smooth(series, rate, cutoff), 1.0 / rate), 1.0 / rate)
        error = (2.0 * math.pi * bandwidth) ** 2 * noise * math.sqrt(2.0 * bandwidth / (5.0 * rate))
        if error < 0.1 * float(np.std(acceleration)):
            return float(bandwidth)
    return float(0.1 * top)


COARSE_SPEED, FINER = 0.05, 0.5
"""Least noise of the speed from an encoder, relative to the usual speed, at which the encoder
counts as coarse, and greatest noise of a recorded velocity relative to it.
"""


def coarser_than_velocity(recording: Recording) -> str:
    """Return why the recorded velocity gives the better speed than the recorded angle; empty if the
    angle does, or is needed for a weight that turns.

    At a bandwidth b, white noise of rms s in an angle gives the speed the noise 2 pi b s
    sqrt(2 b / (3 rate)), and in a velocity s sqrt(2 b / rate).
    """
    position, measured = joint_angle(recording), recording.channels.get("velocity")
    step = 0.0 if position is None else quantum(position)
    if measured is None or step == 0.0 or recording.pendulum is not None:
        return ""
    rate, bandwidth = 1.0 / recording.period, default_bandwidth(recording)
    size = np.abs(measured)
    usual = float(np.median(size[size > 0.05 * np.max(size)])) if np.any(size) else 0.0
    share = math.sqrt(2.0 * bandwidth / rate)
    coarse = 2.0 * math.pi * bandwidth * share * step / 6.0
    third = float(np.median(np.abs(np.diff(measured, 3)))) / (0.6745 * math.sqrt(20.0))
    fine = share * max(third, quantum(measured) / math.sqrt(12.0))
    if coarse < COARSE_SPEED * usual or fine > FINER * coarse:
        return ""
    unit = unit_on(recording.bench.motion, "rad")
    return (
        f"the angle is not used, because its steps of {step:.3g} {unit} are coarser than "
        f"`velocity`: at {bandwidth:.3g} Hz they leave {coarse:.2g} {unit}/s in the speed, which "
        f"is {usual:.2g} {unit}/s; speed and acceleration are those of `velocity`"
    )


def prepare(recording: Recording, bandwidth_Hz: float | None = None) -> Prepared:
    """Compute torque, velocity and acceleration of a recording on an even grid at one bandwidth.

    Args:
        recording: Any recording with an angle or a velocity, and a torque, current or voltage.
        bandwidth_Hz: Bandwidth, or None for :func:`default_bandwidth`. From 0.45 of the sample rate
            on nothing is filtered, and samples whose acceleration the sample rate does not resolve
            are omitted.
    """
    if bandwidth_Hz is None:
        bandwidth_Hz = default_bandwidth(recording)
    grid = uniform_grid(recording)
    rate = 1.0 / recording.period
    samples = len(grid)
    if not 0.0 < bandwidth_Hz <= 0.5 * rate * (1.0 + RATE_TOLERANCE):
        raise RecordingError(
            f"{recording.name}: a bandwidth of {bandwidth_Hz:.4g} Hz is not possible; state a "
            f"bandwidth above 0 and at most half the sampling rate, {0.5 * rate:.4g} Hz"
        )
    least = least_samples(rate, bandwidth_Hz)
    if samples < least:
        raise RecordingError(
            f"{recording.name}: the recording has {samples} samples, but the filter for a "
            f"bandwidth of {bandwidth_Hz:.3g} Hz needs at least {least}; state a higher "
            "bandwidth"
        )
    low_pass = decimator(rate, bandwidth_Hz)
    cutoff = POSITION_BANDWIDTH * bandwidth_Hz
    angle, velocity, still = _motion(recording, grid, rate, cutoff)
    exact = low_pass.half == 0
    acceleration = (
        derivative(velocity, 1.0 / rate) if exact else central_difference(velocity, 1.0 / rate)
    )
    drive = drive_torque(recording, grid, velocity)
    if not exact:
        drive = smooth(drive, rate, cutoff)
    hanging = recording.known_torque(angle)
    known = hanging - recording.known_inertia * acceleration
    margin = 0 if exact else round(1.5 * rate / cutoff)
    bad = _unresolved(velocity, rate) | still if exact else widened(still, margin)
    used = without_rare(low_pass, bad, widened(irregular(recording.time, grid), margin))
    lead = slice(low_pass.half, len(grid) - low_pass.half, low_pass.factor)
    return Prepared(
        recording=recording,
        time=grid[lead],
        angle=low_pass(angle),
        velocity=low_pass(velocity),
        acceleration=low_pass(acceleration),
        torque=low_pass(drive + known),
        drive_torque=low_pass(drive),
        moment=low_pass(contact_moment(recording, grid, angle)),
        used=used,
        bandwidth_Hz=min(bandwidth_Hz, 0.5 * rate),
        filter=low_pass,
        raw_velocity=velocity,
        raw_load=np.abs(hanging),
    )


def least_samples(rate: float, bandwidth_Hz: float) -> int:
    """Return the least number of samples of a recording for the filter of a bandwidth, Hz."""
    return 2 * reach(rate, bandwidth_Hz)[1] + 8 if bandwidth_Hz > 0.0 else 0


def _motion(
    recording: Recording, grid: Array, rate: float, cutoff: float
) -> tuple[Array, Array, BoolArray]:
    """Return smoothed angle and velocity on ``grid``, and a mask of the samples at rest."""
    position = joint_angle(recording)
    if position is not None:
        series = resample(recording.time, position, grid)
        still = resting(series)
        if "velocity" not in recording.channels or quantum(position) > 0.0:
            smoothed = smooth(series, rate, cutoff)
            still |= within_noise(series, smoothed, rate, cutoff)
            return smoothed, central_difference(smoothed, 1.0 / rate), still
    elif "velocity" not in recording.channels:
        raise RecordingError(f"{recording.name}: no angle, motor_angle or velocity channel")
    raw = resample(recording.time, recording.channels["velocity"], grid)
    velocity = smooth(raw, rate, cutoff)
    if position is None:
        series = np.concatenate(([0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1])))) / rate
        # A velocity of at most one quantisation step cannot be distinguished from rest.
        still = np.asarray(np.abs(raw) <= 1.01 * quantum(recording.channels["velocity"]))
    return series, velocity, still


def _unresolved(velocity: Array, rate: float) -> BoolArray:
    """Mark samples whose three- and seven-point differences disagree: unresolved motion."""
    fine = derivative(velocity, 1.0 / rate)
    steps = np.abs(np.diff(velocity, n=7, prepend=velocity[:4], append=velocity[-3:]))
    worst = np.maximum.reduce([np.roll(steps, k) for k in range(-4, 5)])
    scale = float(np.percentile(np.abs(fine), 50.0)) / rate
    return np.asarray(worst > 1e-3 * scale)


OFF_GRID = 0.01  # greatest distance of a time stamp from its time on the grid, in periods
MOST_FILLED = 0.1
"""Greatest share of interpolated samples; above this share the sampling counts as uneven."""
SHORT_HOLE = 3  # greatest number of missing samples in a row that are interpolated and used
_COUNTED = ("angle", "motor_angle")


def evened(recording: Recording) -> tuple[Recording, BoolArray] | None:
    """Return the recording with evenly spaced samples, and a mask of the samples in gaps that are
    too long to be used; None if the sampling is uneven.

    The grid is fitted to all time stamps, because a grid with the median period would drift away
    from the time stamps within seconds. A recording with even samples is returned unchanged.
    """
    time = recording.time
    steps = np.diff(time)
    period = float(np.median(steps))
    if float(np.ptp(steps)) <= OFF_GRID * period:
        return recording, np.zeros(len(time), dtype=bool)
    index, origin, period = _grid(time, period)
    on = np.abs(time - origin - period * index) <= OFF_GRID * period
    on[1:] &= np.diff(index) > 0
    size = int(index[-1]) + 1
    if index[0] != 0 or np.sum(on) < (1.0 - MOST_FILLED) * size:
        return None
    measured = np.zeros(size, dtype=bool)
    measured[index[on]] = True
    grid: Array = np.asarray(origin + period * np.arange(size), dtype=np.float64)
    channels: dict[str, Array] = {"time": grid}
    for name, values in recording.channels.items():
        if name == "time":
            continue
        filled = np.interp(grid, time, values)
        step = quantum(values) if name in _COUNTED else 0.0
        if step > 0.0:
            first = values[0]
            filled = first + np.round((filled - first) / step) * step
        filled[index[on]] = values[on]
        channels[name] = filled
    holes = np.zeros(size, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (~measured).astype(np.int64), [0]))))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        holes[start:stop] = stop - start > SHORT_HOLE
    return replace(recording, channels=channels), holes


def _grid(
    time: Array, period: float
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], float, float]:
    """Return each sample's grid index, and origin and period of a line fitted twice, s."""
    index = np.concatenate(
        ([0], np.cumsum(np.maximum(np.round(np.diff(time) / period), 0.0)))
    ).astype(np.int64)
    origin = float(time[0])
    near = np.ones(len(time), dtype=bool)
    for _ in range(2):
        slope, origin = (float(v) for v in np.polyfit(index[near], time[near], 1))
        period = slope
        index = np.round((time - origin) / period).astype(np.int64)
        near = np.abs(time - origin - period * index) <= OFF_GRID * period
        if np.sum(near) < 2:
            break
    return index, origin, period
