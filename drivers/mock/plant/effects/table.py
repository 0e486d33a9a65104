"""Table of the injectable effects of the catalogue: parameters, ranges, places in a vector.

All values are at the joint, after the gear, unless the name of a parameter states otherwise.
Effects that are in no catalogue are in :mod:`drivers.mock.plant.effects.outside`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

# Layout of the effect vector for compiled code; an effect whose size is 0 is absent.
(
    COGGING_TORQUE,
    COGGING_ORDER,
    COGGING_PHASE,
    RIPPLE_FRACTION,
    RIPPLE_ORDER,
    RIPPLE_PHASE,
    SATURATION_KNEE,
    SATURATION_RATIONAL,
    LAG_TIME,
    DEAD_TIME_VOLTAGE,
    BRUSH_VOLTAGE,
    BRUSH_CURRENT,
    HEATING_RISE,
    HEATING_TIME,
    HEATING_MAGNET,
    SAG_RESISTANCE,
    SAG_SUPPLY,
    STRAY_DRAG,
    GAP,
    STIFFNESS,
    MESH_AMPLITUDE,
    MESH_ORDER,
    MESH_PHASE,
    MESH_WITH_TORQUE,
    EFFICIENCY,
    WIND_TRAVEL,
    WIND_MOTION,
    WIND_TORQUE,
    HYSTERESIS_TORQUE,
    HYSTERESIS_DEFLECTION,
    ASYMMETRIC_COULOMB,
    ASYMMETRIC_VISCOUS,
    QUADRATIC_DRAG,
    STRIBECK_ALPHA,
    MEMORY_TIME,
    MEMORY_OF_SPEED,
    DWELL_GROWTH,
    DWELL_TIME,
    PRESLIDING_STIFFNESS,
    PATCH_TORQUE,
    PATCH_CENTER,
    PATCH_WIDTH,
    THERMAL_FRACTION,
    THERMAL_TIME,
    COULOMB_RATE,
    COULOMB_TIME,
    GRAVITY_TORQUE,
    GRAVITY_ZERO,
    SPRING_STIFFNESS,
    SPRING_REST,
    CONSTANT_TORQUE,
    STOP_ANGLE,
    STOP_STIFFNESS,
    STOP_OTHER,
    LOAD_EXPONENT,
    LOAD_SLOPE,
    WEIGHT_MASS,
    WEIGHT_RECORDING,
    SWING_FRACTION,
    SWING_FREQUENCY,
    SWING_DECAY,
    LOAD_INERTIA,
    PIVOT_TORQUE,
    LOAD_FRICTION,
    SKEW_TIME,
    DELAY_TIME,
    CURRENT_OFFSET,
    CURRENT_DRIFT,
    READING_RIPPLE,
    READING_ORDER,
    READING_PHASE,
    READING_AT_MOTOR,
    ECCENTRICITY,
    ECCENTRICITY_PHASE,
    SLIP_ANGLE,
    SLIP_TIME,
    SLIP_RECORDING,
    CATALOGUE_SIZE,
) = range(78)


class Parameter(NamedTuple):
    """Slot in the vector, range, and default of a parameter; None: it must be given."""

    slot: int
    low: float
    high: float
    default: float | None = None


_PHASE = (-6.3, 6.3)
_LONGEST_DELAY_S = 0.1
STEADY_DRIFT_S = 1e6  # time constant of a drift without saturation, s

CATALOGUE: Mapping[str, Mapping[str, Parameter]] = {
    "cogging": {
        "torque_Nm": Parameter(COGGING_TORQUE, 0.0, 30.0),
        "per_motor_turn": Parameter(COGGING_ORDER, 0.01, 100.0),
        "phase_rad": Parameter(COGGING_PHASE, *_PHASE),
    },
    "torque_ripple": {
        "fraction": Parameter(RIPPLE_FRACTION, 0.0, 0.5),
        "per_motor_turn": Parameter(RIPPLE_ORDER, 0.01, 100.0),
        "phase_rad": Parameter(RIPPLE_PHASE, *_PHASE),
    },
    "torque_saturation": {
        "knee_A": Parameter(SATURATION_KNEE, 1.0, 1e4),
        "rational": Parameter(SATURATION_RATIONAL, 0.0, 1.0, 0.0),
    },
    "current_loop_lag": {"time_s": Parameter(LAG_TIME, 0.0, 0.02)},
    "inverter_dead_time": {"voltage_V": Parameter(DEAD_TIME_VOLTAGE, 0.0, 10.0)},
    "brush_drop": {
        "voltage_V": Parameter(BRUSH_VOLTAGE, 0.0, 10.0),
        "current_A": Parameter(BRUSH_CURRENT, 0.01, 20.0),
    },
    "winding_heating": {
        "rise_K_per_W": Parameter(HEATING_RISE, 0.0, 50.0),
        "time_s": Parameter(HEATING_TIME, 1.0, 1e5),
        "magnet": Parameter(HEATING_MAGNET, 0.0, 1.0, 1.0),
    },
    "supply_sag": {
        "resistance_ohm": Parameter(SAG_RESISTANCE, 0.0, 2.0),
        "supply_V": Parameter(SAG_SUPPLY, 0.0, 1e4, 0.0),
    },
    "stray_loss": {"coefficient_Nms_A2rad": Parameter(STRAY_DRAG, 0.0, 1.0)},
    "backlash": {"gap_rad": Parameter(GAP, 0.0, 0.1)},
    "compliance": {"stiffness_Nm_rad": Parameter(STIFFNESS, 300.0, 1e6)},
    "gear_mesh_ripple": {
        "amplitude_rad": Parameter(MESH_AMPLITUDE, 0.0, 0.02),
        "per_turn": Parameter(MESH_ORDER, 0.1, 200.0),
        "phase_rad": Parameter(MESH_PHASE, *_PHASE),
        "with_torque": Parameter(MESH_WITH_TORQUE, 0.0, 1.0, 1.0),
    },
    "transmission_efficiency": {"efficiency": Parameter(EFFICIENCY, 0.3, 1.0)},
    "gear_friction": {
        "travel_rad": Parameter(WIND_TRAVEL, 1e-6, 1.0),
        "against_motion": Parameter(WIND_MOTION, 0.0, 0.6),
        "against_torque": Parameter(WIND_TORQUE, 0.0, 0.35),
    },
    "coupling_hysteresis": {
        "torque_Nm": Parameter(HYSTERESIS_TORQUE, 0.1, 100.0),
        "deflection_rad": Parameter(HYSTERESIS_DEFLECTION, 0.0, 0.05),
    },
    "asymmetric_coulomb": {"torque_Nm": Parameter(ASYMMETRIC_COULOMB, -30.0, 30.0)},
    "asymmetric_viscous": {"coefficient_Nms_rad": Parameter(ASYMMETRIC_VISCOUS, -20.0, 20.0)},
    "quadratic_drag": {"coefficient_Nms2_rad2": Parameter(QUADRATIC_DRAG, 0.0, 100.0)},
    "stribeck_shape": {"alpha": Parameter(STRIBECK_ALPHA, 0.3, 6.0)},
    "friction_memory": {
        "time_s": Parameter(MEMORY_TIME, 0.0, 1.0),
        "of_speed": Parameter(MEMORY_OF_SPEED, 0.0, 1.0, 0.0),
    },
    "dwell_static_friction": {
        "growth_Nm": Parameter(DWELL_GROWTH, 0.0, 30.0),
        "time_s": Parameter(DWELL_TIME, 0.01, 1e4),
    },
    "presliding": {"stiffness_Nm_rad": Parameter(PRESLIDING_STIFFNESS, 300.0, 1e7)},
    "position_dependent_friction": {
        "torque_Nm": Parameter(PATCH_TORQUE, -10.0, 30.0),
        "center_rad": Parameter(PATCH_CENTER, -3.2, 3.2),
        "width_rad": Parameter(PATCH_WIDTH, 1e-3, 3.2),
    },
    "viscous_thermal_drift": {
        "fraction": Parameter(THERMAL_FRACTION, -1.0, 1.0),
        "time_s": Parameter(THERMAL_TIME, 1.0, 1e5),
    },
    "coulomb_drift": {
        "rate_Nm_s": Parameter(COULOMB_RATE, -1.0, 1.0),
        "time_s": Parameter(COULOMB_TIME, 1.0, STEADY_DRIFT_S, STEADY_DRIFT_S),
    },
    "gravity_imbalance": {
        "torque_Nm": Parameter(GRAVITY_TORQUE, 0.0, 50.0),
        "zero_rad": Parameter(GRAVITY_ZERO, *_PHASE),
    },
    "return_spring": {
        "stiffness_Nm_rad": Parameter(SPRING_STIFFNESS, 0.0, 200.0),
        "rest_rad": Parameter(SPRING_REST, -3.2, 3.2),
    },
    "constant_torque": {"torque_Nm": Parameter(CONSTANT_TORQUE, -300.0, 300.0)},
    "end_stop": {
        "angle_rad": Parameter(STOP_ANGLE, -3.2, 3.2),
        "stiffness_Nm_rad": Parameter(STOP_STIFFNESS, 0.0, 1e5),
        "other_rad": Parameter(STOP_OTHER, -3.2, 3.2, 0.0),
    },
    "load_exponent": {"exponent": Parameter(LOAD_EXPONENT, 0.2, 3.0)},
    "load_position_dependence": {"slope_per_rad": Parameter(LOAD_SLOPE, -2.0, 2.0)},
    "wrong_weight": {
        "mass_kg": Parameter(WEIGHT_MASS, 0.01, 100.0),
        "recording": Parameter(WEIGHT_RECORDING, 1.0, 1e4),
    },
    "load_swing": {
        "fraction": Parameter(SWING_FRACTION, -0.9, 0.9),
        "frequency_Hz": Parameter(SWING_FREQUENCY, 0.01, 100.0),
        "decay_s": Parameter(SWING_DECAY, 0.01, 1e4),
    },
    "load_inertia": {"inertia_kgm2": Parameter(LOAD_INERTIA, 0.0, 10.0)},
    "lever_pivot_friction": {"torque_Nm": Parameter(PIVOT_TORQUE, 0.0, 30.0)},
    "load_dependent_friction": {"coefficient": Parameter(LOAD_FRICTION, 0.0, 1.0)},
    "time_skew": {"time_s": Parameter(SKEW_TIME, 0.0, _LONGEST_DELAY_S)},
    "transport_delay": {"time_s": Parameter(DELAY_TIME, 0.0, _LONGEST_DELAY_S)},
    "current_offset": {"current_A": Parameter(CURRENT_OFFSET, -5.0, 5.0)},
    "current_drift": {"rate_A_s": Parameter(CURRENT_DRIFT, -0.5, 0.5)},
    "encoder_ripple": {
        "amplitude_rad": Parameter(READING_RIPPLE, 0.0, 0.5),
        "per_turn": Parameter(READING_ORDER, 0.01, 100.0),
        "phase_rad": Parameter(READING_PHASE, *_PHASE),
        "at_motor": Parameter(READING_AT_MOTOR, 1.0, 1.0, 1.0),
    },
    "encoder_eccentricity": {
        "amplitude_rad": Parameter(ECCENTRICITY, 0.0, 0.1),
        "phase_rad": Parameter(ECCENTRICITY_PHASE, *_PHASE),
    },
    "encoder_slip": {
        "angle_rad": Parameter(SLIP_ANGLE, -0.5, 0.5),
        "at_s": Parameter(SLIP_TIME, 0.0, 1e5),
        "recording": Parameter(SLIP_RECORDING, 1.0, 1e4),
    },
}
"""Slot and range of each parameter of each effect.

