"""Packs the constants of the simulated joint and drive into vectors for compiled code."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.parts import constants, friction, loops


def friction_vector(joint: constants.Joint, contact_force_N: float) -> NDArray[np.float64]:
    """Pack the joint's constants for compiled code; ``contact_force_N`` is F_P of eq. 13."""
    p = np.zeros(friction.FRICTION_SIZE)
    p[friction.MC] = joint.Mc_N_m
    p[friction.DM] = joint.Ms_N_m - joint.Mc_N_m
    p[friction.OMEGA_SF] = joint.omega_sf_rad_s
    p[friction.SIGMA_2] = joint.sigma_2_N_m_s_rad
    p[friction.MU_C] = joint.mu_c
    p[friction.DMU] = joint.mu_s - joint.mu_c
    p[friction.OMEGA_SL] = joint.omega_sL_rad_s
    p[friction.MU_2] = joint.mu_2_s_rad
    p[friction.ALPHA] = joint.alpha
    p[friction.MOMENT] = contact_force_N * joint.moment_arm_m
    p[friction.INERTIA] = joint.inertia_kg_m2
    return p


def drive_vector(machine: constants.Machine) -> NDArray[np.float64]:
    """Pack motor and loop constants for compiled code, all referred to the joint."""
    motor, cascade, sensing = machine.motor, machine.loops, machine.sensing
    loop_s = 1.0 / cascade.rate_Hz
    counts = sensing.motor_counts_per_turn * motor.gear_ratio
    d = np.zeros(loops.DRIVE_SIZE)
    d[loops.RESISTANCE] = motor.resistance_ohm
    d[loops.INDUCTANCE] = motor.inductance_H
    d[loops.TORQUE_PER_AMPERE] = motor.torque_constant_N_m_A * motor.gear_ratio
    d[loops.EMF_PER_SPEED] = motor.back_emf_constant_V_s_rad * motor.gear_ratio
    d[loops.LOOP_S] = loop_s
    d[loops.STEPS] = machine.steps_per_loop
    d[loops.POSITION_GAIN] = cascade.position_gain
    d[loops.VELOCITY_GAIN] = cascade.velocity_gain_N_m_s_rad or 0.0
    d[loops.VELOCITY_INTEGRAL_GAIN] = cascade.velocity_integral_1_s
    d[loops.VELOCITY_FILTER] = 1.0 - math.exp(-2.0 * math.pi * cascade.velocity_filter_Hz * loop_s)
    d[loops.FEEDFORWARD] = cascade.velocity_feedforward
    d[loops.CURRENT_GAIN] = cascade.current_gain_V_A
    d[loops.CURRENT_INTEGRAL_GAIN] = cascade.current_integral_1_s
    d[loops.VOLTAGE_LIMIT] = min(cascade.voltage_limit_V, machine.supply_V)
    d[loops.CURRENT_LIMIT] = cascade.current_limit_A
    d[loops.COUNT] = 2.0 * math.pi / counts if counts else 0.0
    d[loops.NOISE] = sensing.current_noise_A * math.sqrt(sensing.cycle_s * cascade.rate_Hz)
    return d
