"""Contact force on the valve during a recording: measured, or computed from gas pressure or from a
weight (M4).
"""

from __future__ import annotations

import numpy as np

from identification.model.valve import impacted_area
from identification.numerics.arrays import Array
from identification.recording import Recording, RecordingError
from identification.signals import resample


def contact_force(recording: Recording, grid: Array, angle: Array) -> Array:
    """Return F_P on ``grid``, N, shape (n,).

    If the recording has a `load_force` channel, F_P is this channel. Otherwise, in a hot firing,
    F_P is (p_g - p_c0) A_s(theta_r) (eq. 10), with the pressure p_g of the `pressure` channel; F_P
    is zero where p_g is below the downstream pressure p_c0. In all other cases F_P is the force of
    the weight (eq. 17).

    Args:
        recording: The recording.
        grid: Times, s, shape (n,).
        angle: Valve angle at those times, rad, shape (n,).

    Raises:
        RecordingError: The recording is a hot firing and the bench has no gas generator.
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
    """Return the contact moment F_P L1, which multiplies m_L in eq. 13, N m; the arguments are
    those of :func:`contact_force`.

    Raises:
        RecordingError: As in :func:`contact_force`; or a loaded recording has no moment arm.
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
