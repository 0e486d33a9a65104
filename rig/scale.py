"""Weighs the stages of a run as they come: from control cycles to the verdict on a weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rig.friction_level import FrictionLevel, friction_level
from rig.plan import Plan, PlannedStage
from rig.reference import Reference
from rig.sample import Sample
from rig.weight_check import LoadedLevel, Verdict, Weighing, weigh


class Scale:
    """Remembers what every stage of a run showed at low amplitude.

    Args:
        reference: An accepted identification of the bench, or None.
    """

    def __init__(self, reference: Reference | None = None) -> None:
        self._reference = reference
        self._seen: dict[str, LoadedLevel] = {}

    def weigh(self, stage: PlannedStage, samples: Sequence[Sample], plan: Plan) -> Weighing:
        """Check the weight of a stage by the samples of its first pass; only right or unchecked ones are kept."""
        level = _level(samples, plan)
        if level is None:
            text = f"stage {stage.name}: the weight cannot be checked: its first pass hardly moves; lengthen it"
            return Weighing(stage.name, stage.weight_kg, Verdict.UNCHECKED, None, None, text)
        item = LoadedLevel(stage.name, stage.weight_kg, level)
        others = [other for name, other in self._seen.items() if name != stage.name]
        weighing = weigh(item, self._reference, others)
        if weighing.verdict is not Verdict.WRONG:
            self._seen[stage.name] = item
        return weighing


def _level(samples: Sequence[Sample], plan: Plan) -> FrictionLevel | None:
    angle = np.array([sample.angle for sample in samples])
    current = np.array([sample.current for sample in samples])
    return friction_level(angle, current * plan.limits.torque_per_ampere, plan.cycle_s)
