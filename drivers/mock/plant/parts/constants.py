"""Constants of the simulated machine, as frozen records in SI units.

Friction, inertia and load are stated at the joint (valve shaft), motor constants at the motor
shaft; the gear ratio joins them (assumption 5, theta = i theta_r).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Motor:
    """DC motor, eq. 1: R I + L dI/dt = U - Ke domega_m ; torque Km I.

    Attributes:
        resistance_ohm: Winding resistance R.
        inductance_H: Winding inductance L.
        torque_constant_N_m_A: Torque constant Km, at the motor.
        back_emf_constant_V_s_rad: Back-EMF constant Ke, at the motor.
        gear_ratio: Motor turns per turn of the joint.
        rotor_inertia_kg_m2: Inertia of the rotor at the motor. It is part of the joint's total
            inertia; its value matters only with an elastic transmission.
    """

    resistance_ohm: float = 1.56
    inductance_H: float = 0.00132
    torque_constant_N_m_A: float = 0.03
    back_emf_constant_V_s_rad: float = 0.02588
    gear_ratio: float = 100.0
    rotor_inertia_kg_m2: float = 1e-5


@dataclass(frozen=True)
class Joint:
    """Inertia, system load (eq. 9), working load (eq. 12, 13) and lever (eq. 17), at the joint.

    Attributes:
        inertia_kg_m2: Total inertia at the joint, including the rotor of the motor.
        Mc_N_m: Coulomb friction without load.
        Ms_N_m: Static friction without load.
        omega_sf_rad_s: Stribeck speed without load.
        sigma_2_N_m_s_rad: Viscous friction.
        mu_c: Coefficient of sliding friction under the contact force.
        mu_s: Coefficient of static friction under the contact force.
        omega_sL_rad_s: Stribeck speed under load.
        mu_2_s_rad: Growth of the friction coefficient under load with speed.
        alpha: Exponent of the Stribeck curve.
        moment_arm_m: Radius L1 at which the contact force acts.
        lever_ratio: Contact force over the weight on the lever, L3/L4.
        gravity_m_s2: Local gravity.
    """

    inertia_kg_m2: float = 0.204
    Mc_N_m: float = 6.825
    Ms_N_m: float = 12.025
    omega_sf_rad_s: float = 0.0557
    sigma_2_N_m_s_rad: float = 5.3462
    mu_c: float = 0.052
    mu_s: float = 0.086
    omega_sL_rad_s: float = 0.0326
    mu_2_s_rad: float = 0.032
    alpha: float = 2.0
    moment_arm_m: float = 0.095
    lever_ratio: float = 10.0
    gravity_m_s2: float = 9.80665


@dataclass(frozen=True)
class Loops:
    """The control loops of the drive in cascade: position P, velocity PI, current PI.

    Attributes:
        rate_Hz: Rate of all three loops.
        position_gain: Speed command per position error, 1/s; in N m/rad where
            `velocity_gain_N_m_s_rad` is null.
        velocity_gain_N_m_s_rad: Joint torque per speed error; null for a drive with a position loop
            only, whose torque command is `position_gain` times the position error.
        velocity_integral_1_s: Inverse reset time of the velocity loop.
        velocity_filter_Hz: Cut-off of the filter on the measured speed.
        velocity_feedforward: Share of the commanded speed that is added to the speed command.
        current_gain_V_A: Proportional gain of the current loop.
        current_integral_1_s: Inverse reset time of the current loop.
        voltage_limit_V: Largest voltage that the drive applies.
        current_limit_A: Largest current that the drive commands.
    """

    rate_Hz: float = 20000.0
    position_gain: float = 60.0
    velocity_gain_N_m_s_rad: float | None = 120.0
    velocity_integral_1_s: float = 60.0
    velocity_filter_Hz: float = 400.0
    velocity_feedforward: float = 1.0
    current_gain_V_A: float = 5.0
    current_integral_1_s: float = 1000.0
    voltage_limit_V: float = 60.0
    current_limit_A: float = 25.0


@dataclass(frozen=True)
class Sensing:
    """Resolution and noise of the sensors of drive and joint; zero counts mean an exact sensor.

    Attributes:
        motor_counts_per_turn: Counts of the motor encoder per motor turn.
        joint_counts_per_turn: Counts of the joint encoder per joint turn.
        current_noise_A: Noise (rms) of the logged mean current over one cycle. The noise of each
            sample of the current loop is this value times the square root of the number of samples
            per cycle.
        cycle_s: Time over which current and voltage are averaged, equal to the control cycle.
    """

    motor_counts_per_turn: int = 4096
    joint_counts_per_turn: int = 262144
    current_noise_A: float = 0.020
    cycle_s: float = 0.001


@dataclass(frozen=True)
class Valve:
    """The gate of Fig. 3: a plate with a hole, swinging in its own plane on radius L1 over an
    opening.

    Attributes:
        hole_diameter_m: Diameter of the hole in the plate.
        opening_diameter_m: Diameter of the opening behind the plate.
        plate_width_m: Width of the plate.
    """

    hole_diameter_m: float = 0.025
    opening_diameter_m: float = 0.040
    plate_width_m: float = 0.054


@dataclass(frozen=True)
class Transmitter:
    """The pressure transmitter on the chamber; both default values are assumptions.

    Attributes:
        noise_Pa: Noise (rms) of one sample.
        range_Pa: Highest pressure that the transmitter measures.
    """

    noise_Pa: float = 1500.0
    range_Pa: float = 10e6


@dataclass(frozen=True)
class GasGenerator:
    """Gas generator, eq. 2 to 8: end burning at r = a p^n, choked outflow p A_t / C_r, ideal gas at
    one temperature.

    The paper gives the first five values; the other defaults are assumptions. With these values the
    pressure is 4.4 MPa at the smallest throat and 0.6 MPa at the full throat, and the contact force
    of the closed valve is 3.0 kN, as in Case 2 of the paper.

    Attributes:
        propellant_density_kg_m3: Density of the propellant.
        burning_rate_mm_s: Burning rate a at 1 MPa.
        pressure_exponent: Exponent n of the burning law.
        chamber_diameter_m: Diameter of the end-burning grain.
        valve: Dimensions of the gate.
        characteristic_velocity_m_s: Characteristic velocity C_r of the gas.
        energy_J_kg: R_g T_g of the gas, (0.658 C_r)^2 at a specific-heat ratio of 1.25.
        free_volume_m3: Volume of the chamber without the grain, at ignition.
        back_pressure_Pa: Pressure downstream of the valve.
        transmitter: The pressure transmitter.
        equation: 7 is exact and conserves mass; 8 neglects the density of the gas against that of
            the propellant.
        loops_per_step: Periods of the drive's loops between two updates of pressure and contact
            force.
    """

    propellant_density_kg_m3: float = 1630.0
    burning_rate_mm_s: float = 6.3
    pressure_exponent: float = 0.53
    chamber_diameter_m: float = 0.350
    valve: Valve = field(default_factory=Valve)
    characteristic_velocity_m_s: float = 1000.0  # chosen
    energy_J_kg: float = 432964.0  # chosen
    free_volume_m3: float = 0.010  # chosen
    back_pressure_Pa: float = 0.5e6  # chosen
    transmitter: Transmitter = field(default_factory=Transmitter)
    equation: Literal[7, 8] = 7
    loops_per_step: int = 2


@dataclass(frozen=True)
class Machine:
    """All constants that define one simulated bench.

    Attributes:
        motor: The DC motor.
        joint: Inertia, friction and lever.
        loops: The drive's control loops.
        sensing: Resolution and noise of the sensors.
        gas: The gas generator of hot firings.
        steps_per_loop: Integration steps in one period of the drive's loops.
        supply_V: Supply voltage.
        temperature_C: Temperature that the drive reports at the start.
        warming_K: Final rise of the reported temperature.
        warming_s: Time constant of the rise of the reported temperature.
        effects: Injected effects, which the recorded bench file does not state: values of the
            parameters of each effect. [Catalogue](effects.md).
        effects_file: Python file, relative to the bench file, with a function `inject_NAME` for
            each further effect NAME of `effects`.
        plant: A machine of one's own in place of this one, from a file that is named relative to
            the bench file: `{python: FILE, class: NAME}` or `{fmu: FILE}`. Motor, gear, friction
            and load are then its own; the drive assumes what `machine` states.
    """

    motor: Motor = field(default_factory=Motor)
    joint: Joint = field(default_factory=Joint)
    loops: Loops = field(default_factory=Loops)
    sensing: Sensing = field(default_factory=Sensing)
    gas: GasGenerator = field(default_factory=GasGenerator)
    steps_per_loop: int = 2
    supply_V: float = 60.0
    temperature_C: float = 25.0
    warming_K: float = 0.0
    warming_s: float = 600.0
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects_file: str = ""
    plant: Mapping[str, str] = field(default_factory=dict)
