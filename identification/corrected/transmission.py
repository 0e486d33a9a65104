"""Transmission effects of the corrected model: each function returns what an effect adds to the
difference motor_angle / i - angle, rad.

Without effects this difference is constant (assumption 5). ``s`` holds the signals of a recording
by name (:mod:`identification.corrected.signals`), ``m`` the nominal parameters and the bench
constants by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from identification.corrected.states import advanced, play
from identification.numerics.arrays import Array


def backlash(s: Any, m: Any, gap_rad: float) -> Array:
    """Backlash: the joint stays at rest until the motor has crossed the gap."""
    return play(s["motor_angle"] / m["i"], gap_rad)


def compliance(s: Any, m: Any, stiffness_Nm_rad: float) -> Array:
    """Elastic twist of the transmission: M / k."""
    return np.asarray(s["drive"] / stiffness_Nm_rad)


def gear_mesh_ripple(
    s: Any,
    m: Any,
    amplitude_rad: float,
    per_turn: float,
    phase_rad: float,
    with_torque: float = 1.0,
) -> Array:
    """Periodic error of the gear mesh: A sin(n theta + p); its torque ripple is computed in
    :func:`identification.corrected.motor.gear_mesh_ripple_drive`.
    """
    return np.asarray(amplitude_rad * np.sin(per_turn * s["angle"] + phase_rad))


def coupling_hysteresis(s: Any, m: Any, torque_Nm: float, deflection_rad: float) -> Array:
    """Hysteresis: the deflection lags behind the torque and dissipates work."""
    behind = s["drive"] - play(s["drive"], 2.0 * torque_Nm)
    return np.asarray(deflection_rad * np.clip(behind / torque_Nm, -1.0, 1.0))


def transport_delay(s: Any, m: Any, time_s: float) -> Array:
    """Delay of the joint encoder's angle."""
    return np.asarray(s["angle"] - advanced(s["angle"], s["time"], -time_s))


def encoder_eccentricity(s: Any, m: Any, amplitude_rad: float, phase_rad: float) -> Array:
    """Eccentricity: the reading of the joint encoder is too high by A sin(theta + p)."""
    return np.asarray(-amplitude_rad * np.sin(s["angle"] + phase_rad))


def encoder_slip(s: Any, m: Any, angle_rad: float, at_s: float, recording: float) -> Array:
    """Single slip of the joint encoder in one recording; recordings count from 1."""
    late = s["time"] - s["time"][0] >= at_s
    return np.where(late & (s["number"] == round(recording)), -angle_rad, 0.0)


TRANSMISSION: Mapping[str, Callable[..., Array]] = {
    f.__name__: f
    for f in (
        backlash,
        compliance,
        gear_mesh_ripple,
        coupling_hysteresis,
        transport_delay,
        encoder_eccentricity,
        encoder_slip,
    )
}
"""Effect name to its function, which returns an addition to motor_angle / i - angle."""
