"""Draws, simulates and seals firings of the simulated gas generator with an injected effect."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import Samples, record
from rig.common.places import replacing, write_text
from rig.config.sequence import raised_cosine
from rig.results.prove.draw import Assigned, Draw, Kind, apportion, either, in_turn, log
from rig.results.prove.engine import Engine
from rig.results.prove.excitation import CYCLE_S, Array
from rig.results.prove.run import Made, Progress, Task, made, making, seal_all
from rig.results.prove.truth import Sealed, seal_truth

BURN_S = 20.0
MOVE_S = 0.25  # duration of a step of the valve, s


class GasExperiment(NamedTuple):
    """Plan of one firing; ``command`` is the valve angle in each cycle, rad, shape (n,)."""

    name: str
    role: Literal["fit", "validate"]
    command: Array


def steps(levels_deg: Sequence[float]) -> Array:
    """Return valve angles with equal pauses at each level, starting with the closed valve."""
    n, move = round(BURN_S / CYCLE_S), round(MOVE_S / CYCLE_S)
    rise = raised_cosine(np.arange(1, move + 1) * CYCLE_S, MOVE_S)
    out = np.zeros(n)
    for k, level in enumerate(levels_deg):
        begin, end = (round(n * j / len(levels_deg)) for j in (k, k + 1))
        before = out[begin - 1] if begin else 0.0
        out[begin:end] = level
        out[begin : begin + move] = before + (level - before) * rise
    return np.deg2rad(out)


def sweep(centre_deg: float, amplitude_deg: float, first_Hz: float, last_Hz: float) -> Array:
    """Return a sine whose frequency rises linearly, around an angle, with ramps."""
    t = np.arange(round(BURN_S / CYCLE_S)) * CYCLE_S
    phase = 2.0 * np.pi * (first_Hz * t + 0.5 * (last_Hz - first_Hz) * t**2 / BURN_S)
    window = raised_cosine(t, 1.0)
    return np.asarray(np.deg2rad(window * (centre_deg + amplitude_deg * np.sin(phase))))


_PLAN: tuple[tuple[str, Literal["fit", "validate"], Callable[[], Array]], ...] = (
    ("a", "fit", lambda: steps((2, 12, 20, 8, 28, 5, 16, 10, 24, 3))),
    ("b", "fit", lambda: steps((26, 6, 18, 3, 12))),
    ("c", "fit", lambda: sweep(14, 10, 0.1, 2.0)),
    ("d", "validate", lambda: steps((14, 3, 22, 9, 27, 6))),
    ("e", "fit", lambda: sweep(20, 7, 0.05, 1.2)),
    ("f", "fit", lambda: steps((4, 8, 4, 9))),
    ("g", "validate", lambda: sweep(15, 9, 0.3, 0.6)),
    ("h", "fit", lambda: steps((22, 11, 25, 7, 13, 21, 5, 17))),
)


@cache
def gas_experiments() -> tuple[GasExperiment, ...]:
    """Return the eight firings in the order of their execution."""
    return tuple(GasExperiment(name, role, command()) for name, role, command in _PLAN)


GAS_SHARES: Mapping[Kind, float] = {"one": 50.0, "nothing": 40.0, "outside": 10.0}
RATE_SPREAD, EXPONENT_SPREAD, VELOCITY_SPREAD, VOLUME_SPREAD = 0.15, 0.03, 0.05, 0.2
"""Deviation of true constants from the campaign file's: relative; absolute for the exponent."""
GRAIN_SPREAD = 0.03
"""Relative scatter of the free volumes within a trial, which comes from different grain lengths."""
NOISE_SHARES = (0.001, 0.0025)  # noise of the transmitter as a share of its range
ZERO_SHARE = 0.0003  # largest zero error of the transmitter after taring, as a share of its range
SIZE_SPREAD_M, ANGLE_SPREAD_RAD, MOST_LATE_CYCLES = 3e-5, float(np.deg2rad(0.05)), 2
"""Largest errors of valve dimensions and encoder zero, and delay of the pressure."""

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
    """Drawn data of one gas trial."""

    kind: Kind  # kind of trial: no effect, one of the catalogue, or one outside it
    machine: Machine
    volumes_m3: tuple[float, ...]  # free volume of each firing
    angle_zero_rad: float  # true minus recorded valve angle
    pressure_zero_Pa: float  # recorded pressure minus transmitter pressure
    late_cycles: int  # delay of pressure relative to angle, cycles
    seed: int


