"""Computes the static friction limit at breakaways (M3), and the times at which the torque reaches
this limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.filter.segments import Motion
from identification.model.parameters import LOAD_RISE, MC, MU_C, SYSTEM_RISE
from identification.numerics.arrays import Array


def static_limit(p: Array, m: Motion) -> Array:
    """Return the static limit Ms + F_P L1 mu_s (M3) at each breakaway, N m, shape (m,)."""
    return np.asarray(p[MC] + p[SYSTEM_RISE] + m.breakaway_moment * (p[MU_C] + p[LOAD_RISE]))


def static_slopes(seeds: Array, m: Motion) -> Array:
    """Return the derivative of the static limit (M3) at each breakaway in each direction of the
    parameters, N m, shape (m, d); ``seeds`` of shape (d, parameters).
    """
    load = (seeds[:, MU_C] + seeds[:, LOAD_RISE])[None] * m.breakaway_moment[:, None]
    return np.asarray((seeds[:, MC] + seeds[:, SYSTEM_RISE])[None] + load)


def static_crossings(p: Array, motions: Sequence[Motion]) -> tuple[Array, ...]:
    """Return the time at which the torque first reaches the static limit at each breakaway, s, one
    array per recording.
    """
    return tuple(m.static_crossing(static_limit(p, m)) for m in motions)
