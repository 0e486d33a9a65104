"""A patch of friction that is met one way only is no effect of the catalogue, however well one of
both ways fits.
"""

from __future__ import annotations

import numpy as np

from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.reasons import direction_dependent
from identification.diagnosis.rules import RULES
from identification.effects import MOTION

from .benches import campaign, nominal_fit

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
