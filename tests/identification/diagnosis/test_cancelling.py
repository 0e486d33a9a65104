"""Two effects that nearly cancel each other are the pattern of something else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from identification.diagnosis.joint import Added
from identification.diagnosis.reasons import cancelling_effects
from identification.effects import MOTION

from .benches import honest, nominal_fit

SPRING, WEIGHT, CURRENT = (
    next(t for t in MOTION if t.name == name)
    for name in ("return_spring", "gravity_imbalance", "current_offset")
)


@pytest.mark.parametrize(
    ("weight_N_m", "expected"),
    [(-12.2, ("return_spring", "gravity_imbalance")), (12.2, ()), (-3.0, ()), (0.0, ())],
)
def test_a_spring_and_a_weight_against_it_are_a_hardening_spring(
    weight_N_m: float, expected: tuple[str, ...]
) -> None:
    """Within the travel a weight is nearly a spring."""
    joint = nominal_fit(honest())
    effects = (
        Added(SPRING, (), (12.0, 0.0)),
        Added(WEIGHT, (), (weight_N_m, 0.0)),
        Added(CURRENT, (), (0.1,)),
    )
    assert cancelling_effects(replace(joint, effects=effects)) == expected
