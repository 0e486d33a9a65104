"""A proposal is rehearsed before it is made: simulated on the nominal model with noise, and identified.

Fisher information on the filter's residuals looks at one point and in a straight line; under a heavy weight the shaft
breaks away within one sample, and there it has promised ten times what came out. So the best few designs, the present
one among them, go through the default method itself, and its intervals decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.design.pinning import NAMES, Nominal, Pinned, PlannedStage, stage_response
from identification.estimate.default import identify
from identification.estimate.result import SYSTEM_PARAMETERS
from identification.recording import Dataset, Recording, RecordingError


def rehearse(stages: Sequence[PlannedStage], nominal: Nominal, rng: np.random.Generator) -> Pinned:
    """Return the relative half widths that the default method arrives at on a simulated run of the nominal bench.

    Infinite where it does not identify a parameter, and throughout where it refuses the prediction errors: what it
    would then fall back on is not what was planned.
    """
    names = NAMES if any(s.weight > 0.0 for s in stages) else SYSTEM_PARAMETERS
    nothing = Pinned(dict.fromkeys(names, math.inf))
    try:
        result = identify(Dataset(tuple(_recording(k, s, nominal, rng) for k, s in enumerate(stages))))
    except RecordingError:
        return nothing
    if result.warnings:
        return nothing
    widths = dict(nothing.half_widths)
    for name, p in result.parameters.items():
        if name in widths and p.value and p.low is not None and p.high is not None:
            widths[name] = 0.5 * (p.high - p.low) / abs(p.value)
    return Pinned(widths)


def _recording(number: int, stage: PlannedStage, nominal: Nominal, rng: np.random.Generator) -> Recording:
    """Return what the bench would log: half of the noise's power in the torque itself, half in its measurement.

    How a drive shares it depends on its current loop, which is not known; both ends have been seen.
    """
    sensors = nominal.sensors
    response = stage_response(stage, nominal, rng, math.sqrt(0.5))
    noise = math.sqrt(0.5) * sensors.torque_noise * rng.standard_normal(len(stage.command))
    return Recording(
        name=f"stage {number + 1}",
        channels={
            "time": np.asarray(sensors.period * np.arange(len(stage.command)), dtype=np.float64),
            "angle": np.asarray(np.floor(response.angle / sensors.joint_step) * sensors.joint_step),
            "torque": np.asarray(response.torque + noise),
        },
        bench=nominal.bench,
        stage="loaded" if stage.weight else "unloaded",
        weight_mass=stage.weight,
        averaged=frozenset({"torque"}),
    )
