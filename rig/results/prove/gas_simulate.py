"""Makes a blind gas trial: seals its truth, simulates and writes its firings, and computes the
strength of its effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import Samples, record
from rig.common.places import replacing, write_text
from rig.results.prove.draw import Assigned
from rig.results.prove.excitation import CYCLE_S
from rig.results.prove.gas_draw import GasRig, draw_gas
from rig.results.prove.gas_excitation import gas_experiments
from rig.results.prove.generate import Sealed, seal_truth
from rig.results.prove.seal import repeated_salt

CHANNELS = ("time", "command", "angle", "pressure")
"""Channels that a diagnosis of the gas generator uses. The drive's current is not used, because it
shows the gas only through friction.
"""


def seal_gas(out: Path, number: int, assigned: Assigned, seed: Sequence[int]) -> Sealed:
    """Draw a trial, and write and seal its truth; nothing is simulated yet.

    Raises:
        OSError: The truth cannot be written.
    """
    rig = draw_gas(*assigned, seed)
    gas = rig.machine.gas
    drawn = {k: v for k, v in rig._asdict().items() if k not in ("kind", "machine")}
    truth = {
        "effects": rig.machine.effects,
        "parameters": {
            "a": 1e-3 * gas.burning_rate_mm_s,
            "n": gas.pressure_exponent,
            "C_r": gas.characteristic_velocity_m_s,
            "V_0": float(
                np.mean(
                    [
                        v
                        for v, e in zip(rig.volumes_m3, gas_experiments(), strict=True)
                        if e.role == "fit"
                    ]
                )
            ),
            "d": gas.valve.hole_diameter_m,
            "D": gas.valve.opening_diameter_m,
            "b": gas.valve.plate_width_m,
        },
        "maker": {**drawn, "machine": asdict(rig.machine)},
    }
    return seal_truth(out, number, truth, repeated_salt(*seed))


def simulate_gas(where: Sealed, assigned: Assigned, seed: Sequence[int]) -> dict[str, float]:
    """Simulate a trial, write its campaign, and return the strength of its effect in the pressure.

    Raises:
        OSError: A file cannot be written.
    """
    rig = draw_gas(*assigned, seed)
    burns = campaign(rig)
    write(where.campaign, burns)
    if not rig.machine.effects:
        return {}
    reference = campaign(rig._replace(machine=replace(rig.machine, effects={})))
    changes = np.concatenate(
        [a.pressure - b.pressure for a, b in zip(burns, reference, strict=True)]
    )
    return {"pressure": float(np.sqrt(np.mean(changes**2))) / rig.machine.gas.transmitter.noise_Pa}


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
    """Write a campaign with the paper's constants of the gas generator.

    Raises:
        OSError: A file cannot be written.
    """
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
