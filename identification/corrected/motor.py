"""What the logged current gives at the joint and asks of the supply (eq. 1), and what each effect
adds to that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from identification.corrected.states import advanced, lagged, mean_step, winding_rise
from identification.numerics.arrays import Array


def nominal_voltage(s: Any, m: Any) -> Array:
    """Return R I + L dI/dt + Ke i omega, V (eq. 1)."""
    slope = np.gradient(s["current"], s["time"])
    return np.asarray(m["R"] * s["current"] + m["L"] * slope + m["Ke"] * m["i"] * s["velocity"])


def cogging(s: Any, m: Any, torque_Nm: float, per_motor_turn: float, phase_rad: float) -> Array:
    """A sin(n phi + p), without current."""
    return np.asarray(torque_Nm * np.sin(per_motor_turn * s["motor_angle"] + phase_rad))


def torque_ripple(
    s: Any, m: Any, fraction: float, per_motor_turn: float, phase_rad: float
) -> Array:
    """Km swings with the motor's angle."""
    return np.asarray(s["drive"] * fraction * np.sin(per_motor_turn * s["motor_angle"] + phase_rad))


def torque_saturation(s: Any, m: Any, knee_A: float) -> Array:
    """I_k tanh(I / I_k) in place of I."""
    return np.asarray(
        m["ampere_torque"] * knee_A * np.tanh(s["drive"] / (m["ampere_torque"] * knee_A))
        - s["drive"]
    )


def current_loop_lag(s: Any, m: Any, time_s: float) -> Array:
    """The torque lags the logged current."""
    return np.asarray(lagged(s["drive"], s["time"], time_s) - s["drive"])


def winding_heating(s: Any, m: Any, rise_K_per_W: float, time_s: float) -> Array:
    """Km falls with the winding's temperature."""
    return np.asarray(-0.001 * winding_rise(s, m, rise_K_per_W, time_s) * s["drive"])


def transmission_efficiency(s: Any, m: Any, efficiency: float) -> Array:
    """The joint gets less of the torque when it is driven, more when it drives back."""
    driving = s["drive"] * s["velocity"] >= 0.0
    return np.asarray(s["drive"] * (np.where(driving, efficiency, 1.0 / efficiency) - 1.0))


def gear_mesh_ripple_drive(
    s: Any, m: Any, amplitude_rad: float, per_turn: float, phase_rad: float
) -> Array:
    """Where the teeth make the motor run ahead its torque counts for more: power passes whole."""
    return np.asarray(
        s["drive"] * amplitude_rad * per_turn * np.cos(per_turn * s["angle"] + phase_rad)
    )


def time_skew(s: Any, m: Any, time_s: float) -> Array:
    """The current was sampled before the angles."""
    return np.asarray(advanced(s["drive"], s["time"], time_s) - s["drive"])


def current_offset(s: Any, m: Any, current_A: float) -> Array:
    """The logged current is too high by a constant."""
    return np.full(len(s["time"]), -m["ampere_torque"] * current_A)


def current_drift(s: Any, m: Any, rate_A_s: float) -> Array:
    """The logged current's zero drifts within a recording."""
    return np.asarray(-m["ampere_torque"] * rate_A_s * (s["time"] - s["time"][0]))


def inverter_dead_time_voltage(s: Any, m: Any, voltage_V: float) -> Array:
    """A sharp step with the sign of the current."""
    return np.asarray(voltage_V * mean_step(s["current"], 0.0))


def brush_drop_voltage(s: Any, m: Any, voltage_V: float, current_A: float) -> Array:
    """A rounded step with the sign of the current."""
    return np.asarray(voltage_V * mean_step(s["current"], current_A))


def winding_heating_voltage(s: Any, m: Any, rise_K_per_W: float, time_s: float) -> Array:
    """R rises and Ke falls with the winding's temperature."""
    rise = winding_rise(s, m, rise_K_per_W, time_s)
    return np.asarray(
        rise * (0.00393 * m["R"] * s["current"] - 0.001 * m["Ke"] * m["i"] * s["velocity"])
    )


def supply_sag_voltage(s: Any, m: Any, resistance_ohm: float) -> Array:
    """The logged voltage is duty times the nominal supply; the supply gives duty times the
    current.
    """
    return np.asarray(resistance_ohm * s["current"] * (s["voltage"] / s["supply"]) ** 2)


def current_offset_voltage(s: Any, m: Any, current_A: float) -> Array:
    """The winding carries less than is logged."""
    return np.full(len(s["time"]), -m["R"] * current_A)


def current_drift_voltage(s: Any, m: Any, rate_A_s: float) -> Array:
    """The same, within a recording."""
    return np.asarray(-m["R"] * rate_A_s * (s["time"] - s["time"][0]))


DRIVE: Mapping[str, Callable[..., Array]] = {
    f.__name__.removesuffix("_drive"): f
    for f in (
        cogging,
        torque_ripple,
        torque_saturation,
        current_loop_lag,
        winding_heating,
        transmission_efficiency,
        gear_mesh_ripple_drive,
        time_skew,
        current_offset,
        current_drift,
    )
}
"""Effect to what it adds to the torque that the logged current gives."""
VOLTAGE: Mapping[str, Callable[..., Array]] = {
    f.__name__.removesuffix("_voltage"): f
    for f in (
        inverter_dead_time_voltage,
        brush_drop_voltage,
        winding_heating_voltage,
        supply_sag_voltage,
        current_offset_voltage,
        current_drift_voltage,
    )
}
"""Effect to what it adds to the voltage that the logged current asks for."""
