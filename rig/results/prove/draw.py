"""Draws one blind trial: true constants, noise and injected effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from rig.results.prove.excitation import experiments

Draw = Callable[[np.random.Generator], float]


def log(low: float, high: float) -> Draw:
    """Draw log-uniformly."""
    return lambda rng: float(math.exp(rng.uniform(math.log(low), math.log(high))))


def either(low: float, high: float) -> Draw:
    """Draw log-uniformly with a random sign."""
    return lambda rng: log(low, high)(rng) * float(rng.choice((-1.0, 1.0)))


def even(low: float, high: float) -> Draw:
    """Draw uniformly."""
    return lambda rng: float(rng.uniform(low, high))


def one_of(*values: float) -> Draw:
    """Draw one of these values."""
    return lambda rng: float(rng.choice(values))


def away_from(center: float, low: float, high: float) -> Draw:
    """Draw ``center`` plus or minus a log-uniform value."""
    return lambda rng: center + either(low, high)(rng)


_PHASE = even(-math.pi, math.pi)
_ORDER = one_of(1.0, 2.0, 4.0, 6.0, 7.0, 12.0)

SIZES: Mapping[str, Mapping[str, Draw]] = {
    "cogging": {"torque_Nm": log(0.1, 3.0), "per_motor_turn": _ORDER, "phase_rad": _PHASE},
    "torque_ripple": {"fraction": log(0.01, 0.15), "per_motor_turn": _ORDER, "phase_rad": _PHASE},
    "torque_saturation": {"knee_A": log(16.0, 60.0)},
    "current_loop_lag": {"time_s": log(2e-4, 3e-3)},
    "inverter_dead_time": {"voltage_V": log(0.1, 2.0)},
    "brush_drop": {"voltage_V": log(0.1, 2.0), "current_A": log(0.3, 2.0)},
    "winding_heating": {"rise_K_per_W": log(0.03, 0.5), "time_s": log(60.0, 600.0)},
    "supply_sag": {"resistance_ohm": log(0.03, 0.8)},
    "stray_loss": {"coefficient_Nms_A2rad": log(3e-3, 5e-2)},
    "backlash": {"gap_rad": log(1e-4, 1.5e-2)},
    "compliance": {"stiffness_Nm_rad": log(1.5e3, 1.5e5)},
    "gear_mesh_ripple": {
        "amplitude_rad": log(3e-5, 2e-3),
        "per_turn": one_of(8.0, 20.0, 33.0, 50.0),
        "phase_rad": _PHASE,
    },
    "transmission_efficiency": {"efficiency": lambda rng: 1.0 - log(0.02, 0.3)(rng)},
    "gear_friction": {
        "travel_rad": log(2e-3, 3e-2),
        "against_motion": log(0.05, 0.3),
        "against_torque": log(0.01, 0.1),
    },
    "coupling_hysteresis": {"torque_Nm": log(1.0, 8.0), "deflection_rad": log(1e-4, 5e-3)},
    "asymmetric_coulomb": {"torque_Nm": either(0.05, 2.5)},
    "asymmetric_viscous": {"coefficient_Nms_rad": either(0.1, 2.5)},
    "quadratic_drag": {"coefficient_Nms2_rad2": log(0.1, 6.0)},
    "stribeck_shape": {
        "alpha": lambda rng: float(2.0 * math.exp(rng.choice((-1, 1)) * rng.uniform(0.1, 0.9)))
    },
    "friction_memory": {"time_s": log(1e-3, 5e-2)},
    "dwell_static_friction": {"growth_Nm": log(0.3, 8.0), "time_s": log(0.3, 5.0)},
    "presliding": {"stiffness_Nm_rad": log(2e3, 1e5)},
    "position_dependent_friction": {
        "torque_Nm": log(0.1, 4.0),
        "center_rad": even(-0.3, 0.3),
        "width_rad": log(0.03, 0.15),
    },
    "viscous_thermal_drift": {"fraction": log(0.05, 0.7), "time_s": log(100.0, 800.0)},
    "coulomb_drift": {"rate_Nm_s": either(1e-4, 3e-3)},
    "gravity_imbalance": {"torque_Nm": log(0.1, 8.0), "zero_rad": _PHASE},
    "return_spring": {"stiffness_Nm_rad": log(0.3, 20.0), "rest_rad": even(-0.3, 0.3)},
    "constant_torque": {"torque_Nm": either(0.05, 15.0)},
    "end_stop": {
        "angle_rad": lambda rng: float(rng.choice((-1.0, 1.0)) * rng.uniform(0.3, 0.46)),
        "stiffness_Nm_rad": log(5.0, 250.0),
    },
    "load_exponent": {"exponent": away_from(1.0, 0.04, 0.4)},
    "load_position_dependence": {"slope_per_rad": either(0.03, 0.8)},
    "wrong_weight": {"mass_kg": log(0.02, 0.4), "recording": one_of(4.0, 5.0, 10.0)},
    "load_swing": {
        "fraction": log(0.03, 0.5),
        "frequency_Hz": log(0.4, 2.0),
        "decay_s": log(4.0, 25.0),
    },
    "load_inertia": {"inertia_kgm2": log(0.02, 0.6)},
    "lever_pivot_friction": {"torque_Nm": log(0.1, 4.0)},
    "load_dependent_friction": {"coefficient": log(0.01, 0.2)},
    "time_skew": {"time_s": log(3e-4, 2e-2)},
    "transport_delay": {"time_s": log(2e-4, 2e-2)},
    "current_offset": {"current_A": either(0.02, 0.8)},
    "current_drift": {"rate_A_s": either(1e-3, 3e-2)},
    "encoder_eccentricity": {"amplitude_rad": log(1e-4, 1e-2), "phase_rad": _PHASE},
    "encoder_slip": {
        "angle_rad": either(1e-4, 1e-2),
        "at_s": even(4.0, 26.0),
        "recording": one_of(1.0, 2.0, 4.0, 5.0, 7.0, 10.0),
    },
}
"""Draws of catalogue effects' parameters; ``wrong_weight.mass_kg`` is a relative error."""

