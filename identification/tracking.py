"""Tracking error and effort of a recording against its command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.numerics.arrays import Array
from identification.recording import Recording

REST_RAD_S = 1e-4
"""Mean speed over :data:`REST_SPAN_S` below which a joint counts as resting."""
REST_SPAN_S = 0.05


@dataclass(frozen=True)
class Tracking:
    """Tracking errors and effort of one recording or a part of it.

    Attributes:
        rms: Rms of command less angle, rad.
        largest: Greatest magnitude of command less angle, rad.
        at_end: Last value of command less angle, rad; the steady-state error if the command is
            constant.
        energy: Electrical energy consumed by the motor, the integral of U I, J.
        waiting: Share of the commanded motion time in which the joint rested.
    """

    rms: float
    largest: float
    at_end: float
    energy: float
    waiting: float


def tracking_error(recording: Recording) -> Array:
    """Return command less angle, rad, shape (n,); each command is compared with the angle one
    sample after the command was sent.
    """
    command = recording.channels["command"]
    return np.asarray(np.concatenate([command[:1], command[:-1]]) - recording.channels["angle"])


def resting(recording: Recording) -> Array:
    """Return 1 at samples around which the mean speed of the joint is near zero, else 0, shape
    (n,).
    """
    n = max(1, round(REST_SPAN_S / recording.period))
    angle = recording.channels["angle"]
    padded = np.pad(angle, (n // 2, n - n // 2), mode="edge")
    return np.asarray(
        np.abs(padded[n:] - padded[:-n]) < REST_RAD_S * n * recording.period, dtype=np.float64
    )


def track(recording: Recording, first: float = 0.0, last: float = np.inf) -> Tracking:
    """Return the tracking errors of a recording from ``first`` to ``last`` s after its start.

    Raises:
        KeyError: The recording lacks command, angle, voltage or current.
        ValueError: The recording has no sample in this interval.
    """
    time = recording.time - recording.time[0]
    part = (time >= first) & (time < last)
    if not np.any(part):
        raise ValueError(f"{recording.name}: no sample from {first:g} to {last:g} s")
    error = tracking_error(recording)[part]
    command = recording.channels["command"]
    sent = np.abs(np.gradient(command, recording.period)) > REST_RAD_S
    moving = part & sent
    power = recording.channels["voltage"] * recording.channels["current"]
    return Tracking(
        rms=float(np.sqrt(np.mean(error**2))),
        largest=float(np.max(np.abs(error))),
        at_end=float(error[-1]),
        energy=float(np.nansum(power[part]) * recording.period),
        waiting=float(np.mean(resting(recording)[moving])) if np.any(moving) else 0.0,
    )
