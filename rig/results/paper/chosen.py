"""Values that this project chose because the paper does not state them, read from the code that
sets them.
"""

from __future__ import annotations

import math

from drivers.mock.plant.parts.constants import GasGenerator
from rig.config.sequence import load_sequence
from rig.results.paper.machine import true_machine
from rig.results.paper.parameters import DURATION_S, RATE_HZ


def chosen() -> list[str]:
    """Return one line for each chosen value."""
    gas = GasGenerator()
    practical, soft, literal = (
        true_machine(name) for name in ("practical", "practical_soft", "literal")
    )
    ramp = load_sequence("slow_ramp").value.stages[0].ramp
    if ramp is None:
        raise ValueError("the packaged sequence 'slow_ramp' has no ramp")
    stiff = practical.loops
    share = math.sqrt(gas.energy_J_kg) / gas.characteristic_velocity_m_s
    return [
        "Gear ratio: with the printed motor constants friction would require 228 to 401 A; "
        "assumption 5, "
        "theta = i theta_r, is missing from eq. 1 and 15. The literal bench has i = 1 and no "
        "current limit, and is used for "
        f"the tables; the practical bench has i = {practical.motor.gear_ratio:g}, "
        f"{stiff.voltage_limit_V:g} V and "
        f"{stiff.current_limit_A:g} A.",
        f"Inertia of the practical bench: {practical.joint.inertia_kg_m2:g} kg m^2 at the joint, "
        f"in place of the printed {literal.joint.inertia_kg_m2:g} kg m^2.",
        f"Position loop: stiff gains {stiff.position_gain:g} 1/s, "
        f"{stiff.velocity_gain_N_m_s_rad:g} N m s/rad, "
        f"{stiff.velocity_integral_1_s:g} 1/s; soft gains, position P only, "
        f"{soft.loops.position_gain:g} N m/rad.",
        "omega_sf = 0.0557 rad/s as in the text, not the 0.0577 of Table 1; mu = 0.086 is read as "
        "mu_s, 0.4 pi r t as 0.4 pi t, and the amplitude 20 as 20 degrees.",
        "sgn(omega) in eq. 12, 13 and 15, without which friction would drive the joint; at rest "
        "friction balances the drive torque up "
        f"to the static limit. alpha = {practical.joint.alpha:g} in eq. 9 as in eq. 13.",
        f"Samples of the identification: {DURATION_S:g} s at {RATE_HZ:g} Hz in each case.",
        f"Ramp of Fig. 2 and 9: {ramp.travel_deg:g} deg at {ramp.speed_deg_s:g} deg/s and back.",
        f"Gas generator: C_r = {gas.characteristic_velocity_m_s:g} m/s; R_g T_g = ({share:.3f} "
        f"C_r)^2 = "
        f"{gas.energy_J_kg:.4g} J/kg; V_0 = {gas.free_volume_m3:g} m^3; p_c0 = "
        f"{1e-6 * gas.back_pressure_Pa:g} MPa; "
        "r = a p^n in mm/s with p in MPa.",
        "Valve: the plate swings in its own plane on L1 = 0.095 m, its hole over the opening's "
        "centre at 0 deg.",
        "Flow controller of Fig. 5 and 11: flow command to pressure command (eq. 2), PI on the "
        "logarithm of the "
        "pressure, anti-windup; its gains are in the sequence file.",
        "Compensation: the drive's torque offset (60B2h) from parameters identified from the same "
        "bench's log, with "
        "stiffness and damping against the command, and pulses where friction falls too steeply "
        "for stiffness and damping; the paper "
        "proposes no compensation.",
    ]
