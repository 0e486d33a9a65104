"""Injected effects in motor and power stage: heating, saturation, cogging, dead time, droop."""

from __future__ import annotations

import math

from drivers.mock.plant.effects.table import (
    BRUSH_CURRENT,
    BRUSH_VOLTAGE,
    COGGING_ORDER,
    COGGING_PHASE,
    COGGING_TORQUE,
    DEAD_TIME_VOLTAGE,
    RIPPLE_FRACTION,
    RIPPLE_ORDER,
    RIPPLE_PHASE,
    SATURATION_KNEE,
    SATURATION_RATIONAL,
)
from drivers.mock.plant.parts.compiled import Vector, inlined

COPPER_PER_K = 0.00393
"""Temperature coefficient of the resistance of a copper winding, 1/K."""
MAGNET_PER_K = -0.001
"""Relative decrease of magnet flux, torque constant and back-EMF per kelvin."""


@inlined
def winding(
    current: float,
    voltage: float,
    emf: float,
    resistance: float,
    dead: float,
    decay: float,
    e: Vector,
) -> float:
    """Return the current after half a step at constant voltage and speed.

    The dead time opposes the current with the constant voltage ``dead``; the brushes oppose the
    current with a voltage that grows with the current. A current that the dead time brings to zero
    stays zero until the voltage exceeds ``dead``.
    """
    push = voltage - emf
    if e[BRUSH_VOLTAGE] != 0.0:
        push -= e[BRUSH_VOLTAGE] * math.tanh(current / e[BRUSH_CURRENT])
    if dead == 0.0:
        settled = push / resistance
        return settled + (current - settled) * decay
    if current == 0.0:
        if abs(push) <= dead:
            return 0.0
        side = math.copysign(1.0, push)
    else:
        side = math.copysign(1.0, current)
    settled = (push - side * dead) / resistance
    after = settled + (current - settled) * decay
    return 0.0 if after * side < 0.0 else after


@inlined
def dead_time_voltage(supply: float, nominal: float, e: Vector) -> float:
    """Return the voltage loss due to the dead time, a share of the supply voltage, V."""
    return float(e[DEAD_TIME_VOLTAGE] * supply / nominal)


@inlined
def flux_factor(shaft: float, e: Vector) -> float:
    """Return the ratio of the flux at a motor angle (rad) to the mean flux; this ratio scales
    torque and back-EMF.
    """
    if e[RIPPLE_FRACTION] == 0.0:
        return 1.0
    return float(1.0 + e[RIPPLE_FRACTION] * math.sin(e[RIPPLE_ORDER] * shaft + e[RIPPLE_PHASE]))


@inlined
def saturated(current: float, e: Vector) -> float:
    """Return the effective current for the torque under saturation, A."""
    knee = e[SATURATION_KNEE]
    if knee <= 0.0:
        return current
    if e[SATURATION_RATIONAL] > 0.0:
        return float(current / (1.0 + (current / knee) ** 2))
    return float(knee * math.tanh(current / knee))


@inlined
def cogging(shaft: float, e: Vector) -> float:
    """Return the cogging torque at the joint, at a motor angle in rad."""
    if e[COGGING_TORQUE] == 0.0:
        return 0.0
    return float(e[COGGING_TORQUE] * math.sin(e[COGGING_ORDER] * shaft + e[COGGING_PHASE]))
