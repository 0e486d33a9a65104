"""Injected measurement effects: slip, eccentricity and delay of the joint encoder, current skew."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.state import (
    HISTORY,
    JOINT,
    LOOP,
    RECORDING,
    RUN,
    SEEN,
    SLIPPED,
    TIME,
)
from drivers.mock.plant.parts.compiled import Vector, inlined

Histories = NDArray[np.float64]
"""Joint angles and mean currents of the last loop periods, shape (2, HISTORY)."""


@inlined
def earlier(history: Vector, loop: float, delay_s: float, period_s: float) -> float:
    """Return the value that was ``delay_s`` before the newest value, interpolated between loop
    periods; ``loop`` is the index of the newest value.
    """
    back = delay_s / period_s
    whole = math.floor(back)
    share = back - whole
    at = int(loop - whole)
    mask = HISTORY - 1
    return float((1.0 - share) * history[at & mask] + share * history[(at - 1) & mask])


@inlined
def sense(x: Vector, e: Vector, histories: Histories, charge: float, period_s: float) -> float:
    """Sample the joint encoder, and return the charge, A s, that corresponds to the logged mean
    current of this period.
    """
    x[LOOP] += 1.0
    at = int(x[LOOP]) & (HISTORY - 1)
    theta = x[JOINT]
    if (
        e[table.SLIP_ANGLE] != 0.0
        and x[RECORDING] == e[table.SLIP_RECORDING]
        and x[TIME] >= e[table.SLIP_TIME]
    ):
        x[SLIPPED] = e[table.SLIP_ANGLE]
    seen = theta + x[SLIPPED]
    if e[table.ECCENTRICITY] != 0.0:
        seen += e[table.ECCENTRICITY] * math.sin(theta + e[table.ECCENTRICITY_PHASE])
    histories[0, at] = seen
    histories[1, at] = charge
    if e[table.DELAY_TIME] > 0.0:
        seen = earlier(histories[0], x[LOOP], e[table.DELAY_TIME], period_s)
    x[SEEN] = seen
    x[TIME] += period_s
    x[RUN] += period_s
    if e[table.SKEW_TIME] > 0.0:
        return earlier(histories[1], x[LOOP], e[table.SKEW_TIME], period_s)
    return charge
