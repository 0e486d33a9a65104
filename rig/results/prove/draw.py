"""Draws one blind trial: true constants, noise and injected effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from rig.results.prove.excitation import experiments
from rig.results.prove.sizes import OUTSIDE_SIZES, SIZES

Kind = Literal["nothing", "one", "two", "outside", "unscored"]
SPREAD = 0.4
"""Greatest relative deviation of the nominal constants from those of the practical bench."""
NOISE_SPREAD = (0.5, 1.5)
SHARES: Mapping[Kind, float] = {"one": 300.0, "nothing": 200.0, "two": 60.0, "outside": 40.0}
"""Number of trials of each kind in a full proof; proofs of other sizes have the same
proportions.
"""

_NEEDS_GRAVITY = frozenset({"load_dependent_friction"})
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
Assigned = tuple[Kind, tuple[str, ...]]
"""Kind of a trial and the names of its effects."""


class Rig(NamedTuple):
    """Drawn data of one trial.

    Attributes:
        kind: Number of effects, and whether the catalogue has them.
        machine: The simulated machine with the effects.
        pauses_s: Time without power before each recording.
        seed: Seed of the noise.
        gravity: Whether the load is a weight fixed to the joint, without a lever.
    """

    kind: Kind
    machine: Machine
    pauses_s: tuple[float, ...]
    seed: int
    gravity: bool = False


def assignment(rigs: int, seed: int) -> list[Assigned]:
    """Return kind and effect names of each trial, in random order.

    For trials with one effect, all effects of the catalogue are taken in turn, and likewise all
    effects outside the catalogue; pairs are drawn at random.
    """
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs)
    singles = in_turn(list(SIZES), counts["one"], rng)
    strangers = in_turn(list(OUTSIDE_SIZES), counts["outside"], rng)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in singles]
    drawn += [("outside", (name,)) for name in strangers]
    names = list(SIZES)
    for _ in range(counts["two"]):
        drawn.append(("two", _pair(names, rng)))
    return [drawn[k] for k in rng.permutation(len(drawn))]


def _pair(names: list[str], rng: np.random.Generator) -> tuple[str, str]:
    """Return two effects that one bench can have."""
    while True:
        first, second = (names[k] for k in rng.choice(len(names), 2, replace=False))
        if not ({first, second} & _NEEDS_GRAVITY and {first, second} & _NEEDS_LEVER):
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
    """Return ``count`` names; each name occurs once before any name occurs again, in random order,
    so that the counts of the names differ by at most one.
    """
    order: list[str] = []
    while len(order) < count:
        order += [names[k] for k in rng.permutation(len(names))]
    return order[:count]


def draw(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> Rig:
    """Draw one trial.

    Args:
        kind: Kind of the trial.
        names: Effects to inject.
        seed: Entropy of the draws; equal entropy results in equal trials.
    """
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
    gravity = bool(_NEEDS_GRAVITY & set(names)) or (
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
