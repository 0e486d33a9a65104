"""Constants of the simulated machine, as frozen records in SI units.

Friction, inertia and load are stated at the joint (valve shaft), motor constants at the motor shaft; the gear ratio
joins them (assumption 5, theta = i theta_r).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Motor:
    """DC motor, eq. 1: R I + L dI/dt = U - Ke domega_m ; torque Km I.

    ``rotor_inertia_kg_m2``, at the motor, is part of the joint's total; it shows only where the transmission gives.
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

    ``inertia_kg_m2`` is the total seen at the joint, the motor's rotor included.
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
    """The drive's cascade: position P, velocity PI, current PI, all at ``rate_Hz``.

    With ``velocity_gain_N_m_s_rad`` None the drive is position P only: joint torque command = ``position_gain`` times
    the position error, ``position_gain`` in N m/rad instead of 1/s.
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
    """What the drive and the joint encoder can see.

    Zero counts or zero quantum mean an exact sensor. ``current_noise_A`` is the rms noise of the logged mean over one
    cycle of ``cycle_s``; each sample of the current loop carries it times the square root of the samples per cycle.
    """

    motor_counts_per_turn: int = 4096
    joint_counts_per_turn: int = 262144
    current_noise_A: float = 0.020
    cycle_s: float = 0.001


@dataclass(frozen=True)
class Valve:
    """The gate of Fig. 3: a plate with a hole, swinging in its own plane on radius L1 over an opening."""

    hole_diameter_m: float = 0.025
    opening_diameter_m: float = 0.040
    plate_width_m: float = 0.054


@dataclass(frozen=True)
class Transmitter:
    """The pressure transmitter on the chamber: rms noise of one sample, and the pressure it measures up to; chosen."""

    noise_Pa: float = 1500.0
    range_Pa: float = 10e6


@dataclass(frozen=True)
class GasGenerator:
    """Gas generator, eq. 2 to 8: end burning at r = a p^n, choked outflow p A_t / C_r, ideal gas at one temperature.

    The paper gives the first five values; the others are chosen. With these the minimum throat settles at 4.4 MPa, the
    full one at 0.6 MPa, and the contact force of the closed valve is 3.0 kN, that of Case 2.
    ``burning_rate_mm_s`` is a, in mm/s at 1 MPa. ``energy_J_kg`` is R_g T_g, (0.658 C_r)^2 at a specific-heat ratio of
    1.25. ``equation`` is 7 (exact, conserves mass) or 8 (gas density neglected beside the propellant's). Pressure
    and contact force are renewed every ``loops_per_step`` periods of the drive's loops.
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
    """Everything that defines one simulated bench. ``steps_per_loop`` integration steps make one drive-loop period.

    The temperature that the drive reports is ``temperature_C`` at the start and ``warming_K`` above in the end, first
    order in ``warming_s``. ``effects`` is the physics that it hides, effect -> parameter -> value
    (:mod:`drivers.mock.plant.effects.table`).
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