``recording`` counts the times that the power is switched on, from 1; ``at_s`` is the time since
then. The resistance of ``supply_sag`` refers to ``supply_V``, or, if this is 0, to the machine's
supply voltage.
"""


(
    JOINT,  # true joint angle, rad; the nominal state has the rotor's angle over the gear ratio
    ROTOR_SPEED,  # rotor speed over the gear ratio, rad/s
    TIME,  # s since the power was switched on
    RUN,  # s since the machine was built, pauses included
    RECORDING,  # number of times that the power was switched on
    HEAT,  # K, temperature of the winding above ambient
    TORQUE_CURRENT,  # A, the current that determines the torque
    PLAY,  # N m, hysteresis of the coupling
    BRISTLES,  # rad
    FALLING,  # N m, delayed part of friction that falls with speed; or the delayed speed, rad/s
    GROWN,  # N m, increase of the static limit by time at rest
    WOUND,  # state of the gear's friction, -1 to 1
    TRAVEL,  # state of the friction with long presliding travel, -1 to 1
    ACCELERATION,  # rad/s^2, smoothed
    TRANSMITTED,  # N m, torque at the gear's output
    EXTERNAL,  # N m, torque of weight, springs and steady load on the joint
    SUPPLY,  # V
    SLIPPED,  # rad, of the joint encoder
    SEEN,  # joint angle as its encoder measures it, rad
    LOOP,  # drive-loop periods since the machine was built
    EXTRA_SIZE,
) = range(21)

# Indices after the effects in the effect vector: constants that the formulas of the effects need.
(
    ROTOR_INERTIA,  # kg m^2 at the joint
    SHAFT_DAMPING,  # N m s/rad
    GEAR,
    NOMINAL_SUPPLY,  # V
    TWO_MASSES,  # 1: rotor and joint are two masses
    OUTSIDE_TORQUE,  # 1: an effect that is in no catalogue acts on the joint
    STEADY_LOAD,  # N m, known torque on the joint, the same at every angle
    CONSTANTS_SIZE,
) = range(8)

HISTORY = 4096  # number of stored past loop periods; a power of two
