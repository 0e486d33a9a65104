"""Draws the size of an injected effect relative to the machine, from near the noise to obvious.

Names and units of parameters are those of a rotary machine; on a linear machine the values are in m
and N.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rig.results.prove.draw import away_from, either, even, log, one_of

Parameters = dict[str, float]
_phase = even(-math.pi, math.pi)
_order = one_of(1.0, 2.0, 4.0, 6.0, 7.0, 12.0)


@dataclass(frozen=True)
class Scale:
    """Scales to which the sizes of effects are relative.

    Attributes:
        Mc: Coulomb friction, N m.
        sigma_2: Viscous friction, N m s/rad.
        J: Inertia, kg m^2.
        travel: Greatest commanded angle, rad.
        farthest: Greatest commanded angle with its sign, rad: the side of an end stop.
        speed: Greatest commanded speed, rad/s.
        current: Current of the greatest friction, A.
        resistance: Resistance of the winding, ohm.
        supply: Supply voltage of the power stage, V.
        heaviest: Heaviest weight on the lever, kg.
        loaded: Numbers of the loaded recordings to fit, from 1, and the labels of their weights.
        recordings: Number of recordings to fit.
        shortest_s: Length of the shortest recording.
        unit: Angle to which errors of an encoder are relative: 1 rad, or the travel of a carriage.
    """

    Mc: float
    sigma_2: float
    J: float
    travel: float
    farthest: float
    speed: float
    current: float
    resistance: float
    supply: float
    heaviest: float
    loaded: tuple[tuple[int, float], ...]
    recordings: int
    shortest_s: float
    unit: float = 1.0


Draw = Callable[[np.random.Generator, Scale], Parameters]


def _stop(rng: np.random.Generator, s: Scale) -> Parameters:
    at = s.farthest * even(0.5, 0.85)(rng)
    stiffness = s.Mc * log(0.3, 2.0)(rng) / abs(s.farthest - at)
    given = {"angle_rad": at, "stiffness_Nm_rad": stiffness}
    return given | ({"other_rad": -at} if rng.uniform() < 0.5 else {})


def _wrong_weight(rng: np.random.Generator, s: Scale) -> Parameters:
    number, label = s.loaded[int(rng.integers(len(s.loaded)))]
    return {"mass_kg": label * (1.0 + either(0.05, 0.4)(rng)), "recording": float(number)}


def _coulomb_drift(rng: np.random.Generator, s: Scale) -> Parameters:
    time_s = log(10.0, 200.0)(rng)
    return {"rate_Nm_s": either(0.03, 0.25)(rng) * s.Mc / time_s, "time_s": time_s}


def _slip(rng: np.random.Generator, s: Scale) -> Parameters:
    return {
        "angle_rad": either(5e-4, 1e-2)(rng) * s.unit,
        "at_s": s.shortest_s * even(0.2, 0.8)(rng),
        "recording": float(rng.integers(1, s.recordings + 1)),
    }


SIZES: Mapping[str, Draw] = {
    "cogging": lambda r, s: {
        "torque_Nm": log(0.03, 0.3)(r) * s.Mc,
        "per_motor_turn": _order(r),
        "phase_rad": _phase(r),
    },
    "torque_ripple": lambda r, s: {
        "fraction": log(0.015, 0.15)(r),
        "per_motor_turn": _order(r),
        "phase_rad": _phase(r),
    },
    "torque_saturation": lambda r, s: {
        "knee_A": log(2.2, 7.0)(r) * s.current,
        "rational": one_of(0.0, 1.0)(r),
    },
    "current_loop_lag": lambda r, s: {"time_s": log(5e-4, 6e-3)(r)},
    "inverter_dead_time": lambda r, s: {"voltage_V": log(0.005, 0.04)(r) * s.supply},
    "brush_drop": lambda r, s: {
        "voltage_V": log(0.006, 0.05)(r) * s.supply,
        "current_A": log(0.05, 0.3)(r) * s.current,
    },
    "winding_heating": lambda r, s: {
        "rise_K_per_W": log(6.0, 80.0)(r) / (0.5 * s.resistance * s.current**2),
        "time_s": log(15.0, 300.0)(r),
    },
    "supply_sag": lambda r, s: {"resistance_ohm": log(0.04, 0.5)(r) * s.supply / s.current},
    "stray_loss": lambda r, s: {
        "coefficient_Nms_A2rad": log(0.02, 0.2)(r) * s.Mc / (s.current**2 * s.speed)
    },
    "backlash": lambda r, s: {"gap_rad": log(5e-4, 3e-2)(r) * s.travel},
    "compliance": lambda r, s: {"stiffness_Nm_rad": s.Mc / (log(5e-4, 1.5e-2)(r) * s.travel)},
    "gear_mesh_ripple": lambda r, s: {
        "amplitude_rad": log(1e-4, 3e-3)(r) * s.travel,
        "per_turn": one_of(8.0, 20.0, 33.0, 50.0)(r),
        "phase_rad": _phase(r),
    },
    "transmission_efficiency": lambda r, s: {"efficiency": 1.0 - log(0.03, 0.25)(r)},
    "gear_friction": lambda r, s: {
        "travel_rad": log(2e-3, 3e-2)(r) * s.travel,
        "against_motion": log(0.05, 0.3)(r),
        "against_torque": log(0.01, 0.1)(r),
    },
    "coupling_hysteresis": lambda r, s: {
        "torque_Nm": log(0.15, 1.0)(r) * s.Mc,
        "deflection_rad": log(5e-4, 1e-2)(r) * s.travel,
    },
    "asymmetric_coulomb": lambda r, s: {"torque_Nm": either(0.02, 0.3)(r) * s.Mc},
    "asymmetric_viscous": lambda r, s: {"coefficient_Nms_rad": either(0.04, 0.4)(r) * s.sigma_2},
    "quadratic_drag": lambda r, s: {"coefficient_Nms2_rad2": log(0.1, 1.0)(r) * s.Mc / s.speed**2},
    "stribeck_shape": lambda r, s: {
        "alpha": float(2.0 * math.exp(r.choice((-1, 1)) * r.uniform(0.2, 0.9)))
    },
    "friction_memory": lambda r, s: {"time_s": log(4e-3, 8e-2)(r)},
    "dwell_static_friction": lambda r, s: {
        "growth_Nm": log(0.1, 0.8)(r) * s.Mc,
        "time_s": log(0.2, 4.0)(r),
    },
    "presliding": lambda r, s: {"stiffness_Nm_rad": s.Mc / (log(5e-4, 2e-2)(r) * s.travel)},
    "position_dependent_friction": lambda r, s: {
        "torque_Nm": log(0.05, 0.5)(r) * s.Mc,
        "center_rad": even(-0.6, 0.6)(r) * s.travel,
        "width_rad": log(0.08, 0.4)(r) * s.travel,
    },
    "viscous_thermal_drift": lambda r, s: {
        "fraction": log(0.08, 0.6)(r),
        "time_s": log(10.0, 300.0)(r),
    },
    "coulomb_drift": _coulomb_drift,
    "gravity_imbalance": lambda r, s: {
        "torque_Nm": log(0.05, 0.6)(r) * s.Mc,
        "zero_rad": _phase(r),
    },
    "return_spring": lambda r, s: {
        "stiffness_Nm_rad": log(0.06, 0.8)(r) * s.Mc / s.travel,
        "rest_rad": even(-0.5, 0.5)(r) * s.travel,
    },
    "constant_torque": lambda r, s: {"torque_Nm": either(0.05, 2.0)(r) * s.Mc},
    "end_stop": _stop,
    "load_exponent": lambda r, s: {"exponent": away_from(1.0, 0.05, 0.4)(r)},
    "load_position_dependence": lambda r, s: {"slope_per_rad": either(0.05, 0.6)(r) / s.travel},
    "wrong_weight": _wrong_weight,
    "load_swing": lambda r, s: {
        "fraction": log(0.05, 0.5)(r),
        "frequency_Hz": log(0.4, 2.0)(r),
        "decay_s": log(3.0, 20.0)(r),
    },
    "load_inertia": lambda r, s: {
        "inertia_kgm2": log(0.1, 1.5)(r) * s.J * 30.6 / max(s.heaviest, 1e-9)
    },
    "lever_pivot_friction": lambda r, s: {"torque_Nm": log(0.03, 0.3)(r) * s.Mc},
    "load_dependent_friction": lambda r, s: {"coefficient": log(0.02, 0.25)(r)},
    "time_skew": lambda r, s: {"time_s": either(1e-3, 1.5e-2)(r)},
    "transport_delay": lambda r, s: {"time_s": log(1e-3, 1.5e-2)(r)},
    "current_offset": lambda r, s: {"current_A": either(0.01, 0.15)(r) * s.current},
    "current_drift": lambda r, s: {"rate_A_s": either(0.02, 0.2)(r) * s.current / 30.0},
    "encoder_ripple": lambda r, s: {
        "amplitude_rad": log(2e-3, 3e-2)(r),
        "per_turn": one_of(1.0, 2.0, 4.0)(r),
        "phase_rad": _phase(r),
    },
    "encoder_eccentricity": lambda r, s: {
        "amplitude_rad": log(3e-4, 1e-2)(r),
        "phase_rad": _phase(r),
    },
    "encoder_slip": _slip,
    "x_timed_torque": lambda r, s: {
        "torque_Nm": log(0.06, 0.5)(r) * s.Mc,
        "frequency_Hz": log(0.2, 12.0)(r),
        "phase_rad": _phase(r),
    },
    "x_switching_torque": lambda r, s: {
        "torque_Nm": log(0.06, 0.4)(r) * s.Mc,
        "period_s": log(0.7, 6.0)(r),
    },
    "x_cubic_spring": lambda r, s: {"stiffness_Nm_rad3": log(0.15, 1.0)(r) * s.Mc / s.travel**3},
    "x_bursts": lambda r, s: {
        "torque_Nm": log(0.08, 0.6)(r) * s.Mc,
        "period_s": log(0.5, 4.0)(r),
        "length_s": log(0.05, 0.4)(r),
    },
    "x_quadrant_friction": lambda r, s: {"torque_Nm": either(0.06, 0.4)(r) * s.Mc},
    "x_two_wells": lambda r, s: {
        "torque_Nm": log(0.1, 0.6)(r) * s.Mc,
        "center_rad": even(0.2, 0.7)(r) * s.travel,
        "width_rad": log(0.05, 0.2)(r) * s.travel,
    },
    "x_travel_memory": lambda r, s: {
        "torque_Nm": log(0.1, 0.5)(r) * s.Mc,
        "travel_rad": log(0.2, 2.0)(r) * s.travel,
    },
    "x_root_drag": lambda r, s: {
        "coefficient_Nms05_rad05": log(0.1, 0.6)(r) * s.Mc / math.sqrt(s.speed)
    },
    "x_speed_resonance": lambda r, s: {
        "torque_Nm": log(0.1, 0.6)(r) * s.Mc,
        "speed_rad_s": log(0.15, 0.6)(r) * s.speed,
        "width_rad_s": log(0.04, 0.12)(r) * s.speed,
    },
    "x_one_way_patch": lambda r, s: {
        "torque_Nm": log(0.1, 0.6)(r) * s.Mc,
        "center_rad": even(-0.6, 0.6)(r) * s.travel,
        "width_rad": log(0.08, 0.3)(r) * s.travel,
    },
    "x_wandering_torque": lambda r, s: {
        "torque_Nm": log(0.1, 0.5)(r) * s.Mc,
        "period_s": log(0.5, 6.0)(r),
    },
    "x_field_sag": lambda r, s: {
        "resistance_ohm": log(0.04, 0.5)(r) * s.supply / s.current,
        "time_s": log(0.02, 0.5)(r),
    },
    "x_acceleration_drag": lambda r, s: {"coefficient_Nms2_rad": either(0.08, 0.4)(r) * s.J},
}
"""Functions that draw the parameters of effects, by effect; effects whose names begin with x_ are
not in the catalogue.
"""

NEEDS: Mapping[str, frozenset[str]] = {
    **dict.fromkeys(("transport_delay", "encoder_slip"), frozenset({"two encoders"})),
    **dict.fromkeys(
        ("gear_mesh_ripple", "encoder_eccentricity"), frozenset({"two encoders", "turning joint"})
    ),
    "gravity_imbalance": frozenset({"turning joint"}),
    **dict.fromkeys(("brush_drop", "winding_heating"), frozenset({"voltage"})),
    **dict.fromkeys(("inverter_dead_time", "supply_sag"), frozenset({"commanded voltage"})),
    **dict.fromkeys(
        ("wrong_weight", "load_exponent", "load_inertia", "lever_pivot_friction"),
        frozenset({"two weights"}),
    ),
    **dict.fromkeys(("load_swing", "load_position_dependence"), frozenset({"lever"})),
    **dict.fromkeys(
        ("backlash", "compliance", "coupling_hysteresis", "encoder_ripple"),
        frozenset({"motor encoder"}),
    ),
    **dict.fromkeys(
        ("transmission_efficiency", "gear_friction", "load_dependent_friction"),
        frozenset({"known torque"}),
    ),
    # A low-pass filter of the current has the same delay as these effects.
    **dict.fromkeys(("time_skew", "current_loop_lag"), frozenset({"unfiltered current"})),
    "stribeck_shape": frozenset({"fall"}),
    "friction_memory": frozenset({"fall"}),
}
"""Properties that a world needs for an effect to show, by effect."""
