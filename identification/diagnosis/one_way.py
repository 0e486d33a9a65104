"""Whether a name holds for one way of motion only: no effect of the catalogue is larger one way
than the other.

Those that are about a direction (asymmetric friction) are as large both ways themselves: what would
differ between the two is friction, which the constants have.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from identification.diagnosis.begin import NEAR_FLOOR
from identification.diagnosis.joint import Joint
from identification.diagnosis.kept import NEARLY_ALL


def one_way(joint: Joint) -> tuple[str, ...]:
    """Return effects of a fit that, let differ between the two ways, explain nearly all that is
    left of the torque.

    Empty where no more is left than the noise may be.
    """
    rows = joint.residual[joint.stack.part("torque")]
    beyond = float(rows @ rows) - len(rows)
    if float(rows @ rows) <= NEAR_FLOOR * len(rows):
        return ()
    return tuple(name for name, gain in _gains(joint) if gain >= NEARLY_ALL * beyond)


def _gains(joint: Joint) -> Iterator[tuple[str, float]]:
    """Yield effects that show in the torque, and the whitened squares that coefficients of each way
    would explain.
    """
    torque = next(e for e in joint.equations if e.name == "torque")
    ahead = torque.rows(lambda v: v.sense) > 0.0
    for effect in joint.effects:
        columns = joint.stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            each = np.concatenate([columns * ahead, columns * ~ahead], axis=1)
            split = joint.stack.independent(effect.term.name, "torque", each)
            yield effect.term.name, 0.0 if split is None else split.gain
