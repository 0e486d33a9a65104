"""The third plant: worlds simulated by the differential equations of
:mod:`benchmarks.worlds.third.physics`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from benchmarks.worlds.sizes import SIZES
from benchmarks.worlds.third import kernel as drive
from benchmarks.worlds.third import physics as at
from benchmarks.worlds.third.kernel import play
from benchmarks.worlds.world import COMMAND_S, Signals, World

INNER_S = 6e-5
"""Longest step of the integration."""
F_REF_N = 3000.0
SPRINGY_HZ = 250.0
"""Natural frequency of teeth in contact, where the gear has play."""


class OdePlant:
    """The third plant; see :class:`benchmarks.worlds.seal.Plant`."""

    effects: Collection[str] = frozenset(n for n in SIZES if not n.startswith("x_"))
    outside: Collection[str] = frozenset(
        {"x_timed_torque", "x_switching_torque", "x_bursts", "x_acceleration_drag"}
    )
    not_scored: Collection[str] = frozenset(
        {
            "winding_heating.rise_K_per_W",
            "coupling_hysteresis.torque_Nm",
            "coupling_hysteresis.deflection_rad",
        }
    )

    def play(self, world: World) -> Iterator[Signals]:
        """Yield what the machine does in each recording."""
        session_s, warm = 0.0, 0.0
        rate = world.drive.rate_Hz
        for k, planned in enumerate(world.recordings):
            session_s = session_s + planned.pause_s if world.log.clock else 0.0
            cooling = _of(world, "winding_heating", "time_s", 1.0)
            y = initial_state(world, k)
            y[at.TEMPERATURE] = warm * math.exp(-planned.pause_s / cooling) if session_s else 0.0
            n = round(len(planned.command) * COMMAND_S * rate)
            command, push = planned.sent(np.arange(n) / rate)
            settings, mesh, out = _drive(world), _mesh(world), np.zeros((6, n))
            settings[drive.BEGIN] = -planned.steady_N_m(world.gravity_m_s2)
            noise = np.random.default_rng([*world.seed, 5, k]).standard_normal((2, n))
            noise[0] *= world.sensing.current_noise_A
            noise[1] *= world.sensing.flicker * settings[drive.COUNT]
            inner = math.ceil(1.0 / (rate * INNER_S))
            values = values_of(world, k, session_s)
            sent = np.vstack((command, push, world.host_sends(k, n)))
            play(values, settings, y, inner, sent, noise, mesh, out)
            warm = y[at.TEMPERATURE]
            first = round(planned.lead_s * rate)
            yield Signals(*out[:, first:], command[first:], session_s + planned.lead_s)
            session_s += len(planned.command) * COMMAND_S


def _of(world: World, effect: str, key: str, default: float = 0.0) -> float:
    return world.effects.get(effect, {}).get(key, default)


def _mesh(world: World) -> np.ndarray:
    keys = ("amplitude_rad", "per_turn", "phase_rad")
    return np.array([_of(world, "gear_mesh_ripple", key) for key in keys])


def _drive(world: World) -> np.ndarray:
    """Return the settings of the drive: a cascade, or a soft loop that reaches the static friction
    with a third of the smallest motion at a gain of 1 Hz.
    """
    given, motor, J = world.drive, world.motor, world.constants.J
    d = np.zeros(drive.SETTINGS)
    wide = 2.0 * math.pi * given.velocity_Hz
    if given.kind == "cascade":
        d[drive.K_P], d[drive.K_V] = 2.0 * math.pi * given.position_Hz, J * wide
        d[drive.K_I] = J * wide**2 / 4.0
    elif given.kind in ("torque", "host"):
        d[drive.K_P], d[drive.K_V] = world.host_law
        d[drive.HOST] = 1.0
        wide = 2.0 * math.pi * given.velocity_Hz
    else:
        d[drive.K_P] = 3.0 * given.position_Hz * world.holding_N_m / world.smallest_rad
        d[drive.K_V] = 1.4 * math.sqrt(d[drive.K_P] * J)
        wide = math.sqrt(d[drive.K_P] / J)
    d[drive.TICK], d[drive.CASCADE] = 1.0 / given.rate_Hz, float(given.kind == "cascade")
    d[drive.AHEAD] = given.feedforward
    d[drive.WINDOW] = max(round(0.25 / wide * given.rate_Hz), 1)
    d[drive.BEAT] = max(given.rate_Hz / (2.0 * math.pi * given.current_Hz), 2.0)
    d[drive.PER_A], d[drive.MOST_A] = motor.torque_per_A, motor.limit_A
    d[drive.MOST_V] = motor.supply_V
    d[drive.R_KNOWN], d[drive.L_KNOWN] = motor.resistance_ohm, motor.inductance_H
    d[drive.K_KNOWN] = motor.constant
    d[drive.AT_MOTOR] = float(world.sensing.motor_bits is not None)
    d[drive.COUNT] = world.loop_count_rad
    return d


def initial_state(world: World, k: int) -> np.ndarray:
    """Return the state at rest at zero, with the current that holds the steady load of recording
    ``k``.
    """
    y = np.zeros(at.STATE)
    steady = world.recordings[k].steady_N_m(world.gravity_m_s2)
    y[at.CURRENT] = -steady / world.motor.torque_per_A
    return y


def values_of(world: World, k: int, session_s: float) -> np.ndarray:
    """Return the values of recording ``k``, which begins at ``session_s`` of the session."""
    p = np.zeros(at.SIZE)
    c, motor, planned = world.constants, world.motor, world.recordings[k]
    p[at.J_M], p[at.J_L] = motor.rotor_share * c.J, (1.0 - motor.rotor_share) * c.J
    p[at.J_L] += _of(world, "load_inertia", "inertia_kgm2") * planned.weight_kg / 30.6
    p[at.COULOMB], p[at.STATIC], p[at.W_S], p[at.VISCOUS] = c.Mc, c.Ms, c.omega_sf, c.sigma_2
    p[at.LEVER], p[at.MU_C], p[at.MU_S], p[at.W_L] = world.moment_arm_m, c.mu_c, c.mu_s, c.omega_sL
    p[at.MU_V], p[at.BEGAN] = c.mu_2, session_s
    force = world.contact_N(k)
    if force > 0.0:
        power = _of(world, "load_exponent", "exponent", 1.0)
        p[at.FORCE] = F_REF_N * (force / F_REF_N) ** power
        p[at.PIVOT] = _of(world, "lever_pivot_friction", "torque_Nm")
    if planned.pendulum is not None:
        hung = planned.pendulum
        p[at.HUNG] = hung.mass_kg * world.gravity_m_s2 * hung.length_m
        p[at.HANGS] = hung.zero_rad
        p[at.J_L] += hung.mass_kg * hung.length_m**2
    p[at.STEADY] = planned.steady_N_m(world.gravity_m_s2)
    p[at.J_L] += planned.hoisted_kg
    p[at.K_T] = p[at.K_E] = motor.constant
    p[at.GEAR], p[at.R], p[at.L] = motor.gear_ratio, motor.resistance_ohm, motor.inductance_H
    p[at.SUPPLY], p[at.BRUSH_A] = motor.supply_V, 1.0
    p[at.ETA] = _of(world, "transmission_efficiency", "efficiency", 1.0)
    p[at.EXPONENT] = _of(world, "stribeck_shape", "alpha", 2.0)
    for (effect, key), place in PLACES.items():
        if key in world.effects.get(effect, {}):
            p[place] = world.effects[effect][key]
    _couple(world, p)
    if "end_stop" in world.effects:
        end = _of(world, "end_stop", "angle_rad")
        other = _of(world, "end_stop", "other_rad", -math.copysign(1e3, end))
        p[at.STOP_HIGH], p[at.STOP_LOW] = max(end, other), min(end, other)
    return p


def _couple(world: World, p: np.ndarray) -> None:
    """Set what lies between motor and joint."""
    between = {"backlash", "compliance", "coupling_hysteresis"} & world.effects.keys()
    if not between:
        return
    p[at.SHARE] = world.motor.friction_share
    reduced = p[at.J_M] * p[at.J_L] / (p[at.J_M] + p[at.J_L])
    if p[at.GAP] > 0.0:
        p[at.STIFF] = reduced * (2.0 * math.pi * SPRINGY_HZ) ** 2
    stiffness = p[at.STIFF] if p[at.STIFF] > 0.0 else p[at.LOSSY] / p[at.LOSSY_RAD]
    ratio = 0.3 if p[at.GAP] > 0.0 else 0.03
    p[at.DAMP] = 2.0 * ratio * math.sqrt(stiffness * reduced)


PLACES = {
    ("cogging", "torque_Nm"): at.COG,
    ("cogging", "per_motor_turn"): at.COG_N,
    ("cogging", "phase_rad"): at.COG_P,
    ("torque_ripple", "fraction"): at.RIP,
    ("torque_ripple", "per_motor_turn"): at.RIP_N,
    ("torque_ripple", "phase_rad"): at.RIP_P,
    ("torque_saturation", "knee_A"): at.KNEE,
    ("torque_saturation", "rational"): at.RATIONAL,
    ("current_loop_lag", "time_s"): at.TORQUE_LAG,
    ("inverter_dead_time", "voltage_V"): at.DEAD,
    ("brush_drop", "voltage_V"): at.BRUSH,
    ("brush_drop", "current_A"): at.BRUSH_A,
    ("winding_heating", "rise_K_per_W"): at.HEAT,
    ("winding_heating", "time_s"): at.HEAT_S,
    ("supply_sag", "resistance_ohm"): at.SAG,
    ("stray_loss", "coefficient_Nms_A2rad"): at.EDDIES,
    ("backlash", "gap_rad"): at.GAP,
    ("compliance", "stiffness_Nm_rad"): at.STIFF,
    ("coupling_hysteresis", "torque_Nm"): at.LOSSY,
    ("coupling_hysteresis", "deflection_rad"): at.LOSSY_RAD,
    ("asymmetric_coulomb", "torque_Nm"): at.SIDE,
    ("asymmetric_viscous", "coefficient_Nms_rad"): at.SIDE_V,
    ("quadratic_drag", "coefficient_Nms2_rad2"): at.DRAG,
    ("friction_memory", "time_s"): at.LAGS,
    ("dwell_static_friction", "growth_Nm"): at.AGES,
    ("dwell_static_friction", "time_s"): at.AGES_S,
    ("presliding", "stiffness_Nm_rad"): at.DAHL,
    ("position_dependent_friction", "torque_Nm"): at.PATCH,
    ("position_dependent_friction", "center_rad"): at.PATCH_C,
    ("position_dependent_friction", "width_rad"): at.PATCH_W,
    ("viscous_thermal_drift", "fraction"): at.THIN,
    ("viscous_thermal_drift", "time_s"): at.THIN_S,
    ("coulomb_drift", "rate_Nm_s"): at.DRIFT,
    ("coulomb_drift", "time_s"): at.DRIFT_S,
    ("gravity_imbalance", "torque_Nm"): at.LOPSIDED,
    ("gravity_imbalance", "zero_rad"): at.LOPSIDED_P,
    ("return_spring", "stiffness_Nm_rad"): at.SPRING,
    ("return_spring", "rest_rad"): at.SPRING_0,
    ("constant_torque", "torque_Nm"): at.PULL,
    ("end_stop", "stiffness_Nm_rad"): at.STOP_K,
    ("load_position_dependence", "slope_per_rad"): at.SLOPE,
    ("load_swing", "fraction"): at.SWING,
    ("load_swing", "frequency_Hz"): at.SWING_F,
    ("load_swing", "decay_s"): at.SWING_D,
    ("load_dependent_friction", "coefficient"): at.PER_LOAD,
    ("x_timed_torque", "torque_Nm"): at.TIMED,
    ("x_timed_torque", "frequency_Hz"): at.TIMED_F,
    ("x_timed_torque", "phase_rad"): at.TIMED_P,
    ("x_switching_torque", "torque_Nm"): at.FLIP,
    ("x_switching_torque", "period_s"): at.FLIP_S,
    ("x_bursts", "torque_Nm"): at.BURST,
    ("x_bursts", "period_s"): at.BURST_T,
    ("x_bursts", "length_s"): at.BURST_L,
    ("x_acceleration_drag", "coefficient_Nms2_rad"): at.ACC,
}
"""Effect and parameter to their place among the values."""
