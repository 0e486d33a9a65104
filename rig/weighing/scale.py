"""Checks the weight on the lever in each stage by the friction measured in its first pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.common.sample import Sample
from rig.planning.plan import Plan, PlannedStage
from rig.planning.reference import Reference
from rig.runs.run_record import Verdict, Weighing
from rig.weighing.friction_level import FrictionLevel, friction_level
from rig.weighing.weight_check import LoadedLevel, weigh


class Scale:
    """Friction levels of the stages of a run at low amplitude.

    Args:
        reference: An accepted identification of the bench, or None.
    """

    def __init__(self, reference: Reference | None = None) -> None:
        self._reference = reference
        self._seen: dict[str, LoadedLevel] = {}

    def weigh(self, stage: PlannedStage, level: FrictionLevel | None) -> Weighing:
        """Check the weight of a stage by the friction of its first pass; only the levels of weights
        that are right or unchecked are stored.
        """
        if level is None:
            text = (
                f"stage {stage.name}: the weight cannot be checked: its first pass hardly moves "
                f"the joint, even at "
                f"{stage.first_passes[-1].amplitude:.0%} amplitude; lengthen "
                f"first_pass.duration_s or stiffen the drive"
            )
            return Weighing(stage.name, stage.weight_kg, Verdict.UNCHECKED, None, None, text)
        item = LoadedLevel(stage.name, stage.weight_kg, level)
        others = [other for name, other in self._seen.items() if name != stage.name]
        weighing = weigh(item, self._reference, others)
        if weighing.verdict is not Verdict.WRONG:
            self._seen[stage.name] = item
        return weighing


def measured_level(samples: Sequence[Sample], plan: Plan) -> FrictionLevel | None:
    """Return the friction level of the samples of a pass, or None if the joint hardly moved."""
    angle = np.array([sample.angle for sample in samples])
    current = np.array([sample.current for sample in samples])
    return friction_level(angle, current * plan.limits.torque_per_ampere, plan.cycle_s)