OUTSIDE_SIZES: Mapping[str, Mapping[str, Draw]] = {
    "x_timed_torque": {
        "torque_Nm": log(0.2, 3.0),
        "frequency_Hz": log(0.2, 15.0),
        "phase_rad": _PHASE,
    },
    "x_acceleration_drag": {"coefficient_Nms2_rad": log(0.015, 0.1)},
    "x_quadrant_friction": {"torque_Nm": either(0.2, 3.0)},
    "x_two_wells": {
        "torque_Nm": log(0.3, 4.0),
        "center_rad": even(0.1, 0.3),
        "width_rad": log(0.02, 0.1),
    },
    "x_travel_memory": {"torque_Nm": log(0.3, 3.0), "travel_rad": log(0.1, 1.0)},
    "x_root_drag": {"coefficient_Nms05_rad05": log(0.3, 5.0)},
    "x_bursts": {"torque_Nm": log(0.3, 3.0), "period_s": log(0.5, 4.0), "length_s": log(0.05, 0.4)},
    "x_speed_resonance": {
        "torque_Nm": log(0.3, 4.0),
        "speed_rad_s": log(0.08, 0.6),
        "width_rad_s": log(0.02, 0.06),
    },
    "x_one_way_patch": {
        "torque_Nm": log(0.3, 4.0),
        "center_rad": even(-0.25, 0.25),
        "width_rad": log(0.03, 0.12),
    },
    "x_switching_torque": {"torque_Nm": log(0.2, 3.0), "period_s": log(0.7, 6.0)},
    "x_wandering_torque": {"torque_Nm": log(0.3, 3.0), "period_s": log(0.5, 6.0)},
    "x_loaded_drag": {"coefficient_s2_rad2": log(0.01, 0.2)},
}
"""Functions that draw the parameters of effects outside the catalogue, by effect and parameter."""


Kind = Literal["nothing", "one", "two", "outside", "unscored"]
SPREAD = 0.4
"""Greatest relative deviation of the nominal constants from those of the practical bench."""
NOISE_SPREAD = (0.5, 1.5)
SHARES: Mapping[Kind, float] = {"one": 300.0, "nothing": 200.0, "two": 60.0, "outside": 40.0}
"""Trials of each kind in a full proof; others have the same proportions."""

NEEDS_GRAVITY = frozenset({"load_dependent_friction", "gear_friction"})
_NEEDS_LEVER = frozenset(
    {
        "load_exponent",
        "load_position_dependence",
        "wrong_weight",
        "load_swing",
        "load_inertia",
        "lever_pivot_friction",
        "x_loaded_drag",
    }
)
_GRAVITY_SHARE = 0.1
"""Share of trials with a weight on the joint among the trials whose effects permit a weight on the
joint or on the lever, so that the kind of load gives no information on the effects.
"""

Effects = dict[str, dict[str, float]]
Assigned = tuple[Kind, tuple[str, ...]]  # kind of a trial and the names of its effects


class Rig(NamedTuple):
    """Drawn data of one trial."""

    kind: Kind  # number of effects, and whether the catalogue has them
    machine: Machine
    pauses_s: tuple[float, ...]  # time without power before each recording
    seed: int  # seed of the noise
    gravity: bool = False  # whether the load is a weight fixed to the joint, without a lever


