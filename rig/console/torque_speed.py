"""Computes the points of the torque-speed plot from the recorded excitations, and the friction
curve from the newest identification of the bench.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from identification.model.friction import load_coefficient, system_friction
from identification.recording import Array
from rig.common.errors import InputError
from rig.console.channels import DEG
from rig.planning.friction_model import friction_model
from rig.runs.run_file import recorded_bench
from rig.runs.run_record import RunRecord

BLOCK = 10
"""Number of samples that are averaged for one point."""
MOST = 3000
"""Greatest number of points; beyond this number, every second point is dropped."""
_SPEEDS = 121


class TorqueSpeed:
    """Points of torque against speed.

    Attributes:
        points: Speed, deg/s, torque, N m, and number of the excitation, shape (n, 3).
        version: Number that increases when points are dropped, so that pages fetch all points
            again.
    """

    def __init__(self) -> None:
        self.points: Array = np.empty((0, 3))
        self.version = 0
        self._stride = 1
        self._skipped = 0
        self._rest: Array = np.empty((0, 3))

    def add(self, samples: Mapping[str, Array], torque_per_ampere: float) -> None:
        """Add samples; samples outside an excitation are ignored.

        Args:
            samples: Arrays of shape (n,), by field.
            torque_per_ampere: Joint torque per motor current, N m/A.
        """
        moving = samples["segment"] > 0
        if not moving.any():
            return
        columns = (
            samples["velocity"][moving] * DEG,
            samples["current"][moving] * torque_per_ampere,
            samples["segment"][moving],
        )
        rows = np.concatenate([self._rest, np.stack(columns, axis=1)])
        blocks = len(rows) // BLOCK
        self._rest = rows[blocks * BLOCK :]
        means = rows[: blocks * BLOCK].reshape(blocks, BLOCK, 3)
        # A block with samples of two excitations is left out.
        means = means[means[:, 0, 2] == means[:, -1, 2]].mean(axis=1)
        kept = means[self._skipped % self._stride :: self._stride]
        self._skipped = (self._skipped - len(means)) % self._stride
        self.points = np.concatenate([self.points, kept])
        while len(self.points) > MOST:
            self.points = self.points[::2]
            self._stride *= 2
            self.version += 1


def curves(record: RunRecord, folder: Path) -> dict[str, Any] | None:
    """Return friction against speed by the newest identification of this bench, for the contact
    moment of each confirmed mass; None without an identification.

    Args:
        record: The run.
        folder: The run folder; identifications are searched in the folders beside it.
    """
    try:
        model = friction_model(recorded_bench(record), runs=folder.parent)
    except InputError:
        return None
    if not model.measured:
        return None
    speeds = np.linspace(0.0, 2.0, _SPEEDS)[1:]
    lines = []
    masses = {s.confirmed_kg for s in record.stages if s.confirmed_kg is not None}
    for mass in sorted(masses):
        system = system_friction(speeds, model.values, model.alpha)
        load = load_coefficient(speeds, model.values, model.alpha)
        torque = np.asarray(system + mass * model.moment_per_kg * load)
        lines.append({"mass_kg": mass, "torque": np.round(torque, 4).tolist()})
    return {"source": model.source, "speed": np.round(speeds * DEG, 4).tolist(), "lines": lines}
