"""Stable names of the physical effects a bench may be declared to have, or be diagnosed with."""

from __future__ import annotations

from collections.abc import Mapping

CATALOGUE: Mapping[str, tuple[str, ...]] = {
    "motor": (
        "cogging",
        "torque_ripple",
        "torque_saturation",
        "current_loop_lag",
        "inverter_dead_time",
        "brush_drop",
        "winding_heating",
        "supply_sag",
    ),
    "transmission": (
        "backlash",
        "compliance",
        "gear_mesh_ripple",
        "transmission_efficiency",
        "coupling_hysteresis",
    ),
    "friction": (
        "asymmetric_coulomb",
        "asymmetric_viscous",
        "quadratic_drag",
        "stribeck_shape",
        "friction_memory",
        "dwell_static_friction",
        "presliding",
        "position_dependent_friction",
        "viscous_thermal_drift",
        "coulomb_drift",
    ),
    "device": (
        "gravity_imbalance",
        "return_spring",
        "end_stop",
        "load_exponent",
        "load_position_dependence",
        "wrong_weight",
        "load_swing",
        "load_inertia",
        "lever_pivot_friction",
        "load_dependent_friction",
    ),
    "sensing": (
        "time_skew",
        "transport_delay",
        "current_offset",
        "current_drift",
        "encoder_eccentricity",
        "encoder_slip",
    ),
    "gas generator": (
        "throat_deposition",
        "burning_area_change",
        "erosive_burning",
        "heat_loss",
        "leakage",
    ),
}
"""Group to names, in the order of the catalogue."""

EFFECTS: tuple[str, ...] = tuple(name for names in CATALOGUE.values() for name in names)
