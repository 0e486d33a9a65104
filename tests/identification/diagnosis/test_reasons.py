"""What fits, and is the pattern of something else."""

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.reasons import cancelling_effects, direction_dependent, is_hysteretic
from identification.diagnosis.rules import RULES
from identification.effects import MOTION

from .benches import campaign, honest, nominal_fit

SPRING, WEIGHT, CURRENT = (
    next(t for t in MOTION if t.name == name)
    for name in ("return_spring", "gravity_imbalance", "current_offset")
)


@pytest.mark.parametrize(
    ("weight_N_m", "expected"),
    [(-12.2, ("return_spring", "gravity_imbalance")), (12.2, ()), (-3.0, ()), (0.0, ())],
)
def test_a_spring_and_a_weight_against_it_are_a_hardening_spring(weight_N_m, expected):
    """Within the travel a weight is nearly a spring."""
    joint = nominal_fit(honest())
    effects = (
        Added(SPRING, (), (12.0, 0.0)),
        Added(WEIGHT, (), (weight_N_m, 0.0)),
        Added(CURRENT, (), (0.1,)),
    )
    assert cancelling_effects(replace(joint, effects=effects)) == expected


TERM = {t.name: t for t in MOTION}


def fitted(hidden: dict[str, dict[str, float]], name: str) -> Joint:
    joint = nominal_fit(campaign(hidden, 31, 6.0))
    return fit(
        joint.equations[0].views, "N m", joint.nominal, (Added(TERM[name], (), (1.0, 0.0)),), joint
    )


@pytest.mark.parametrize("name", ["gravity_imbalance", "return_spring"])
def test_what_remembers_its_travel_is_no_weight_nor_spring(name: str) -> None:
    assert is_hysteretic(fitted({"x_travel_memory": {"torque_Nm": 1.5, "travel_rad": 0.3}}, name))


@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        ({"return_spring": {"stiffness_Nm_rad": 8.0, "rest_rad": 0.0}}, "return_spring"),
        ({"x_two_wells": {"torque_Nm": 1.5, "center_rad": 0.2, "width_rad": 0.1}}, "return_spring"),
    ],
)
def test_what_leaves_noise_or_goes_by_the_angle_remembers_nothing(hidden, name):
    assert not is_hysteretic(fitted(hidden, name))


PATCH = {"torque_Nm": 1.5, "center_rad": 0.1, "width_rad": 0.06}


def patched(hidden: str, width: float) -> Joint:
    """Fit a patch of both ways, of a width that is not sought, to a bench that hides an effect."""
    joint = nominal_fit(campaign({hidden: PATCH}, 31, 6.0))
    term = next(t for t in MOTION if t.name == "position_dependent_friction").modified(refine={})
    return fit(
        joint.equations[0].views, "N m", joint.nominal, (Added(term, (0.1, width), (1.0,)),), joint
    )


def power(joint: Joint) -> float:
    return float(np.mean(joint.residual[joint.stack.part("torque")] ** 2))


def test_a_patch_of_one_way_is_no_patch_of_both() -> None:
    joint = patched("x_one_way_patch", 0.06)
    assert power(joint) > RULES.excess
    assert direction_dependent(joint) == ("position_dependent_friction",)


def test_a_patch_of_another_width_is_wrong_both_ways() -> None:
    joint = patched("position_dependent_friction", 0.1)
    assert power(joint) > RULES.excess
    assert direction_dependent(joint) == ()
