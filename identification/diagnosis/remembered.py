"""Whether what a name leaves of the torque goes by what was since the last reversal: then it is
another effect.

A torque that remembers its travel follows the angle between reversals, as a weight or a spring
does, and is named as one of them for most of it. What is left starts anew at each reversal.
"""

from __future__ import annotations

from identification.diagnosis.begin import NEAR_FLOOR
from identification.diagnosis.generic import families
from identification.diagnosis.joint import Joint

SINCE_REVERSAL = ("travel since reversal", "time since reversal")
"""In one sine the two go together."""
MOST_OF = 1.0 / 3.0
"""Share of what is left beyond the noise that a coordinate explains, from which on it is said to go
by that.
"""


def remembered(joint: Joint) -> bool:
    """Whether more than noise is left of the torque, and goes by what was since reversal more than
    by anything else.

    Friction at the lowest speeds, of which real machines leave more than noise, goes by torque,
    speed or rest.
    """
    rows = joint.residual[joint.stack.part("torque")]
    if float(rows @ rows) <= NEAR_FLOOR * len(rows):
        return False
    torque = next(e for e in joint.equations if e.name == "torque")
    gains = {}
    for name, columns in families(torque):
        scored = joint.stack.independent(name, "torque", columns)
        gains[name] = 0.0 if scored is None else scored.gain
    most = max(gains, key=lambda name: gains[name], default="")
    return most in SINCE_REVERSAL and gains[most] >= MOST_OF * (float(rows @ rows) - len(rows))
