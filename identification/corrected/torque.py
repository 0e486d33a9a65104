"""Torques of the corrected model: the torque that the motion requires (eq. 15), and what each
effect adds to this torque, N m at the joint.

``s`` holds the signals of a recording by name (:mod:`identification.corrected.signals`), ``m`` the
nominal parameters and the bench constants by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from identification.corrected.states import dahl_friction, lagged
from identification.numerics.arrays import Array


def friction_level(speed: Array, m: Any, alpha: float) -> Array:
    """Return the magnitude of the system load (eq. 9) without its viscous part, N m."""
    fall = np.exp(-(np.abs(speed / m["omega_sf"]) ** alpha)) if m["omega_sf"] > 0.0 else 0.0
    return np.asarray(m["Mc"] + (m["Ms"] - m["Mc"]) * fall + np.zeros_like(speed))


def load_level(speed: Array, m: Any, alpha: float) -> Array:
    """Return the magnitude of the load coefficient m_L (eq. 12) without its viscous part; the
    product of this magnitude and F_P L1 is a torque.
    """
    fall = np.exp(-(np.abs(speed / m["omega_sL"]) ** alpha)) if m["omega_sL"] > 0.0 else 0.0
    return np.asarray(m["mu_c"] + (m["mu_s"] - m["mu_c"]) * fall + np.zeros_like(speed))


def gear_level(speed: Array, m: Any, alpha: float) -> Array:
    """Return the friction per torque of a declared weight; not zero only if load-dependent friction
    is declared.
    """
    fall = np.exp(-(np.abs(speed / m["omega_sf"]) ** alpha)) if m["omega_sf"] > 0.0 else 0.0
    return np.asarray(m["mu_gc"] + (m["mu_gs"] - m["mu_gc"]) * fall + np.zeros_like(speed))


def borne(s: Any, m: Any) -> Array:
    """Return the magnitude of the torque of declared and identified loads that turn with the joint,
    N m; the gear transmits this torque.
    """
    found = m["load_sine"] * np.sin(s["angle"]) + m["load_cosine"] * np.cos(s["angle"])
    return np.asarray(
        np.abs(s["hanging"] - found - m["load_slope"] * s["angle"] - m["load_constant"])
    )


def dry_level(s: Any, m: Any, alpha: float) -> Array:
    """Return the magnitude of all friction except the viscous part, N m."""
    system = friction_level(s["velocity"], m, alpha) + borne(s, m) * gear_level(
        s["velocity"], m, alpha
    )
    return np.asarray(system + s["moment"] * load_level(s["velocity"], m, alpha))


def load_torque(s: Any, m: Any) -> Array:
    """Return the working load M_L with its sign, N m (eq. 13)."""
    coefficient = load_level(s["velocity"], m, m["alpha"]) + m["mu_2"] * np.abs(s["velocity"])
    return np.asarray(s["sense"] * s["moment"] * coefficient)


def nominal_torque(s: Any, m: Any) -> Array:
    """Return J domega/dt + M_f + M_L, N m at the joint (eq. 15)."""
    level = friction_level(s["velocity"], m, m["alpha"]) + borne(s, m) * gear_level(
        s["velocity"], m, m["alpha"]
    )
    system = s["sense"] * level + m["sigma_2"] * s["velocity"]
    return np.asarray(m["J"] * s["acceleration"] + system + load_torque(s, m) + m["offset"])


def asymmetric_coulomb(s: Any, m: Any, torque_Nm: float) -> Array:
    """Direction-dependent Coulomb friction: Mc and Ms are greater by d in one direction and smaller
    by d in the other.
    """
    return np.full(len(s["time"]), torque_Nm)


def asymmetric_viscous(s: Any, m: Any, coefficient_Nms_rad: float) -> Array:
    """Direction-dependent viscous friction: sigma_2 plus the coefficient for positive speed, and
    less the coefficient for negative speed.
    """
    return np.asarray(coefficient_Nms_rad * np.abs(s["velocity"]))


def quadratic_drag(s: Any, m: Any, coefficient_Nms2_rad2: float) -> Array:
    """Quadratic drag c omega |omega|."""
    return np.asarray(coefficient_Nms2_rad2 * s["velocity"] * np.abs(s["velocity"]))


def stribeck_shape(s: Any, m: Any, alpha: float) -> Array:
    """Stribeck curves with another exponent than that of the nominal model."""
    return np.asarray(s["sense"] * (dry_level(s, m, alpha) - dry_level(s, m, m["alpha"])))


def friction_memory(s: Any, m: Any, time_s: float, of_speed: float = 0.0) -> Array:
    """Friction with memory: a lag either of the dry friction level, or of the speed on which this
    level depends.
    """
    level = dry_level(s, m, m["alpha"])
    if of_speed:
        late = dry_level({**s, "velocity": lagged(s["velocity"], s["time"], time_s)}, m, m["alpha"])
    else:
        late = lagged(level, s["time"], time_s)
    return np.asarray(s["sense"] * (late - level))


def dwell_static_friction(s: Any, m: Any, growth_Nm: float, time_s: float) -> Array:
    """Static friction Ms that grows with the time at rest. A short travel removes the growth, so
    that friction in motion does not change.
    """
    still = np.asarray(s["still"])
    ends = np.concatenate(([False], still[:-1] & ~still[1:]))
    return np.asarray(
        s["sense"] * growth_Nm * (1.0 - np.exp(-s["rest_time"] / time_s)) * (still | ends)
    )


def presliding(s: Any, m: Any, stiffness_Nm_rad: float) -> Array:
    """Dahl friction in place of friction that jumps with the sign of the speed; the friction at the
    start follows from the drive's torque over the first 20 ms.
    """
    level = dry_level(s, m, m["alpha"])
    begin = slice(0, max(2, round(0.02 / (s["time"][1] - s["time"][0]))))
    borne = (s["drive"] + s["known"] - m["J"] * s["acceleration"])[begin]
    start = float(np.polyval(np.polyfit(np.arange(len(borne)), borne, 1), 0.0))
    return np.asarray(
        dahl_friction(s["angle"], level, stiffness_Nm_rad, start) - s["sense"] * level
    )


def position_dependent_friction(
    s: Any, m: Any, torque_Nm: float, center_rad: float, width_rad: float
) -> Array:
    """Friction of a worn patch, which depends on the angle."""
    return np.asarray(
        s["sense"] * torque_Nm * np.exp(-0.5 * ((s["angle"] - center_rad) / width_rad) ** 2)
    )


def viscous_thermal_drift(s: Any, m: Any, fraction: float, time_s: float) -> Array:
    """Viscous friction sigma_2 that falls with running time."""
    return np.asarray(
        -m["sigma_2"] * fraction * (1.0 - np.exp(-s["run_time"] / time_s)) * s["velocity"]
    )


def coulomb_drift(s: Any, m: Any, rate_Nm_s: float, time_s: float = 1e6) -> Array:
    """Coulomb friction that drifts with running time: Mc and Ms grow by r T (1 - exp(-t_run /
    T)).
    """
    return np.asarray(-s["sense"] * rate_Nm_s * time_s * np.expm1(-s["run_time"] / time_s))


def gravity_imbalance(s: Any, m: Any, torque_Nm: float, zero_rad: float) -> Array:
    """Torque of an imbalance: M sin(theta - zero)."""
    return np.asarray(torque_Nm * np.sin(s["angle"] - zero_rad))


def return_spring(s: Any, m: Any, stiffness_Nm_rad: float, rest_rad: float) -> Array:
    """Torque of a spring: k (theta - rest)."""
    return np.asarray(stiffness_Nm_rad * (s["angle"] - rest_rad))


def end_stop(
    s: Any, m: Any, angle_rad: float, stiffness_Nm_rad: float, other_rad: float = 0.0
) -> Array:
    """Torque of end stops: k (theta - a) at angles beyond the stop a, in the direction of the sign
    of a; with a second stop b, at angles above a, and k (theta - b) at angles below b.
    """
    if other_rad != 0.0:
        beyond = np.maximum(s["angle"] - angle_rad, 0.0) + np.minimum(s["angle"] - other_rad, 0.0)
        return np.asarray(stiffness_Nm_rad * beyond)
    side = np.copysign(1.0, angle_rad)
    return np.asarray(side * stiffness_Nm_rad * np.maximum(side * (s["angle"] - angle_rad), 0.0))


def load_exponent(s: Any, m: Any, exponent: float) -> Array:
    """Load friction proportional to F_P^p, equal to the nominal load friction at 3000 N."""
    force = np.maximum(s["moment"] / m["L1"], 1e-9)
    return np.asarray(load_torque(s, m) * ((force / 3000.0) ** (exponent - 1.0) - 1.0))


def load_position_dependence(s: Any, m: Any, slope_per_rad: float) -> Array:
    """Contact force that depends on the angle: F_P (1 + s theta), with the slope s per rad."""
    return np.asarray(load_torque(s, m) * slope_per_rad * s["angle"])


def wrong_weight(s: Any, m: Any, mass_kg: float, recording: float) -> Array:
    """Mass that differs from the label in one recording; recordings count from 1."""
    if s["number"] != round(recording) or s["mass"] <= 0.0:
        return np.zeros_like(s["time"])
    turning = (
        s["sense"] * np.abs(s["hanging"]) * gear_level(s["velocity"], m, m["alpha"]) - s["known"]
    )
    return np.asarray((load_torque(s, m) + turning) * (mass_kg / s["mass"] - 1.0))


def load_swing(s: Any, m: Any, fraction: float, frequency_Hz: float, decay_s: float) -> Array:
    """Contact force of a swinging weight: F_P (1 + f cos(2 pi nu t) exp(-t / T))."""
    t = s["time"] - s["time"][0]
    return np.asarray(
        load_torque(s, m) * fraction * np.cos(2.0 * np.pi * frequency_Hz * t) * np.exp(-t / decay_s)
    )


def load_inertia(s: Any, m: Any, inertia_kgm2: float) -> Array:
    """Inertia proportional to the mass on the lever."""
    return np.asarray(inertia_kgm2 * s["mass"] / 30.6 * s["acceleration"])


def lever_pivot_friction(s: Any, m: Any, torque_Nm: float) -> Array:
    """Coulomb friction of the lever's pivot: the same for every mass on the lever, zero without
    load.
    """
    return np.asarray(s["sense"] * torque_Nm * (s["moment"] != 0.0))


def load_dependent_friction(s: Any, m: Any, coefficient: float) -> Array:
    """Friction proportional to the torque of the known loads that turn with the joint."""
    return np.asarray(s["sense"] * coefficient * borne(s, m))


TORQUE: Mapping[str, Callable[..., Array]] = {
    f.__name__: f
    for f in (
        asymmetric_coulomb,
        asymmetric_viscous,
        quadratic_drag,
        stribeck_shape,
        friction_memory,
        dwell_static_friction,
        presliding,
        position_dependent_friction,
        viscous_thermal_drift,
        coulomb_drift,
        gravity_imbalance,
        return_spring,
        end_stop,
        load_exponent,
        load_position_dependence,
        wrong_weight,
        load_swing,
        load_inertia,
        lever_pivot_friction,
        load_dependent_friction,
    )
}
"""Effect name to its function, which returns an addition to the torque that the motion requires."""
