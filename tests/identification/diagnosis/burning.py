"""Burns of the simulated gas generator, as a transducer of its pressure shows them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from drivers.mock.plant.gas import burn
from drivers.mock.plant.parts.constants import Machine
from identification.model.gas_generator import GasGenerator
from identification.recording import Array, Bench, Dataset, Recording

PERIOD = 0.01
TIME = np.arange(0.0, 8.0, PERIOD)
NOISE_PA = 4e3
QUANTUM_PA = 400.0
TRUE = {"a": 6.8e-3, "n": 0.55, "C_r": 970.0}
BENCH = Bench(gas_generator=GasGenerator())
"""What is believed of it: the paper's constants, which are not the true ones."""


def pauses(*levels_deg: float) -> Array:
    """Pauses of equal length, moves between them within a quarter of a second, rad."""
    steps = np.repeat(levels_deg, -(-len(TIME) // len(levels_deg)))[: len(TIME)]
    window = np.hanning(27)
    return np.deg2rad(np.convolve(np.pad(steps, 13, mode="edge"), window / window.sum(), "valid"))


def swing(centre_deg: float, amplitude_deg: float, frequency_Hz: float) -> Array:
    return np.deg2rad(centre_deg + amplitude_deg * np.sin(2.0 * np.pi * frequency_Hz * TIME))


MOVING = (pauses(3, 14, 25, 8, 20, 5), pauses(26, 10, 4), swing(15, 11, 0.4), pauses(4, 9))
UNSEEN = (swing(13, 9, 0.7),)


@lru_cache
def honest() -> Dataset:
    """Return burns without an effect."""
    return recordings({})


def recordings(
    effects: Mapping[str, Mapping[str, float]],
    moving: Sequence[Array] = MOVING,
    unseen: Sequence[Array] = UNSEEN,
    seed: int = 0,
) -> Dataset:
    """Burn under each history of valve angles and measure; the last ``unseen`` are to validate."""
    rng = np.random.default_rng(seed)
    machine = Machine(effects=effects)
    gas = replace(
        machine.gas,
        burning_rate_mm_s=1e3 * TRUE["a"],
        pressure_exponent=TRUE["n"],
        characteristic_velocity_m_s=TRUE["C_r"],
        energy_J_kg=GasGenerator(C_r=TRUE["C_r"]).RT,
        free_volume_m3=0.011,
    )
    out = []
    for k, angle in enumerate((*moving, *unseen)):
        true = burn(replace(machine, gas=gas), angle, PERIOD, steps=20)
        seen = true.pressure_Pa + NOISE_PA * rng.standard_normal(len(angle))
        channels = {
            "time": TIME,
            "angle": angle,
            "pressure": QUANTUM_PA * np.round(seen / QUANTUM_PA),
        }
        out.append(
            Recording(
                name=f"burn_{k}",
                channels=channels,
                bench=BENCH,
                role="fit" if k < len(moving) else "validate",
            )
        )
    return Dataset(tuple(out))
