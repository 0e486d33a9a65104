"""Writes a world to disk: campaign file and recordings as an engineer would write them, and the
truth.

Nothing in the campaign file or in the names of files shows the effects.
"""

from __future__ import annotations

import gzip
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.worlds.logger import Columns
from benchmarks.worlds.world import Planned, World
from rig.common.places import replacing, write_text
from rig.results.prove.simulate import CAMPAIGN_FILE

FORMATS: Mapping[str, str] = {
    "time": "%.7f",
    "current": "%.7g",
    "voltage": "%.6g",
    "supply_voltage": "%.6g",
}
ANGLES = "%.9g"
"""Format of all columns but the time; one count of a 24-bit encoder is 4e-7 rad, or 6e-8 m."""


def write_world(folder: Path, world: World, logged: Sequence[Columns]) -> Path:
    """Write campaign and recordings; return the campaign file.

    Raises:
        OSError: A file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for planned, columns in zip(world.recordings, logged, strict=True):
        path = folder / _file(world, planned)
        content = _npz(columns) if world.log.packed else _csv(columns)
        with replacing(path) as draft:
            draft.write_bytes(content)
    path = folder / CAMPAIGN_FILE
    write_text(path, yaml.safe_dump(campaign(world, logged[0]), sort_keys=False))
    return path


def campaign(world: World, columns: Columns) -> dict[str, Any]:
    """Return the campaign file's content.

    Args:
        world: The world.
        columns: Columns of any recording of the world.
    """
    motor, lever = world.motor, any(r.weight_kg for r in world.recordings)
    bench: dict[str, Any] = {
        "motion": world.motion,
        "torque_constant": motor.constant,
        "back_emf_constant": motor.constant,
        "resistance": motor.resistance_ohm,
        "inductance": motor.inductance_H,
        "gear_ratio": motor.gear_ratio,
        "gravity": world.gravity_m_s2,
    }
    if lever:
        bench |= {"moment_arm": world.moment_arm_m, "lever_ratio": world.lever_ratio}
    channels: dict[str, Any] = {name: name for name in columns}
    if world.log.current == "averaged":
        channels["current"] = {"column": "current", "average": True}
    if world.log.voltage == "measured":
        channels["voltage"] = {"column": "voltage", "average": True}
    return {
        "campaign": 1,
        "bench": bench,
        "defaults": {"channels": channels},
        "recordings": [_entry(world, planned) for planned in world.recordings],
    }


def _entry(world: World, planned: Planned) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "file": _file(world, planned),
        "stage": "loaded" if planned.weight_kg else "unloaded",
        "weight_mass": planned.weight_kg,
        "role": planned.role,
    }
    if planned.pendulum is not None:
        hung = planned.pendulum
        entry["gravity"] = {"mass": hung.mass_kg, "length": hung.length_m, "zero": hung.zero_rad}
    if planned.hoisted_kg:
        entry["hoisted"] = {"mass": planned.hoisted_kg}
    if planned.pull_N_m:
        entry["constant_torque"] = planned.pull_N_m
    return entry


LATE_NAMES = ("time_skew", "current_loop_lag")
"""Effects that do not count as an error in a world whose logger filters the current: a low-pass
filter of corner frequency f delays the current by 1 / (2 pi f), 0.2 to 0.8 ms.
"""


def truth_of_world(
    world: World, not_scored: Sequence[str], strength: Mapping[str, float]
) -> dict[str, Any]:
    """Return the content of a world's truth.

    Args:
        world: The world.
        not_scored: Values that have another meaning on the plant.
        strength: Change by the effects over the noise, by channel.
    """
    constants = asdict(world.constants)
    if not any(r.weight_kg for r in world.recordings):
        constants = {k: v for k, v in constants.items() if not k.startswith(("mu_", "omega_sL"))}
    if world.constants.Ms == world.constants.Mc:
        constants = {k: v for k, v in constants.items() if not k.startswith("omega_s")}
    return {
        "effects": {name: dict(given) for name, given in world.effects.items()},
        "parameters": constants,
        "not_scored": [
            *(n for n in not_scored if n.split(".")[0] in world.effects or n in constants),
            *(LATE_NAMES if world.log.current == "filtered" else ()),
        ],
        "axes": dict(world.axes),
        "strength": dict(strength),
        "maker": {
            "seed": list(world.seed),
            "motor": asdict(world.motor),
            "drive": asdict(world.drive),
            "sensing": asdict(world.sensing),
            "log": asdict(world.log),
        },
    }


def _file(world: World, planned: Planned) -> str:
    return f"{planned.name}.{'npz' if world.log.packed else 'csv.gz'}"


def _npz(columns: Columns) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **columns)
    return stream.getvalue()


def _csv(columns: Columns) -> bytes:
    stream = io.StringIO()
    stream.write(",".join(columns) + "\n")
    formats = [FORMATS.get(name, ANGLES) for name in columns]
    np.savetxt(stream, np.column_stack(list(columns.values())), delimiter=",", fmt=formats)
    return gzip.compress(stream.getvalue().encode(), mtime=0)
