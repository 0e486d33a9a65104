"""Computes for one machine which effects its recordings can show, along every axis."""

from __future__ import annotations

import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.power.axes import base_world, worlds
from benchmarks.power.sizes import labels_of
from identification.diagnosis.diagnose import observable_effects
from identification.recording import RecordingError
from rig.results.prove.mujoco_plant.plant import MujocoPlant
from rig.results.prove.worlds.files import write_world
from rig.results.prove.worlds.seal import log_of
from rig.results.prove.worlds.world import World
from rig.sources import load_source


def measured(number: int, seed: int) -> dict[str, Any]:
    """Return the least sizes that the recordings of one machine show, for each axis and value."""
    base = base_world(seed, number)
    began = time.process_time()
    cells = [{"axis": axis, "value": value, **shown(world)} for axis, value, world in worlds(base)]
    return {
        "number": number,
        "seed": seed,
        "constants": asdict(base.constants),
        "motor": asdict(base.motor),
        "processor_s": time.process_time() - began,
        "cells": cells,
    }


def shown(world: World) -> dict[str, Any]:
    """Simulate a world and return what its recordings can show."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_world(Path(folder), world, log_of(MujocoPlant(), world))
        return {"labels": labels_of(world), **shown_in(file)}


def shown_in(campaign: Path) -> dict[str, Any]:
    """Return the least size of each effect that a campaign can show, and its alias group.

    ``least`` is null where the recordings do not determine the nominal model.
    """
    try:
        effects = observable_effects(load_source(campaign))
    except RecordingError as error:
        return {"least": None, "alike": {}, "message": str(error)}
    return {
        "least": {e.name: {k: float(v) for k, v in e.sizes.items()} for e in effects},
        "alike": {e.name: list(e.alike) for e in effects if e.alike},
    }
