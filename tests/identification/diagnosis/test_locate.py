"""Where the mismatch is said to be: over the coordinate that fixes it, for friction with its
sign.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.diagnosis.score.locate import best_map, curve, maps, ranges

from .benches import campaign, nominal_fit

CENTER_RAD, WIDTH_RAD = 0.1, 0.06


def test_a_worn_patch_lies_where_it_is_though_its_torque_turns_with_the_motion() -> None:
    patch = {"torque_Nm": 2.0, "center_rad": CENTER_RAD, "width_rad": WIDTH_RAD}
    joint = nominal_fit(campaign({"position_dependent_friction": patch}, 12, 8.0))
    torque = joint.equations[0]
    before = torque.sigma * joint.residual[joint.stack.part("torque")]
    drawn = maps(joint.stack, torque, before, np.zeros_like(before), np.random.default_rng(0))
    angle = next(m for m in drawn if m.coordinate == "angle")
    assert angle.against_motion
    assert angle.share > 0.5
    assert any(low < CENTER_RAD < high for low, high in ranges(angle))
    assert angle.mean[np.argmin(np.abs(angle.centre - CENTER_RAD))] > 0.5
    carried = curve(drawn)
    assert carried is not None
    assert carried.coordinate == next(m.coordinate for m in drawn if not m.against_motion)
    assert curve([angle]) is None


def test_its_own_coordinate_is_given_where_it_explains_as_much() -> None:
    joint = nominal_fit(campaign({}, 13, 6.0))
    torque = joint.equations[0]
    rest = torque.sigma * joint.residual[joint.stack.part("torque")]
    made = maps(joint.stack, torque, rest, rest, np.random.default_rng(0))[0]
    best, own, poor = (
        replace(made, coordinate=name, share=share)
        for name, share in (("torque", 0.9), ("angle", 0.8), ("time", 0.3))
    )
    assert best_map([best, own, poor], "angle") is own
    assert best_map([best, own, poor], "time") is best
    assert best_map([], "time") is None
