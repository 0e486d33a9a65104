"""Draws one blind gas trial: true constants, noise and injected effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from rig.results.prove.draw import Assigned, Kind, apportion, in_turn
from rig.results.prove.gas_excitation import gas_experiments
from rig.results.prove.sizes import Draw, either, log

GAS_SHARES: Mapping[Kind, float] = {"one": 50.0, "nothing": 40.0, "outside": 10.0}
RATE_SPREAD, EXPONENT_SPREAD, VELOCITY_SPREAD, VOLUME_SPREAD = 0.15, 0.03, 0.05, 0.2
"""Deviation of the true constants from the values in the campaign file: relative, but absolute for
the exponent of the burning law.
"""
GRAIN_SPREAD = 0.03
"""Relative scatter of the free volumes within a trial, which comes from different grain lengths."""
NOISE_SHARES = (0.001, 0.0025)
"""Noise of the transmitter as a share of its range."""
ZERO_SHARE = 0.0003
"""Largest zero error of the transmitter after taring, as a share of its range."""
SIZE_SPREAD_M, ANGLE_SPREAD_RAD, MOST_LATE_CYCLES = 3e-5, float(np.deg2rad(0.05)), 2
"""Largest errors of valve dimensions and encoder zero, and largest sampling delay of the
pressure.
"""

GAS_SIZES: Mapping[str, Mapping[str, Draw]] = {
    "throat_deposition": {"rate_m_s": log(5e-7, 2e-5)},
    "burning_area_change": {"taper_per_m": either(0.005, 0.3)},
    "erosive_burning": {"coefficient_s_m": log(0.003, 0.06)},
    "heat_loss": {"heat_flow_W": log(1e4, 3e5), "time_s": log(2.0, 15.0)},
    "leakage": {"area_m2": log(2e-6, 4e-5)},
}
"""Functions that draw the parameters of effects of the catalogue, by effect and parameter."""

GAS_OUTSIDE_SIZES: Mapping[str, Mapping[str, Draw]] = {
    "x_propellant_bands": {"share": log(0.003, 0.05), "length_m": log(0.01, 0.1)},
    "x_burning_wave": {"share": log(0.003, 0.05), "frequency_Hz": log(0.1, 5.0)},
    "x_throat_wear": {"rate_m_s": log(5e-7, 2e-5)},
    "x_slag_puffs": {
        "share": log(0.01, 0.1),
        "period_s": log(0.5, 4.0),
        "length_s": log(0.05, 0.4),
    },
}
"""Functions that draw the parameters of effects outside the catalogue, by effect and parameter."""


class GasRig(NamedTuple):
    """Drawn data of one gas trial.

    Attributes:
        kind: Kind of trial: no effect, one of the catalogue, or one outside it.
        machine: The simulated machine with the effect.
        volumes_m3: Free volume of each firing.
        angle_zero_rad: True minus recorded valve angle.
        pressure_zero_Pa: Recorded pressure minus transmitter pressure.
        late_cycles: Delay of pressure relative to angle, cycles.
        seed: Seed of the noise.
    """

    kind: Kind
    machine: Machine
    volumes_m3: tuple[float, ...]
    angle_zero_rad: float
    pressure_zero_Pa: float
    late_cycles: int
    seed: int


def gas_assignment(rigs: int, seed: int) -> list[Assigned]:
    """Return kind and effect of each trial, in random order; every effect occurs about equally
    often.
    """
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs, GAS_SHARES)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in in_turn(list(GAS_SIZES), counts["one"], rng)]
    drawn += [
        ("outside", (name,)) for name in in_turn(list(GAS_OUTSIDE_SIZES), counts["outside"], rng)
    ]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def draw_gas(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> GasRig:
    """Draw one trial.

    Args:
        kind: Kind of the trial.
        names: Effects to inject.
        seed: Entropy of the draws; equal entropy results in equal trials.
    """
    rng = np.random.default_rng(list(seed))
    base = Machine()
    g = base.gas

    def around(value: float, spread: float) -> float:
        return float(value * rng.uniform(1.0 - spread, 1.0 + spread))

    velocity = around(g.characteristic_velocity_m_s, VELOCITY_SPREAD)
    volume = around(g.free_volume_m3, VOLUME_SPREAD)

    def off(most: float) -> float:
        return float(rng.uniform(-most, most))

    valve = replace(
        g.valve,
        hole_diameter_m=g.valve.hole_diameter_m + off(SIZE_SPREAD_M),
        opening_diameter_m=g.valve.opening_diameter_m + off(SIZE_SPREAD_M),
        plate_width_m=g.valve.plate_width_m + off(SIZE_SPREAD_M),
    )
    gas = replace(
        g,
        valve=valve,
        burning_rate_mm_s=around(g.burning_rate_mm_s, RATE_SPREAD),
        pressure_exponent=g.pressure_exponent + off(EXPONENT_SPREAD),
        characteristic_velocity_m_s=velocity,
        energy_J_kg=g.energy_J_kg * (velocity / g.characteristic_velocity_m_s) ** 2,
        free_volume_m3=volume,
    )
    sensor = replace(
        g.transmitter, noise_Pa=g.transmitter.range_Pa * float(rng.uniform(*NOISE_SHARES))
    )
    sizes = {**GAS_SIZES, **GAS_OUTSIDE_SIZES}
    effects = {name: {key: size(rng) for key, size in sizes[name].items()} for name in names}
    machine = replace(base, gas=replace(gas, transmitter=sensor), effects=effects)
    volumes = tuple(around(volume, GRAIN_SPREAD) for _ in gas_experiments())
    return GasRig(
        kind=kind,
        machine=machine,
        volumes_m3=volumes,
        angle_zero_rad=off(ANGLE_SPREAD_RAD),
        pressure_zero_Pa=off(ZERO_SHARE * base.gas.transmitter.range_Pa),
        late_cycles=int(rng.integers(MOST_LATE_CYCLES + 1)),
        seed=int(rng.integers(1 << 62)),
    )
