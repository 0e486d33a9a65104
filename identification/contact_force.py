"""Contact force on the valve during a recording: measured, of the gas generator, or of a weight
(M4).
"""

from __future__ import annotations

import numpy as np

from identification.model.valve import impacted_area
from identification.numerics.arrays import Array
from identification.recording import Recording, RecordingError
from identification.signals import resample


def contact_force(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return F_P on ``grid``, N, shape (n,).

    The `load_force` channel where there is one; in a hot firing (p_g - p_c0) A_s(theta_r) of eq. 10
    from the `pressure` channel, zero where the pressure behind the valve is greater; otherwise that
    of the weight, eq. 17.

    Args:
        recording: The recording.
        grid: Times, s, shape (n,).
        angle: Of the valve at those times, rad, shape (n,).

    Raises:
        RecordingError: A hot firing on a bench whose gas generator is not known.
    """
    generator = recording.bench.gas_generator
    if "load_force" in recording.channels:
        return resample(recording.time, recording.channels["load_force"], grid)
    if not recording.hot_fire:
        return np.full(len(grid), recording.contact_force)
    if generator is None:
        raise RecordingError(
            f"{recording.name}: F_P = (p_g - p_c0) A_s of a hot firing takes valve and p_c0 of "
            f"bench.gas_generator"
        )
    pressure = resample(recording.time, recording.channels["pressure"], grid)
    return np.asarray(
        np.maximum(pressure - generator.p_c0, 0.0) * impacted_area(angle, generator.valve)
    )


def contact_moment(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return the contact moment F_P L1, which multiplies m_L in eq. 13, N m; arguments as of
    :func:`contact_force`.

    Raises:
        RecordingError: As :func:`contact_force`, or the moment arm of a loaded recording is not
            known.
    """
    force = contact_force(recording, grid, angle)
    arm = recording.bench.moment_arm
    if arm is None:
        if np.any(force != 0.0):
            raise RecordingError(
                f"{recording.name}: a loaded recording needs bench.moment_arm (L1)"
            )
        return np.zeros(len(grid))
    return np.asarray(force * arm)
