"""A torque that remembers its travel is mostly a weight's or a spring's, and what it leaves says
that it is neither.
"""

from __future__ import annotations

import pytest

from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.reasons import is_hysteretic
from identification.effects import MOTION

from .benches import campaign, nominal_fit

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
def test_what_leaves_noise_or_goes_by_the_angle_remembers_nothing(
    hidden: dict[str, dict[str, float]], name: str
) -> None:
    assert not is_hysteretic(fitted(hidden, name))
