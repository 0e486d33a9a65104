"""Computes the errors of a simulated response against its recording, pooled over recordings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from identification.numerics.arrays import Array
from identification.prepare import POSITION_BANDWIDTH, Prepared, joint_angle, uniform_grid
from identification.recording import RecordingError
from identification.signals import resample, smooth
from identification.simulate.closed_loop import Response

FRICTION_PARAMETERS = ("Mc", "Ms", "sigma_2", "mu_c", "mu_s", "mu_2", "mu_gc", "mu_gs")
"""Parameters that are proportional to the friction as a whole; Stribeck speeds, inertia and offset
are not.
"""


@dataclass(frozen=True)
class Sums:
    """Sums of squares over all samples, including samples at rest, from which rms errors are
    computed.

    Attributes:
        torque_error: Sum of squares of simulated less measured drive torque at the bandwidth.
        torque: Sum of squares of the measured drive torque at the bandwidth.
        torque_samples: Number of torque samples.
        angle_error: Sum of squares of simulated less measured angle at the recording's time stamps.
        angle_samples: Number of angle samples.
        angle_absolute: Sum of absolute errors of the angle at the recording's time stamps.
    """

    torque_error: float = 0.0
    torque: float = 0.0
    torque_samples: int = 0
    angle_error: float = 0.0
    angle_samples: int = 0
    angle_absolute: float = 0.0

    @property
    def torque_rms(self) -> float:
        """Rms torque error, N m (N)."""
        return math.sqrt(self.torque_error / max(self.torque_samples, 1))

    @property
    def torque_relative(self) -> float:
        """Norm of the torque error over the norm of the torque."""
        return math.sqrt(self.torque_error / self.torque) if self.torque > 0.0 else 0.0

    @property
    def angle_rms(self) -> float:
        """Rms angle error, rad (m)."""
        return math.sqrt(self.angle_error / max(self.angle_samples, 1))

    @property
    def angle_mae(self) -> float:
        """Mean absolute angle error, rad (m)."""
        return self.angle_absolute / max(self.angle_samples, 1)


def pooled(parts: Iterable[Sums]) -> Sums:
    """Return the sums over several recordings."""
    total = Sums()
    for s in parts:
        total = Sums(
            total.torque_error + s.torque_error,
            total.torque + s.torque,
            total.torque_samples + s.torque_samples,
            total.angle_error + s.angle_error,
            total.angle_samples + s.angle_samples,
            total.angle_absolute + s.angle_absolute,
        )
    return total


def compare(prepared: Prepared, response: Response) -> Sums:
    """Return the sums of squared errors of a simulated response against its recording.

    Simulated and measured torque are filtered to the same bandwidth before they are compared.

    Raises:
        RecordingError: The recording has no angle.
    """
    angle = joint_angle(prepared.recording)
    if angle is None:
        raise RecordingError(
            f"{prepared.recording.name}: the recording has no angle channel, "
            "with which the simulated angle is compared; add a channel `angle` or `motor_angle`"
        )
    off = response.angle - angle
    error = simulated_torque(prepared, response) - prepared.drive_torque
    return Sums(
        torque_error=float(error @ error),
        torque=float(prepared.drive_torque @ prepared.drive_torque),
        torque_samples=len(error),
        angle_error=float(off @ off),
        angle_samples=len(off),
        angle_absolute=float(np.sum(np.abs(off))),
    )


def simulated_torque(prepared: Prepared, response: Response) -> Array:
    """Return the simulated drive torque after the filter of the fit, N m, at
    ``prepared.time``.
    """
    recording = prepared.recording
    series = resample(recording.time, response.torque, uniform_grid(recording))
    if prepared.filter.half:
        series = smooth(series, 1.0 / recording.period, POSITION_BANDWIDTH * prepared.bandwidth_Hz)
    return np.asarray(prepared.filter(series))


def with_friction(values: Mapping[str, float], share: float) -> dict[str, float]:
    """Return the parameter values with all friction multiplied by ``share``; the error of the model
    with these values is a scale for the error of the fitted model.
    """
    return {
        name: value * (share if name in FRICTION_PARAMETERS else 1.0)
        for name, value in values.items()
    }
