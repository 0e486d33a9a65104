"""Writes a blind trial to disk: a campaign file and its recordings, without any trace of the
injected effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.mock.plant.parts.constants import Machine
from rig.common.places import replacing, write_text
from rig.results.prove.excitation import FixedWeight
from rig.results.prove.simulate import CHANNELS, Recorded

CAMPAIGN_FILE = "campaign.yaml"
AVERAGED = ("current", "voltage")


def write(
    folder: Path, machine: Machine, recorded: Sequence[Recorded], packed: bool = True
) -> Path:
    """Write a campaign; return the campaign file.

    All time stamps are of one clock, so that the first time stamp of each recording is the start
    of the recording in the campaign.

    Args:
        folder: Folder of the campaign.
        machine: The plant; only its nominal constants are written.
        recorded: Recordings of the plant.
        packed: Whether to compress the recordings; compression takes half as long as their
            simulation.

    Raises:
        OSError: A file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for entry in recorded:
        samples = entry.samples
        columns = {"time": entry.start_s + samples.time, "command": samples.command}
        columns |= {name: getattr(samples, name) for name in CHANNELS}
        with (
            replacing(folder / f"{entry.experiment.name}.npz") as draft,
            draft.open("wb") as stream,
        ):
            (np.savez_compressed if packed else np.savez)(stream, allow_pickle=False, **columns)
    path = folder / CAMPAIGN_FILE
    write_text(path, yaml.safe_dump(description(machine, recorded), sort_keys=False))
    return path


def description(machine: Machine, recorded: Sequence[Recorded]) -> dict[str, Any]:
    """Return the content of the campaign file: constants that an engineer knows, recordings and
    channels.
    """
    motor, joint = machine.motor, machine.joint
    channels: dict[str, Any] = {name: name for name in ("time", "command", *CHANNELS)}
    channels |= {name: {"column": name, "average": True} for name in AVERAGED}
    return {
        "campaign": 1,
        "bench": {
            "motion": "rotary",
            "torque_constant": motor.torque_constant_N_m_A,
            "back_emf_constant": motor.back_emf_constant_V_s_rad,
            "resistance": motor.resistance_ohm,
            "inductance": motor.inductance_H,
            "gear_ratio": motor.gear_ratio,
            "moment_arm": joint.moment_arm_m,
            "lever_ratio": joint.lever_ratio,
            "gravity": joint.gravity_m_s2,
        },
        "defaults": {"channels": channels},
        "recordings": [
            {
                "file": f"{entry.experiment.name}.npz",
                "stage": "loaded" if entry.experiment.weight_kg else "unloaded",
                "weight_mass": entry.experiment.weight_kg,
                **_gravity(entry.experiment.fixed),
                "role": entry.experiment.role,
            }
            for entry in recorded
        ],
    }


def _gravity(fixed: FixedWeight | None) -> dict[str, Any]:
    if fixed is None:
        return {}
    return {"gravity": {"mass": fixed.mass_kg, "length": fixed.length_m, "zero": fixed.zero_rad}}
