"""Remaining strength of an injected effect: the part of the effect that a new fit of the nominal
parameters does not explain, over the noise.

The strength of an effect is the change that it makes in a channel. An effect may be collinear with
the nominal model; for example, if the load consists only of friction, the loss of a gear increases
every parameter by one factor. Therefore the nominal model is fitted to the recordings of the trial
and to those of the reference simulation without the effect, and the two residuals are compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.start import choose, views_and_fit
from identification.recording import RecordingError
from rig.results.prove.folder import write
from rig.results.prove.simulate import Recorded
from rig.sources import load_source

FLOOR_SUFFIX = ".floor.json"
"""Suffix of the file with the noise floors of a trial's reference simulation."""


def residual_rms(joint: Joint) -> dict[str, float]:
    """Return the residual of a fit in each equation, in the equation's unit."""
    out = {}
    for equation in joint.equations:
        rows = joint.residual[joint.stack.part(equation.name)]
        out[equation.name] = equation.sigma * math.sqrt(float(np.mean(rows**2)))
    return out


def floors(machine: Machine, reference: list[Recorded]) -> dict[str, float]:
    """Return the nominal model's residual on a reference simulation without effects; empty if the
    model cannot be fitted.

    Raises:
        OSError: A file cannot be written.
    """
    with TemporaryDirectory() as folder:
        return floors_of(write(Path(folder), machine, reference, packed=False))


def floors_of(campaign: Path) -> dict[str, float]:
    """Return the nominal model's residual on the campaign of a trial without effects; empty if the
    model cannot be fitted.

    Raises:
        InputError: The campaign cannot be read.
    """
    dataset, bandwidth, _ = choose(load_source(campaign), None)
    try:
        _, joint = views_and_fit(dataset, bandwidth)
    except RecordingError:
        return {}
    # The floor is at least the noise of a row: where little moves, rounding errors may cancel.
    sigma = {e.name: e.sigma for e in joint.equations}
    return {name: max(rms, sigma[name]) for name, rms in residual_rms(joint).items()}


def left_over(left: Mapping[str, float], floor: Mapping[str, float]) -> dict[str, float]:
    """Return the remaining strength for each equation: the part of the residual that exceeds the
    noise floor, over the noise floor.
    """
    return {
        name: math.sqrt(max(left[name] ** 2 - floor[name] ** 2, 0.0)) / floor[name]
        for name in left
        if floor.get(name, 0.0) > 0.0
    }
