"""Simulates the nominal model, a joint with set-valued friction, in the position loop of a drive.

The simulation is used for planned experiments, and for the simulated replicates by which the bias
of an estimate is computed (M33 to M36). It has no code in common with the simulated bench.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.model.friction import friction, static_friction
from identification.model.parameters import INERTIA, pack
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

STEPS = 20
"""Number of integration steps per sample at 1 kHz; under load friction falls within 100
microseconds.
"""
_VELOCITY_BANDWIDTH = 2.0 * math.pi * 95.0


@dataclass(frozen=True)
class Loop:
    """A drive: position P and velocity PI controller with feedforward of the commanded speed.

    Attributes:
        position_gain: 1/s.
        velocity_gain: N m s/rad at the joint.
        integral: Integral gain of the velocity loop, 1/s.
        filter_Hz: Cut-off of the first-order filter on the measured speed.
        torque_limit: N m.
        count: Joint angle of one step of the drive's encoder, rad; 0 for an encoder without
            quantisation. The quantised angle affects the torque through the speed filter, the
            quantised command through the feedforward.
        lag: Lag of the torque behind the loop's output, s; 0 for none.
    """

    position_gain: float
    velocity_gain: float
    integral: float
    filter_Hz: float
    torque_limit: float
    count: float = 0.0
    lag: float = 0.0


def usual_loop(inertia: float, torque_limit: float, count: float = 0.0) -> Loop:
    """Return a stiff servo loop: velocity bandwidth 95 Hz, and a tenth of this bandwidth for the
    position.
    """
    position = 0.1 * _VELOCITY_BANDWIDTH
    return Loop(position, inertia * _VELOCITY_BANDWIDTH, position, 400.0, torque_limit, count)


@dataclass(frozen=True)
class Response:
    """The response of the nominal model. Arrays have shape (n,), at the joint.

    Attributes:
        angle: Joint angle at each sample, rad.
        torque: Mean torque over the period that ends at each sample, N m.
        peak_speed: Greatest speed at any instant, rad/s.
        peak_torque: Greatest torque, N m.
        peak_following: Greatest following error, rad.
    """

    angle: Array
    torque: Array
    peak_speed: float
    peak_torque: float
    peak_following: float


def respond(
    command: Array,
    period: float,
    parameters: Mapping[str, float],
    moment: float,
    alpha: float,
    loop: Loop,
    disturbance: Array | None = None,
) -> Response:
    """Simulate the response to a command, from rest at the first value of the command.

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
    """
    steps = max(1, math.ceil(STEPS * period / 1e-3))
    share = 1.0 - math.exp(-2.0 * math.pi * loop.filter_Hz * period / steps)
    lag = 1.0 - math.exp(-period / steps / loop.lag) if loop.lag > 0.0 else 1.0
    own = [
        loop.position_gain,
        loop.velocity_gain,
        loop.integral,
        share,
        loop.torque_limit,
        loop.count,
        lag,
    ]
    gains = np.array(own)
    angle, torque, peaks = np.empty_like(command), np.zeros_like(command), np.zeros(3)
    lost = np.zeros_like(command) if disturbance is None else disturbance
    if loop.count > 0.0:
        command = np.rint(command / loop.count) * loop.count
    _follow(
        command, period, pack(parameters, alpha), moment, gains, steps, lost, angle, torque, peaks
    )
    return Response(angle, torque, float(peaks[0]), float(peaks[1]), float(peaks[2]))


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
    peaks: Array,
) -> None:
    """Fill ``angle``, ``torque`` and ``peaks`` (speed, torque, following error); the speed is
    integrated by a linearly implicit rule.
    """
    h = period / steps
    static = static_friction(moment, p)
    theta, omega, seen, integral, measured, count = command[0], 0.0, 0.0, 0.0, command[0], gains[5]
    given = 0.0
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
            peaks[1] = max(peaks[1], abs(drive))
            drive -= lost[k]
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
            peaks[0] = max(peaks[0], abs(omega))
        angle[k] = theta
        torque[k] = total / steps
        peaks[2] = max(peaks[2], abs(command[k] - theta))
