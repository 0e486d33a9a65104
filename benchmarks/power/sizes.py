"""The size of an effect as one number that grows with the effect, and the sizes that proofs
inject.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from rig.results.prove.worlds.draw import scale_of
from rig.results.prove.worlds.sizes import SIZES
from rig.results.prove.worlds.world import World

Parameters = Mapping[str, float]
DRAWS = 101
PARAMETER = {
    "cogging": "torque_Nm",
    "torque_ripple": "fraction",
    "torque_saturation": "knee_A",
    "current_loop_lag": "time_s",
    "inverter_dead_time": "voltage_V",
    "brush_drop": "voltage_V",
    "winding_heating": "rise_K_per_W",
    "supply_sag": "resistance_ohm",
    "backlash": "gap_rad",
    "compliance": "stiffness_Nm_rad",
    "gear_mesh_ripple": "amplitude_rad",
    "transmission_efficiency": "efficiency",
    "coupling_hysteresis": "deflection_rad",
    "asymmetric_coulomb": "torque_Nm",
    "asymmetric_viscous": "coefficient_Nms_rad",
    "quadratic_drag": "coefficient_Nms2_rad2",
    "stribeck_shape": "alpha",
    "friction_memory": "time_s",
    "dwell_static_friction": "growth_Nm",
    "presliding": "stiffness_Nm_rad",
    "position_dependent_friction": "torque_Nm",
    "viscous_thermal_drift": "fraction",
    "coulomb_drift": "rate_Nm_s",
    "gravity_imbalance": "torque_Nm",
    "return_spring": "stiffness_Nm_rad",
    "end_stop": "stiffness_Nm_rad",
    "load_exponent": "exponent",
    "load_position_dependence": "slope_per_rad",
    "wrong_weight": "mass_kg",
    "load_swing": "fraction",
    "load_inertia": "inertia_kgm2",
    "lever_pivot_friction": "torque_Nm",
    "load_dependent_friction": "coefficient",
    "time_skew": "time_s",
    "transport_delay": "time_s",
    "current_offset": "current_A",
    "current_drift": "rate_A_s",
    "encoder_eccentricity": "amplitude_rad",
    "encoder_slip": "angle_rad",
}
"""Effect to the parameter that is its size."""
SOFT = frozenset({"torque_saturation", "compliance", "presliding"})
"""Effects that are greater where their parameter is smaller."""
FROM: Mapping[str, float] = {"transmission_efficiency": 1.0, "load_exponent": 1.0}
"""Effects that are greater the farther their parameter is from a value."""
GRID = frozenset(
    {
        "backlash",
        "compliance",
        "coupling_hysteresis",
        "friction_memory",
        "load_exponent",
        "presliding",
        "stribeck_shape",
        "time_skew",
        "transport_delay",
    }
)
"""Effects of which only some trial sizes are tested, so that the least size is one of these."""


def strength(effect: str, given: Parameters, labels: Sequence[float] = ()) -> float:
    """Return a number in proportion to the trace of a small effect.

    Args:
        effect: Name in the catalogue.
        given: Its parameters.
        labels: Masses of the weights, kg, for a wrong weight.
    """
    value = float(given[PARAMETER[effect]])
    if effect in SOFT:
        return 1.0 / abs(value)
    if effect in FROM:
        return abs(value - FROM[effect])
    if effect == "stribeck_shape":
        return abs(math.log(value / 2.0))
    if effect == "wrong_weight":
        return min((abs(value / label - 1.0) for label in labels if label > 0.0), default=math.nan)
    return abs(value)


def injected(world: World, effects: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Return the quartiles of the parameters and of the strengths that proofs inject into a
    world.
    """
    scale, labels = scale_of(world, world.recordings), labels_of(world)
    found = {}
    for name in effects:
        draw: Callable[..., Parameters] = SIZES[name]
        rng = np.random.default_rng([*world.seed, 5])
        drawn = [draw(rng, scale) for _ in range(DRAWS)]
        values = [abs(d[PARAMETER[name]]) for d in drawn]
        strengths = [strength(name, d, labels) for d in drawn]
        found[name] = {
            "value": np.quantile(values, (0.25, 0.5, 0.75)).tolist(),
            "strength": np.quantile(strengths, (0.25, 0.5, 0.75)).tolist(),
        }
    return found


def labels_of(world: World) -> list[float]:
    """Return the masses of the weights on the lever of a world, kg."""
    return sorted({r.weight_kg for r in world.recordings if r.weight_kg > 0.0})
