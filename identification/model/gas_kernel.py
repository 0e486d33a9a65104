"""Compiled integration of the gas generator's equations (eq. 2 to 8), with effects that these
equations omit.

The state is (ln p, w, ln s): pressure, web burnt and the ratio of gas temperature to flame
temperature. The stored gas is m = p V / (R_g T_g s), so that its balance (eq. 4, 5) reads

    d ln p/dt = (m_r - m_g) / m - (A_b r) / V + d ln s/dt,
    dw/dt = r,    m ds/dt = m_r (1 - s) - s Q / h,

with the burnt mass m_r = rho_b A_b r, the outflow m_g = p A / (C_r sqrt(s)), and V = V_start + the
burnt volume of the web w. Eq. 8 lacks the term A_b r / V; without loss of heat s = 1. Integration
is by classical Runge-Kutta; the steps per sample period follow from the time constant of the
outflow.
"""

from __future__ import annotations

import math

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

# Constants.
(
    DENSITY,  # rho_b, kg/m^3
    BURNING_AREA,  # A_b at the start, m^2
    BURNING_COEFFICIENT,  # a, m/s at 1 MPa
    EXPONENT,  # n
    VELOCITY,  # C_r, m/s
    ENERGY,  # R_g T_g, J/kg
    ENTHALPY,  # h, J/kg, of the gas at flame temperature
    EXACT,  # 1: eq. 7; 0: eq. 8
    START_PRESSURE,  # Pa
    START_VOLUME,  # m^3
    CONSTANTS_SIZE,
) = range(11)

# Effects that the nominal model omits; an effect whose value is zero is absent.
(
    LAYER_RATE,  # m/s, growth of the deposit on the throat's rim
    TAPER,  # 1/m, relative change of the grain's diameter with the web
    EROSION,  # s/m, growth of the burning rate with the gas velocity along the surface
    LEAK,  # m^2
    HEAT_FLOW,  # W, into cold walls
    HEAT_TIME,  # s, in which the walls warm
    MISSING_SIZE,
) = range(7)

REFERENCE_PRESSURE = 1e6
"""Unit of the pressure in r = a p^n, Pa: the burning coefficient a belongs to p in MPa."""
_LOG_REFERENCE = math.log(REFERENCE_PRESSURE)
_LONGEST = 0.25
"""Greatest integration step, as a share of the time in which the outflow would empty the
chamber.
"""


@compiled
def rates(
    y: float, w: float, z: float, t: float, area: float, c: Array, e: Array
) -> tuple[float, float, float]:
    """Return the time derivatives of ln p, w and ln s at ``t`` s of burning with an effective
    throat of ``area`` m^2.
    """
    root = math.exp(0.5 * z) if z != 0.0 else 1.0
    s = root * root
    taper = e[TAPER]
    volume = c[START_VOLUME] + c[BURNING_AREA] * w * (1.0 + taper * w * (1.0 + taper * w / 3.0))
    burning = c[BURNING_AREA] * (1.0 + taper * w) ** 2
    r = c[BURNING_COEFFICIENT] * math.exp(c[EXPONENT] * (y - _LOG_REFERENCE))
    if e[EROSION] != 0.0:
        r *= 1.0 + e[EROSION] * area * c[ENERGY] * root / (c[VELOCITY] * c[BURNING_AREA])
    stored = math.exp(y) * volume / (c[ENERGY] * s)
    burnt = c[DENSITY] * burning * r
    out = area * c[ENERGY] * root / (c[VELOCITY] * volume)
    dz = 0.0
    if e[HEAT_FLOW] != 0.0:
        heat = e[HEAT_FLOW] * math.exp(-t / e[HEAT_TIME])
        dz = (burnt * (1.0 / s - 1.0) - heat / c[ENTHALPY]) / stored
    return burnt / stored - out - c[EXACT] * burning * r / volume + dz, r, dz


@compiled
def march(time: Array, areas: Array, c: Array, e: Array, out: Array) -> None:
    """Integrate the equations of the gas generator over the samples of one recording.

    Args:
        time: Time since ignition, s, shape (n,), increasing.
        areas: Throat area at each sample and its first and second derivative with respect to the
            thickness of a deposit, shape (3, n).
        c: Constants of the gas generator.
        e: Effects that the nominal model omits.
        out: Filled with pressure (Pa), web burnt (m) and the pressure's rate (Pa/s), shape (3, n).
    """
    y, w, z = math.log(c[START_PRESSURE]), 0.0, 0.0
    if e[HEAT_FLOW] != 0.0:
        flow = (
            c[DENSITY]
            * c[BURNING_AREA]
            * c[BURNING_COEFFICIENT]
            * (c[START_PRESSURE] / 1e6) ** c[EXPONENT]
        )
        z = -math.log1p(e[HEAT_FLOW] * math.exp(-time[0] / e[HEAT_TIME]) / (flow * c[ENTHALPY]))
    layer = e[LAYER_RATE] * time[0]
    after = areas[0, 0] + layer * (areas[1, 0] + 0.5 * layer * areas[2, 0]) + e[LEAK]
    y1, w1, z1 = rates(y, w, z, time[0], after, c, e)
    out[0, 0], out[1, 0], out[2, 0] = c[START_PRESSURE], w, c[START_PRESSURE] * y1
    for k in range(1, len(time)):
        before = after
        layer = e[LAYER_RATE] * time[k]
        after = max(areas[0, k] + layer * (areas[1, k] + 0.5 * layer * areas[2, k]), 0.0) + e[LEAK]
        whole = time[k] - time[k - 1]
        volume = c[START_VOLUME] + c[BURNING_AREA] * w
        fastest = max(before, after) * c[ENERGY] / (c[VELOCITY] * volume)
        steps = max(math.ceil(whole * fastest / _LONGEST), 1)
        h = whole / steps
        for j in range(steps):
            t = time[k - 1] + j * h
            a1 = before + (after - before) * (j + 0.5) / steps
            a2 = before + (after - before) * (j + 1) / steps
            y2, w2, z2 = rates(
                y + 0.5 * h * y1, w + 0.5 * h * w1, z + 0.5 * h * z1, t + 0.5 * h, a1, c, e
            )
            y3, w3, z3 = rates(
                y + 0.5 * h * y2, w + 0.5 * h * w2, z + 0.5 * h * z2, t + 0.5 * h, a1, c, e
            )
            y4, w4, z4 = rates(y + h * y3, w + h * w3, z + h * z3, t + h, a2, c, e)
            y += h / 6.0 * (y1 + 2.0 * y2 + 2.0 * y3 + y4)
            w += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
            z += h / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4)
            y1, w1, z1 = rates(y, w, z, t + h, a2, c, e)
        p = math.exp(y)
        out[0, k], out[1, k], out[2, k] = p, w, p * y1


NOTHING = np.zeros(MISSING_SIZE)
"""Vector of effects in which all effects are absent."""
