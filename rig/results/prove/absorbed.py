"""How much of what a rig hides is left once the nominal constants are fitted again, over the noise.

Strength says how much an effect changes a channel; but a gear's loss where friction is all the load
makes every constant larger by one factor, and nothing else. What no method could see is known from
here: the nominal model is fitted to the rig's recordings and to those of its twin that hides
nothing, and what the former leaves is held against the latter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from identification.diagnosis.begin import begun, common_bandwidth
from identification.diagnosis.joint import Joint
from identification.recording import RecordingError
from rig.results.prove.folder import write
from rig.results.prove.simulate import Recorded
from rig.sources import load_source

FLOOR_SUFFIX = ".floor.json"
"""Of the file beside a sealed truth that holds its twin's noise floors."""


def residual_rms(joint: Joint) -> dict[str, float]:
    """Return what a fit leaves in each equation, in the equation's unit."""
    out = {}
    for equation in joint.equations:
        rows = joint.residual[joint.stack.part(equation.name)]
        out[equation.name] = equation.sigma * math.sqrt(float(np.mean(rows**2)))
    return out


def floors(machine: Machine, twin: list[Recorded]) -> dict[str, float]:
    """Return what the nominal model leaves of a twin that hides nothing; nothing where it cannot be
    fitted.

    Raises:
        OSError: It cannot be written.
    """
    with TemporaryDirectory() as folder:
        dataset = load_source(write(Path(folder), machine, twin, packed=False))
    fitted = dataset.part("fit")
    try:
        _, joint = begun(dataset, common_bandwidth(fitted))
    except RecordingError:
        return {}
    # No less than the noise of a row: rounding errors may fall together where little moves.
    sigma = {e.name: e.sigma for e in joint.equations}
    return {name: max(rms, sigma[name]) for name, rms in residual_rms(joint).items()}


def left_over(left: Mapping[str, float], floor: Mapping[str, float]) -> dict[str, float]:
    """Return by equation what is left beyond the noise, over the noise."""
    return {
        name: math.sqrt(max(left[name] ** 2 - floor[name] ** 2, 0.0)) / floor[name]
        for name in left
        if floor.get(name, 0.0) > 0.0
    }