def assignment(
    rigs: int,
    seed: int,
    shares: Mapping[Kind, float] = SHARES,
    single: Sequence[str] = tuple(SIZES),
) -> list[Assigned]:
    """Return kind and effect names of each trial, in random order.

    For trials with one effect, the effects ``single`` are taken in turn, and likewise all effects
    outside the catalogue; pairs are drawn at random.
    """
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs, shares)
    singles = in_turn(list(single), counts["one"], rng)
    strangers = in_turn(list(OUTSIDE_SIZES), counts["outside"], rng)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in singles]
    drawn += [("outside", (name,)) for name in strangers]
    names = list(SIZES)
    for _ in range(counts.get("two", 0)):
        drawn.append(("two", _pair(names, rng)))
    return [drawn[k] for k in rng.permutation(len(drawn))]


def _pair(names: list[str], rng: np.random.Generator) -> tuple[str, str]:
    """Return two effects that one bench can have."""
    while True:
        first, second = (names[k] for k in rng.choice(len(names), 2, replace=False))
        if not ({first, second} & NEEDS_GRAVITY and {first, second} & _NEEDS_LEVER):
            return first, second


def apportion(rigs: int, shares: Mapping[Kind, float] = SHARES) -> dict[Kind, int]:
    """Return the number of trials of each kind (method of largest remainders)."""
    total = sum(shares.values())
    exact = {kind: rigs * share / total for kind, share in shares.items()}
    counts = {kind: math.floor(value) for kind, value in exact.items()}
    left = sorted(exact, key=lambda kind: counts[kind] - exact[kind])
    for kind in left[: rigs - sum(counts.values())]:
        counts[kind] += 1
    return counts


def in_turn(names: list[str], count: int, rng: np.random.Generator) -> list[str]:
    """Return ``count`` names in random order, each once before any occurs again."""
    order: list[str] = []
    while len(order) < count:
        order += [names[k] for k in rng.permutation(len(names))]
    return order[:count]


def draw(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> Rig:
    """Draw one trial."""
    rng = np.random.default_rng(list(seed))
    machine = _nominal(rng)
    effects: Effects = {}
    for name in names:
        sizes = SIZES.get(name) or OUTSIDE_SIZES[name]
        effects[name] = {key: size(rng) for key, size in sizes.items()}
    if "wrong_weight" in effects:
        wrong = effects["wrong_weight"]
        label = experiments()[int(wrong["recording"]) - 1].weight_kg
        wrong["mass_kg"] = label * (1.0 + wrong["mass_kg"] * float(rng.choice((-1.0, 1.0))))
    warming_s = float(rng.uniform(100.0, 800.0))
    if "viscous_thermal_drift" in effects:
        warming_s = effects["viscous_thermal_drift"]["time_s"]
    machine = replace(
        machine,
        temperature_C=float(rng.uniform(18.0, 28.0)),
        warming_K=float(rng.uniform(5.0, 20.0)),
        warming_s=warming_s,
        effects=effects,
    )
    pauses = tuple(float(value) for value in rng.uniform(15.0, 90.0, len(experiments())))
    seed_of_noise = int(rng.integers(1 << 62))
    gravity = bool(NEEDS_GRAVITY & set(names)) or (
        not _NEEDS_LEVER & set(names) and float(rng.uniform()) < _GRAVITY_SHARE
    )
    return Rig(kind, machine, pauses, seed_of_noise, gravity)


def _nominal(rng: np.random.Generator) -> Machine:
    """Draw the nominal constants and the noise of the practical bench."""
    base = Machine()
    joint, sensing = base.joint, base.sensing

    def around(value: float) -> float:
        return float(value * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))

    coulomb, load = around(joint.Mc_N_m), around(joint.mu_c)
    inertia = around(joint.inertia_kg_m2)
    rotor = inertia * float(rng.uniform(0.3, 0.6)) / base.motor.gear_ratio**2
    return replace(
        base,
        motor=replace(base.motor, rotor_inertia_kg_m2=rotor),
        joint=replace(
            joint,
            inertia_kg_m2=inertia,
            Mc_N_m=coulomb,
            Ms_N_m=coulomb + around(joint.Ms_N_m - joint.Mc_N_m),
            omega_sf_rad_s=around(joint.omega_sf_rad_s),
            sigma_2_N_m_s_rad=around(joint.sigma_2_N_m_s_rad),
            mu_c=load,
            mu_s=load + around(joint.mu_s - joint.mu_c),
            omega_sL_rad_s=around(joint.omega_sL_rad_s),
            mu_2_s_rad=around(joint.mu_2_s_rad),
        ),
        sensing=replace(
            sensing, current_noise_A=sensing.current_noise_A * float(rng.uniform(*NOISE_SPREAD))
        ),
    )
