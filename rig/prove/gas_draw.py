"""One blind gas rig drawn at random: true constants, noise, and what it hides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drivers.mock.plant.constants import Machine
from rig.prove.draw import Assigned, Kind, apportion, in_turn
from rig.prove.gas_excitation import gas_experiments
from rig.prove.sizes import Draw, either, log

GAS_SHARES: Mapping[Kind, float] = {"one": 50.0, "nothing": 40.0, "outside": 10.0}
RATE_SPREAD, EXPONENT_SPREAD, VELOCITY_SPREAD, VOLUME_SPREAD = 0.15, 0.03, 0.05, 0.2
"""Constants lie within this share of what the campaign says of them; the exponent within this difference."""
GRAIN_SPREAD = 0.03
"""Free volumes of one rig's burns differ by this share: grains are not of one length."""
NOISE_SHARES = (0.001, 0.0025)
"""Noise of the transmitter over its range."""

GAS_SIZES: Mapping[str, Mapping[str, Draw]] = {
    "throat_deposition": {"rate_m_s": log(5e-7, 2e-5)},
    "burning_area_change": {"taper_per_m": either(0.005, 0.3)},
    "erosive_burning": {"coefficient_s_m": log(0.003, 0.06)},
    "heat_loss": {"heat_flow_W": log(1e4, 3e5), "time_s": log(2.0, 15.0)},
    "leakage": {"area_m2": log(2e-6, 4e-5)},
}
"""Effect of the catalogue -> parameter -> its draw."""

GAS_OUTSIDE_SIZES: Mapping[str, Mapping[str, Draw]] = {
    "x_propellant_bands": {"share": log(0.003, 0.05), "length_m": log(0.01, 0.1)},
    "x_burning_wave": {"share": log(0.003, 0.05), "frequency_Hz": log(0.1, 5.0)},
    "x_throat_wear": {"rate_m_s": log(5e-7, 2e-5)},
    "x_slag_puffs": {"share": log(0.01, 0.1), "period_s": log(0.5, 4.0), "length_s": log(0.05, 0.4)},
}
"""The same for effects that are in no catalogue."""


class GasRig(NamedTuple):
    """One rig as drawn: its kind, the simulated machine, the free volume of each burn (m^3), the seed of its noise."""

    kind: Kind
    machine: Machine
    volumes_m3: tuple[float, ...]
    seed: int


def gas_assignment(rigs: int, seed: int) -> list[Assigned]:
    """Return kind and effect of each rig, in an order that tells nothing; effects go round."""
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs, GAS_SHARES)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in in_turn(list(GAS_SIZES), counts["one"], rng)]
    drawn += [("outside", (name,)) for name in in_turn(list(GAS_OUTSIDE_SIZES), counts["outside"], rng)]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def draw_gas(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> GasRig:
    """Draw one rig.

    Args:
        kind: Its kind.
        names: Effects to hide.
        seed: Entropy; the same gives the same rig.
    """
    rng = np.random.default_rng(list(seed))
    base = Machine()
    g = base.gas

    def around(value: float, spread: float) -> float:
        return float(value * rng.uniform(1.0 - spread, 1.0 + spread))

    velocity = around(g.characteristic_velocity_m_s, VELOCITY_SPREAD)
    volume = around(g.free_volume_m3, VOLUME_SPREAD)
    gas = replace(
        g,
        burning_rate_mm_s=around(g.burning_rate_mm_s, RATE_SPREAD),
        pressure_exponent=float(g.pressure_exponent + rng.uniform(-EXPONENT_SPREAD, EXPONENT_SPREAD)),
        characteristic_velocity_m_s=velocity,
        energy_J_kg=g.energy_J_kg * (velocity / g.characteristic_velocity_m_s) ** 2,
        free_volume_m3=volume,
    )
    sensor = replace(g.transmitter, noise_Pa=g.transmitter.range_Pa * float(rng.uniform(*NOISE_SHARES)))
    sizes = {**GAS_SIZES, **GAS_OUTSIDE_SIZES}
    effects = {name: {key: size(rng) for key, size in sizes[name].items()} for name in names}
    machine = replace(base, gas=replace(gas, transmitter=sensor), effects=effects)
    volumes = tuple(around(volume, GRAIN_SPREAD) for _ in gas_experiments())
    return GasRig(kind, machine, volumes, int(rng.integers(1 << 62)))
