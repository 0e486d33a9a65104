"""Torque and voltage of the logged current (eq. 1), and what each effect adds to them."""

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
    """Cogging torque A sin(n phi + p), independent of the current."""
    return np.asarray(torque_Nm * np.sin(per_motor_turn * s["motor_angle"] + phase_rad))


def torque_ripple(
    s: Any, m: Any, fraction: float, per_motor_turn: float, phase_rad: float
) -> Array:
    """Ripple of the torque constant Km with the motor's angle."""
    return np.asarray(s["drive"] * fraction * np.sin(per_motor_turn * s["motor_angle"] + phase_rad))


def torque_saturation(s: Any, m: Any, knee_A: float, rational: float = 0.0) -> Array:
    """Saturation of the torque: I_k tanh(I / I_k), or I / (1 + (I / I_k)^2), in place of the
    current I.
    """
    knee = m["ampere_torque"] * knee_A
    if rational:
        return np.asarray(s["drive"] / (1.0 + (s["drive"] / knee) ** 2) - s["drive"])
    return np.asarray(knee * np.tanh(s["drive"] / knee) - s["drive"])


def current_loop_lag(s: Any, m: Any, time_s: float) -> Array:
    """First-order lag of the torque behind the logged current."""
    return np.asarray(lagged(s["drive"], s["time"], time_s) - s["drive"])


def winding_heating(
    s: Any, m: Any, rise_K_per_W: float, time_s: float, magnet: float = 1.0
) -> Array:
    """Decrease of Km with the temperature of the magnets; if ``magnet`` is 1, this temperature
    equals the winding's.
    """
    return np.asarray(-0.001 * magnet * winding_rise(s, m, rise_K_per_W, time_s) * s["drive"])


def transmission_efficiency(s: Any, m: Any, efficiency: float) -> Array:
    """Gear loss: less joint torque if the motor drives the load, more if the load drives the
    motor.
    """
    driving = s["drive"] * s["velocity"] >= 0.0
    return np.asarray(s["drive"] * (np.where(driving, efficiency, 1.0 / efficiency) - 1.0))


def gear_mesh_ripple_drive(
    s: Any,
    m: Any,
    amplitude_rad: float,
    per_turn: float,
    phase_rad: float,
    with_torque: float = 1.0,
) -> Array:
    """Torque ripple due to the ripple of the transmission ratio: the gear conserves power, so the
    joint torque is greater where the motor turns faster than the mean ratio requires. There is no
    torque ripple if ``with_torque`` is 0.
    """
    steepness = amplitude_rad * per_turn * np.cos(per_turn * s["angle"] + phase_rad)
    return np.asarray(with_torque * steepness * s["drive"])


def time_skew(s: Any, m: Any, time_s: float) -> Array:
    """Time offset: the current was sampled before the angles."""
    return np.asarray(advanced(s["drive"], s["time"], time_s) - s["drive"])


def current_offset(s: Any, m: Any, current_A: float) -> Array:
    """Constant offset of the current sensor: the logged current is too high by ``current_A``."""
    return np.full(len(s["time"]), -m["ampere_torque"] * current_A)


def current_drift(s: Any, m: Any, rate_A_s: float) -> Array:
    """Drift of the logged current's zero within a recording."""
    return np.asarray(-m["ampere_torque"] * rate_A_s * (s["time"] - s["time"][0]))


def inverter_dead_time_voltage(s: Any, m: Any, voltage_V: float) -> Array:
    """Voltage loss of the inverter: a sharp step with the sign of the current."""
    return np.asarray(voltage_V * mean_step(s["current"], 0.0))


def brush_drop_voltage(s: Any, m: Any, voltage_V: float, current_A: float) -> Array:
    """Voltage drop of the brushes: a rounded step with the sign of the current."""
    return np.asarray(voltage_V * mean_step(s["current"], current_A))


def winding_heating_voltage(
    s: Any, m: Any, rise_K_per_W: float, time_s: float, magnet: float = 1.0
) -> Array:
    """Increase of R with the winding's temperature; if ``magnet`` is 1, also a decrease of Ke."""
    rise = winding_rise(s, m, rise_K_per_W, time_s)
    weaker = 0.001 * magnet * m["Ke"] * m["i"] * s["velocity"]
    return np.asarray(rise * (0.00393 * m["R"] * s["current"] - weaker))


def supply_sag_voltage(s: Any, m: Any, resistance_ohm: float) -> Array:
    """Voltage drop of the supply: the logged voltage is duty times nominal supply voltage, the
    supply current duty times motor current.
    """
    return np.asarray(resistance_ohm * s["current"] * (s["voltage"] / s["supply"]) ** 2)


def current_offset_voltage(s: Any, m: Any, current_A: float) -> Array:
    """Voltage due to a constant current offset: the winding carries less current than is logged."""
    return np.full(len(s["time"]), -m["R"] * current_A)


def current_drift_voltage(s: Any, m: Any, rate_A_s: float) -> Array:
    """Voltage due to a current offset that drifts within a recording."""
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
"""Effect name to its function, which returns an addition to the torque of the logged current."""
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
"""Effect name to its function, which returns an addition to the voltage of the logged current."""
