"""What presses on the valve during a recording: a measured force, a burning gas generator, or a hanging weight."""

from __future__ import annotations

import numpy as np

from identification.model.valve import impacted_area
from identification.recording import Array, Recording, RecordingError
from identification.signals import resample


def contact_force(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return F_P on ``grid``, N, shape (n,).

    The `load_force` channel where there is one; in a hot firing (p_g - p_c0) A_s(theta_r) of eq. 10 from the
    `pressure` channel, nothing where the pressure behind the valve is the greater; else that of the weight, eq. 17.

    Args:
        recording: What was measured.
        grid: Times, s, shape (n,).
        angle: Of the valve at those times, rad, shape (n,).

    Raises:
        RecordingError: A hot firing on a bench whose valve or back pressure is not known.
    """
    bench = recording.bench
    if "load_force" in recording.channels:
        return resample(recording.time, recording.channels["load_force"], grid)
    if not recording.hot_fire:
        return np.full(len(grid), recording.contact_force)
    if bench.valve is None or bench.back_pressure is None:
        raise RecordingError(
            f"{recording.name}: force from pressure, F_P = (p_g - p_c0) A_s, needs the bench's valve and back pressure"
        )
    pressure = resample(recording.time, recording.channels["pressure"], grid)
    return np.asarray(np.maximum(pressure - bench.back_pressure, 0.0) * impacted_area(angle, bench.valve))


def contact_moment(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return F_P L1, what multiplies m_L in eq. 13, N m; arguments and errors as above.

    Raises:
        RecordingError: Also where something presses and the moment arm is not known.
    """
    force = contact_force(recording, grid, angle)
    arm = recording.bench.moment_arm
    if arm is None:
        if np.any(force != 0.0):
            raise RecordingError(f"{recording.name}: a loaded recording needs bench.moment_arm (L1)")
        return np.zeros(len(grid))
    return np.asarray(force * arm)
