"""Friction constants of one loop period, modified by injected effects of angle, time and load."""

from __future__ import annotations

import math

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.friction import DRAG, LAGGED, SIDE, VISCOUS_SIDE, bristle_level
from drivers.mock.plant.effects.load import load_factor
from drivers.mock.plant.effects.outside import ACCELERATION_DRAG, outside_sides
from drivers.mock.plant.effects.state import (
    ACCELERATION,
    EXTERNAL,
    FALLING,
    GROWN,
    JOINT,
    RUN,
    TIME,
    TRANSMITTED,
)
from drivers.mock.plant.parts.compiled import Vector, inlined
from drivers.mock.plant.parts.friction import DM, DMU, FRICTION_SIZE, MC, MOMENT, OMEGA_SF, SIGMA_2

_RENEWAL_RAD = 1e-3
"""Assumed sliding distance after which the increase of static friction during a rest is lost,
rad.
"""
_SMOOTHED_S = 2.5e-3
"""Assumed time constant with which the drag of ``x_acceleration_drag`` follows the acceleration,
s.
"""


@inlined
def renew(w: Vector, p: Vector, e: Vector, x: Vector, omega: float) -> None:
    """Write all elements of the friction vector ``w`` of one loop period except the inertia."""
    theta = x[JOINT]
    for k in range(FRICTION_SIZE - 1):
        w[k] = p[k]
    w[SIDE] = e[table.ASYMMETRIC_COULOMB]
    w[VISCOUS_SIDE] = e[table.ASYMMETRIC_VISCOUS]
    w[DRAG] = e[table.QUADRATIC_DRAG]
    w[LAGGED] = 0.0
    if e[table.PATCH_TORQUE] != 0.0:
        u = (theta - e[table.PATCH_CENTER]) / e[table.PATCH_WIDTH]
        w[MC] += e[table.PATCH_TORQUE] * math.exp(-0.5 * u * u)
    if e[table.COULOMB_RATE] != 0.0:
        time = e[table.COULOMB_TIME]
        w[MC] -= e[table.COULOMB_RATE] * time * math.expm1(-x[RUN] / time)
    if e[table.THERMAL_FRACTION] != 0.0:
        w[SIGMA_2] *= 1.0 - e[table.THERMAL_FRACTION] * (
            1.0 - math.exp(-x[RUN] / e[table.THERMAL_TIME])
        )
    if p[MOMENT] > 0.0:
        w[MOMENT] = p[MOMENT] * load_factor(theta, x[TIME], e)
        w[MC] += e[table.PIVOT_TORQUE]
    both, one = outside_sides(theta, x[ACCELERATION], e)
    w[MC] += both
    w[SIDE] += one
    if 0.0 < e[table.EFFICIENCY] < 1.0:
        share = e[table.EFFICIENCY]
        driving = x[TRANSMITTED] * omega >= 0.0
        w[MC] += abs(x[TRANSMITTED]) * (1.0 - share if driving else 1.0 / share - 1.0)
    w[MC] = max(w[MC] + e[table.LOAD_FRICTION] * abs(x[EXTERNAL]), 0.0)
    if e[table.DWELL_GROWTH] != 0.0:
        w[DM] += x[GROWN]
    if e[table.MEMORY_TIME] > 0.0:
        w[DM] = w[DMU] = 0.0
        w[LAGGED] = x[FALLING]
        if e[table.MEMORY_OF_SPEED] > 0.0:
            w[LAGGED] = bristle_level(abs(x[FALLING]), p, w[MOMENT])


@inlined
def remember(
    w: Vector, p: Vector, e: Vector, x: Vector, before: float, omega: float, h: float
) -> None:
    """Advance the states of friction with memory by one loop period of ``h`` seconds."""
    speed = abs(omega)
    if e[table.MEMORY_TIME] > 0.0:
        wanted = omega
        if e[table.MEMORY_OF_SPEED] == 0.0:
            wanted = bristle_level(speed, p, w[MOMENT])
        x[FALLING] = wanted + (x[FALLING] - wanted) * math.exp(-h / e[table.MEMORY_TIME])
    if e[table.DWELL_GROWTH] != 0.0:
        # The joint counts as at rest, on bristles too, if it is slower than a hundredth of the
        # Stribeck speed.
        if speed < 0.01 * p[OMEGA_SF]:
            wanted = e[table.DWELL_GROWTH]
            x[GROWN] = wanted + (x[GROWN] - wanted) * math.exp(-h / e[table.DWELL_TIME])
        else:
            x[GROWN] *= math.exp(-speed * h / _RENEWAL_RAD)
    if e[ACCELERATION_DRAG] != 0.0:
        share = 1.0 - math.exp(-h / _SMOOTHED_S)
        x[ACCELERATION] += share * ((omega - before) / h - x[ACCELERATION])
