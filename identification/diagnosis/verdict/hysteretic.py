"""Tests whether the remaining torque mismatch is hysteretic, in which case the identified effect is
wrong.

Between reversals a hysteretic torque is a function of the angle, so that the torque of a weight or
a spring explains most of the mismatch. But the remaining mismatch depends on the travel since the
last reversal.
"""

from __future__ import annotations

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.rows.families import families
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.significance import level

SINCE_REVERSAL = ("travel since reversal", "time since reversal")
"""Coordinates on which a hysteretic mismatch depends; in the motion of a single sine the two are
equivalent.
"""


def is_hysteretic(joint: Joint) -> bool:
    """Whether the torque mismatch exceeds the noise and depends on travel or time since reversal
    more than on any other coordinate.

    In contrast, unmodelled friction at the lowest speeds of real machines depends most on torque,
    speed or rest time.
    """
    rows = joint.residual[joint.stack.part("torque")]
    torque = next(e for e in joint.equations if e.name == "torque")
    if float(rows @ rows) <= RULES.excess * level(torque) * len(rows):
        return False
    gains = {}
    for name, columns in families(torque):
        scored = joint.stack.independent(name, "torque", columns)
        gains[name] = 0.0 if scored is None else scored.gain
    most = max(gains, key=lambda name: gains[name], default="")
    return most in SINCE_REVERSAL and gains[most] >= RULES.hysteretic_share * (
        float(rows @ rows) - len(rows)
    )
