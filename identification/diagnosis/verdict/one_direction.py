"""Tests whether an identified effect explains the remaining torque mismatch only with a different
coefficient in each direction of motion.

Every effect of the catalogue has one coefficient for both directions of motion; for asymmetric
friction this coefficient is half the difference of the friction in the two directions. An effect
that needs two coefficients is not the true cause, and the verdict is *outside the catalogue*.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.significance import level


def direction_dependent(joint: Joint) -> tuple[str, ...]:
    """Return the effects that, with separate coefficients for the two directions of motion, explain
    nearly all of the remaining torque mismatch.

    The result is empty if the remaining mismatch is within the noise.
    """
    rows = joint.residual[joint.stack.part("torque")]
    beyond = float(rows @ rows) - len(rows)
    torque = next(e for e in joint.equations if e.name == "torque")
    if float(rows @ rows) <= RULES.excess * level(torque) * len(rows):
        return ()
    return tuple(name for name, gain in _gains(joint) if gain >= RULES.nearly_all * beyond)


def _gains(joint: Joint) -> Iterator[tuple[str, float]]:
    """Yield the name of each effect in the torque equation, and the whitened squares that separate
    coefficients for the two directions of motion would explain in addition.
    """
    torque = next(e for e in joint.equations if e.name == "torque")
    ahead = torque.rows(lambda v: v.sense) > 0.0
    for effect in joint.effects:
        columns = joint.stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            each = np.concatenate([columns * ahead, columns * ~ahead], axis=1)
            split = joint.stack.independent(effect.term.name, "torque", each)
            yield effect.term.name, 0.0 if split is None else split.gain
