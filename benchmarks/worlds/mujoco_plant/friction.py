"""Computes the values that are set before each step of MuJoCo: the level of dry friction, and the
torques of effects that MuJoCo does not have.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.worlds.mujoco_plant.model import two_bodies
from benchmarks.worlds.world import Array, World
from identification.numerics.compiled import compiled

F_REF_N = 3000.0
RESTING = 2e-5
"""Ratio of the joint speed to the speed scale below which a joint counts as resting, because a
joint held by MuJoCo's friction creeps.
"""
UNIT_SPEED = {"rotary": 1.0, "linear": 0.1}
"""Speed scale of each kind of machine: rad/s for rotary, m/s for linear."""
AGED_OFF = 3.0
"""Ratio of the joint speed to the Stribeck speed above which the time at rest is set to zero."""
(
    MC, MS, W_SF, ALPHA, ARM, MU_C, MU_S, W_SL, MU_2, SHARE,
    FORCE, SLOPE, SWING, SWING_HZ, SWING_S, PIVOT, PER_LOAD, HUNG, ZERO,
    SIDED, SIDED_VISCOUS, PATCH, PATCH_AT, PATCH_WIDE, MEMORY_S, DWELL, DWELL_S,
    DRIFT, DRIFT_S, THIN, THIN_S, VISCOUS, RIPPLE, RIPPLE_N, RIPPLE_AT,
    KNEE, RATIONAL, LAG_S, EFFICIENCY, TIMED, TIMED_HZ, TIMED_AT, SWITCHED, SWITCHED_S,
    BRISTLES, PER_A, GEAR, BEGAN, PULL, STEADY, UNIT, VALUES,
) = range(52)  # fmt: skip
LEVEL, REST_S, LAGGED, KEPT = range(4)


def values(world: World, k: int, began_s: float) -> Array:
    """Return the values of recording ``k``, which began at ``began_s`` of the session, in the order
    of the names at the top of this module.
    """
    given, constants, motor = world.effects, world.constants, world.motor
    out = np.zeros(VALUES)

    def take(effect: str, **places: int) -> None:
        for key, place in places.items():
            out[place] = given.get(effect, {}).get(key, 0.0)

    out[[MC, MS, W_SF, ALPHA]] = constants.Mc, constants.Ms, constants.omega_sf, 2.0
    out[[MU_C, MU_S, W_SL, MU_2]] = (
        constants.mu_c,
        constants.mu_s,
        constants.omega_sL,
        constants.mu_2,
    )
    out[ARM], out[VISCOUS], out[BEGAN] = world.moment_arm_m, constants.sigma_2, began_s
    out[SHARE] = motor.friction_share if two_bodies(world) else 0.0
    force = world.contact_N(k)
    power = given.get("load_exponent", {}).get("exponent", 1.0)
    out[FORCE] = F_REF_N * (force / F_REF_N) ** power if force > 0.0 else 0.0
    hung = world.recordings[k].pendulum
    if hung is not None:
        out[HUNG] = hung.mass_kg * world.gravity_m_s2 * hung.length_m
        out[ZERO] = hung.zero_rad
    out[PIVOT] = given.get("lever_pivot_friction", {}).get("torque_Nm", 0.0) * (force > 0.0)
    out[ALPHA] = given.get("stribeck_shape", {}).get("alpha", 2.0)
    take("load_position_dependence", slope_per_rad=SLOPE)
    take("load_swing", fraction=SWING, frequency_Hz=SWING_HZ, decay_s=SWING_S)
    take("load_dependent_friction", coefficient=PER_LOAD)
    take("asymmetric_coulomb", torque_Nm=SIDED)
    take("asymmetric_viscous", coefficient_Nms_rad=SIDED_VISCOUS)
    take("position_dependent_friction", torque_Nm=PATCH, center_rad=PATCH_AT, width_rad=PATCH_WIDE)
    take("friction_memory", time_s=MEMORY_S)
    take("dwell_static_friction", growth_Nm=DWELL, time_s=DWELL_S)
    take("coulomb_drift", rate_Nm_s=DRIFT, time_s=DRIFT_S)
    take("viscous_thermal_drift", fraction=THIN, time_s=THIN_S)
    take("torque_ripple", fraction=RIPPLE, per_motor_turn=RIPPLE_N, phase_rad=RIPPLE_AT)
    take("torque_saturation", knee_A=KNEE, rational=RATIONAL)
    take("current_loop_lag", time_s=LAG_S)
    take("x_timed_torque", torque_Nm=TIMED, frequency_Hz=TIMED_HZ, phase_rad=TIMED_AT)
    take("x_switching_torque", torque_Nm=SWITCHED, period_s=SWITCHED_S)
    out[EFFICIENCY] = given.get("transmission_efficiency", {}).get("efficiency", 1.0)
    out[BRISTLES] = float("presliding" in given)
    out[PER_A], out[GEAR] = motor.torque_per_A, motor.gear_ratio
    planned = world.recordings[k]
    out[PULL], out[STEADY] = planned.pull_N_m, planned.steady_N_m(world.gravity_m_s2)
    out[UNIT] = UNIT_SPEED[world.motion]
    return out


@compiled
def dry(f: Array, s: Array, t: float, q: float, w: float, push: float, dt: float) -> float:
    """Return the level of dry friction of the joint, N m; updates the states ``s``.

    Args:
        f: Values.
        s: States: level with memory, time at rest.
        t: Time of the session, s.
        q: Angle of the joint, rad.
        w: Speed of the joint, rad/s.
        push: Torque that drives the joint, N m; its sign is the direction of a joint at rest.
        dt: Time step, s.
    """
    since = t - f[BEGAN]
    resting = abs(w) < RESTING * (f[W_SF] + f[UNIT])
    if resting:
        s[REST_S] += dt
    elif abs(w) > AGED_OFF * f[W_SF]:
        s[REST_S] = 0.0
    aged = f[DWELL] * (1.0 - math.exp(-s[REST_S] / f[DWELL_S])) if f[DWELL] > 0.0 else 0.0
    own = f[MC] + (f[MS] + aged - f[MC]) * math.exp(-((abs(w) / f[W_SF]) ** f[ALPHA]))
    if f[BRISTLES] > 0.0:
        own = 0.0
    own *= 1.0 - f[SHARE]
    if f[DRIFT] != 0.0:
        own += f[DRIFT] * f[DRIFT_S] * (1.0 - math.exp(-t / f[DRIFT_S]))
    if f[PATCH] != 0.0:
        own += f[PATCH] * math.exp(-0.5 * ((q - f[PATCH_AT]) / f[PATCH_WIDE]) ** 2)
    force = f[FORCE] * (1.0 + f[SLOPE] * q)
    if f[SWING] != 0.0:
        force *= 1.0 + f[SWING] * math.cos(2.0 * math.pi * f[SWING_HZ] * since) * math.exp(
            -since / f[SWING_S]
        )
    load = f[MU_C] + (f[MU_S] - f[MU_C]) * math.exp(-((w / f[W_SL]) ** 2))
    own += f[ARM] * force * load
    if f[MEMORY_S] > 0.0:
        s[LEVEL] += (own - s[LEVEL]) * (1.0 - math.exp(-dt / f[MEMORY_S]))
        own = s[LEVEL]
    forward = push > 0.0 if resting else w > 0.0
    own += f[SIDED] if forward else -f[SIDED]
    own += f[PIVOT] + f[PER_LOAD] * abs(f[STEADY] - f[HUNG] * math.sin(q - f[ZERO]))
    return float(max(own, 0.0))


@compiled
def damping(f: Array, t: float, q: float) -> float:
    """Return the viscous friction of the joint, N m s/rad."""
    own = f[VISCOUS]
    if f[THIN] != 0.0:
        own *= 1.0 - f[THIN] * (1.0 - math.exp(-t / f[THIN_S]))
    return float(own * (1.0 - f[SHARE]) + f[ARM] * f[FORCE] * (1.0 + f[SLOPE] * q) * f[MU_2])


@compiled
def further(
    f: Array, s: Array, since: float, phi: float, w: float, current: float, dt: float
) -> float:
    """Return the torque on the motor's side that MuJoCo's motor does not model, N m at the joint.

    Args:
        f: Values.
        s: States: the current that makes torque.
        since: Time since the recording's start, s.
        phi: Angle of the motor's shaft, rad.
        w: Speed of the joint, rad/s.
        current: Current in the winding, A.
        dt: Time step, s.
    """
    plain = f[PER_A] * current
    working = current
    if f[LAG_S] > 0.0:
        s[LAGGED] += (current - s[LAGGED]) * (1.0 - math.exp(-dt / f[LAG_S]))
        working = s[LAGGED]
    if f[KNEE] > 0.0:
        x = working / f[KNEE]
        working = working / (1.0 + x * x) if f[RATIONAL] > 0.5 else f[KNEE] * math.tanh(x)
    torque = f[PER_A] * working
    if f[RIPPLE] != 0.0:
        torque *= 1.0 + f[RIPPLE] * math.sin(f[RIPPLE_N] * phi + f[RIPPLE_AT])
    if f[EFFICIENCY] < 1.0:
        torque = torque / f[EFFICIENCY] if torque * w < 0.0 else torque * f[EFFICIENCY]
    more = torque - plain - f[SIDED_VISCOUS] * abs(w)
    more += f[TIMED] * math.sin(2.0 * math.pi * f[TIMED_HZ] * since + f[TIMED_AT])
    if f[SWITCHED] != 0.0:
        more += f[SWITCHED] if (since / f[SWITCHED_S]) % 1.0 < 0.5 else -f[SWITCHED]
    return float(more)
