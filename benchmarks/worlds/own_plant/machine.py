"""Translates a world into the constants of the project's simulated machine.

All values are at the joint. A carriage has the same equations in m, N and kg, with a gear ratio in
rad of the motor per m.
"""

from __future__ import annotations

import math

from benchmarks.worlds.gains import gains
from benchmarks.worlds.world import World
from drivers.mock.plant.parts import constants

SENSED = frozenset(
    {
        "time_skew",
        "transport_delay",
        "current_offset",
        "current_drift",
        "encoder_eccentricity",
        "encoder_slip",
    }
)
"""Effects that the logger of a world applies."""
OF_THE_WORLD = SENSED | {"wrong_weight"}
"""Effects that are no property of the machine; a wrong weight is part of the load."""
ELASTIC = frozenset({"backlash", "compliance", "coupling_hysteresis"})
STIFF_HZ = 700.0
"""Natural frequency of rotor and joint on the stiffness of the gear teeth, for a machine without a
compliant gear; the value is that of the practical bench.
"""
STEP_S = 2.5e-5
"""Longest step of the integration, s."""


def machine_of(world: World) -> constants.Machine:
    """Return the simulated machine of a world, with its effects, without load."""
    motor, c, rate = world.motor, world.constants, world.drive.rate_Hz
    return constants.Machine(
        motor=constants.Motor(
            resistance_ohm=motor.resistance_ohm,
            inductance_H=motor.inductance_H,
            torque_constant_N_m_A=motor.constant,
            back_emf_constant_V_s_rad=motor.constant,
            gear_ratio=motor.gear_ratio,
            rotor_inertia_kg_m2=motor.rotor_share * c.J / motor.gear_ratio**2,
        ),
        joint=constants.Joint(
            inertia_kg_m2=c.J,
            Mc_N_m=c.Mc,
            Ms_N_m=c.Ms,
            omega_sf_rad_s=c.omega_sf,
            sigma_2_N_m_s_rad=c.sigma_2,
            mu_c=c.mu_c,
            mu_s=c.mu_s,
            omega_sL_rad_s=c.omega_sL,
            mu_2_s_rad=c.mu_2,
            moment_arm_m=world.moment_arm_m,
            lever_ratio=world.lever_ratio,
            gravity_m_s2=world.gravity_m_s2,
        ),
        loops=_loops(world),
        sensing=constants.Sensing(
            current_noise_A=world.sensing.current_noise_A, cycle_s=1.0 / rate
        ),
        steps_per_loop=math.ceil(1.0 / (rate * STEP_S)),
        supply_V=motor.supply_V,
        effects=_effects(world),
    )


def _loops(world: World) -> constants.Loops:
    """Return the loops of the drive; if a host computes the torque, only the current loop is
    closed.
    """
    drive, motor, gain = world.drive, world.motor, gains(world)
    hosted, cascade = drive.host_Hz > 0, drive.kind == "cascade"
    position, velocity = gain.position, gain.velocity
    if not cascade:
        position /= velocity
    return constants.Loops(
        rate_Hz=float(drive.rate_Hz),
        position_gain=0.0 if hosted else position,
        velocity_gain_N_m_s_rad=None if hosted else velocity,
        velocity_integral_1_s=gain.integral / velocity,
        velocity_filter_Hz=gain.filter_rad_s / (2.0 * math.pi),
        velocity_feedforward=drive.feedforward,
        current_gain_V_A=gain.current,
        current_integral_1_s=gain.current_integral / gain.current,
        voltage_limit_V=motor.supply_V,
        current_limit_A=motor.limit_A,
    )


def _effects(world: World) -> dict[str, dict[str, float]]:
    """Return the effects of the machine, by the names and parameters of the simulated machine."""
    found = {n: dict(given) for n, given in world.effects.items() if n not in OF_THE_WORLD}
    if ELASTIC & found.keys() and "compliance" not in found:
        reduced = world.constants.J * world.motor.rotor_share * (1.0 - world.motor.rotor_share)
        stiffness = reduced * (2.0 * math.pi * STIFF_HZ) ** 2
        found["compliance"] = {"stiffness_Nm_rad": stiffness}
    stop = found.get("end_stop", {})
    if "other_rad" in stop:
        # The first stop of the simulated machine is the upper stop.
        ends = stop["angle_rad"], stop["other_rad"]
        stop["angle_rad"], stop["other_rad"] = max(ends), min(ends)
    return found