def gas_assignment(rigs: int, seed: int) -> list[Assigned]:
    """Return kind and effect of each trial, in random order, effects about equally often."""
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs, GAS_SHARES)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in in_turn(list(GAS_SIZES), counts["one"], rng)]
    drawn += [
        ("outside", (name,)) for name in in_turn(list(GAS_OUTSIDE_SIZES), counts["outside"], rng)
    ]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def draw_gas(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> GasRig:
    """Draw one trial."""
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


CHANNELS = ("time", "command", "angle", "pressure")
"""Channels that a diagnosis of the gas generator uses. The drive's current is not used, because it
shows the gas only through friction.
"""


def seal_gas(
    home: Path,
    rigs: int,
    seed: int,
    engine: Engine,
    progress: Progress,
    salt: Callable[[int], str],
) -> list[Sealed]:
    """Draw, simulate and seal firings; return the rigs with their digests."""
    drawn = list(enumerate(gas_assignment(rigs, seed), start=1))
    settings = {"plant": "gas", "rigs": rigs, "seed": seed}
    return seal_all(home, drawn, partial(seal_one, seed=seed), engine, progress, settings, salt)


def seal_one(task: Task, seed: int) -> Made:
    """Simulate and seal one rig in a temporary folder."""
    with making(task.number) as where:
        rig = draw_gas(*task.assigned, (seed, task.number))
        burns = campaign(rig)
        write(where.campaign, burns)
        truth = truth_of(rig)
        if rig.machine.effects:
            plain = campaign(rig._replace(machine=replace(rig.machine, effects={})))
            changes = np.concatenate(
                [a.pressure - b.pressure for a, b in zip(burns, plain, strict=True)]
            )
            noise = rig.machine.gas.transmitter.noise_Pa
            truth["strength"] = {"pressure": float(np.sqrt(np.mean(changes**2))) / noise}
        seal_truth(where, where.name, truth, task.salt)
        return made(where)


def truth_of(rig: GasRig) -> dict[str, Any]:
    """Return the sealed content of a rig."""
    gas = rig.machine.gas
    pairs = zip(rig.volumes_m3, gas_experiments(), strict=True)
    fitted = [volume for volume, e in pairs if e.role == "fit"]
    drawn = {k: v for k, v in rig._asdict().items() if k not in ("kind", "machine")}
    return {
        "effects": rig.machine.effects,
        "parameters": {
            "a": 1e-3 * gas.burning_rate_mm_s,
            "n": gas.pressure_exponent,
            "C_r": gas.characteristic_velocity_m_s,
            "V_0": float(np.mean(fitted)),
            "d": gas.valve.hole_diameter_m,
            "D": gas.valve.opening_diameter_m,
            "b": gas.valve.plate_width_m,
        },
        "maker": {**drawn, "machine": asdict(rig.machine)},
    }


def campaign(rig: GasRig) -> list[Samples]:
    """Simulate all firings with motor, drive loops and sensors; each firing starts with ignition of
    a fresh grain.

    Zero errors and delay are added to the sensor values; a delayed pressure is padded with its
    first sample.
    """
    done = []
    for number, (experiment, volume) in enumerate(
        zip(gas_experiments(), rig.volumes_m3, strict=True)
    ):
        machine: Machine = replace(rig.machine, gas=replace(rig.machine.gas, free_volume_m3=volume))
        motion, pressure = (np.random.default_rng([rig.seed, number, k]) for k in range(2))
        plant = SimulatedMachine(machine, motion)
        plant.power(True)
        plant.ignite()
        samples = record(plant, experiment.command, CYCLE_S, pressure_rng=pressure)
        late = np.maximum(np.arange(len(samples.time)) - rig.late_cycles, 0)
        seen = samples.pressure[late] + rig.pressure_zero_Pa
        done.append(samples._replace(angle=samples.angle - rig.angle_zero_rad, pressure=seen))
    return done


def write(file: Path, burns: Sequence[Samples]) -> None:
    """Write a campaign with the paper's constants of the gas generator."""
    file.parent.mkdir(parents=True, exist_ok=True)
    for experiment, samples in zip(gas_experiments(), burns, strict=True):
        columns = {name: getattr(samples, name) for name in CHANNELS}
        with replacing(file.parent / f"{experiment.name}.npz") as draft, draft.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **columns)
    write_text(file, yaml.safe_dump(description(), sort_keys=False))


def description() -> dict[str, Any]:
    """Return the content of the campaign file, which does not depend on the trial."""
    return {
        "campaign": 1,
        "bench": {"moment_arm": Machine().joint.moment_arm_m, "gas_generator": {}},
        "defaults": {"channels": {name: name for name in CHANNELS}},
        "recordings": [
            {"file": f"{e.name}.npz", "stage": "loaded", "role": e.role} for e in gas_experiments()
        ],
    }
