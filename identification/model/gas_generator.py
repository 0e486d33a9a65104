"""Nominal model of the gas generator (eq. 2 to 8): pressure at equilibrium and over time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled


@dataclass(frozen=True)
class ValveGeometry:
    """Dimensions of Fig. 3, m."""

    d: float = 0.025  # diameter of the hole in the plate, the least throat
    D: float = 0.040  # diameter of the opening, the greatest throat
    b: float = 0.054  # width of the plate
    L1: float = 0.095  # radius on which the hole swings

    def __post_init__(self) -> None:
        """Check the dimensions."""
        small = [
            f"{name} = {value:g} m"
            for name, value in vars(self).items()
            if not 0.0 < value < math.inf
        ]
        if small:
            raise ValueError(
                f"{', '.join(small)}: dimensions of the valve must be positive and finite"
            )
        if self.d > self.b:
            raise ValueError(
                f"the hole, d = {self.d:g} m, is wider than its plate, b = {self.b:g} m; "
                "check whether d and b are exchanged"
            )

    @property
    def opening_area(self) -> float:
        """pi D^2/4, m^2, the sum of impacted area and throat at every angle."""
        return 0.25 * math.pi * self.D**2

    @property
    def clearing_angle(self) -> float:
        """Angle above which the plate covers no part of the opening, rad; infinite if the plate is
        so wide that it covers a part at every angle.
        """
        reach = 0.5 * (self.b + self.D) / self.L1
        return math.asin(reach) if reach <= 1.0 else math.inf


PAPER = ValveGeometry()  # dimensions that the paper gives


def throat_area(angle: Array, geometry: ValveGeometry = PAPER) -> Array:
    """Return the throat area A_t, m^2, an array of the shape of ``angle``.

    Args:
        angle: Valve angle theta_r, rad, of any shape; 0 where hole and opening are concentric,
            within +-pi/2.
        geometry: Dimensions.
    """
    angle = np.abs(angle)
    opening, hole, half = 0.5 * geometry.D, 0.5 * geometry.d, 0.5 * geometry.b
    beside = geometry.L1 * np.sin(angle)
    past_the_edges = _cap(opening, half - beside) + _cap(opening, half + beside)
    apart = np.maximum(2.0 * geometry.L1 * np.sin(0.5 * angle), 1e-12 * geometry.D)
    to_line = 0.5 * (apart + (opening**2 - hole**2) / apart)
    through_the_hole = _cap(opening, to_line) + _cap(hole, apart - to_line)
    return np.asarray(past_the_edges + through_the_hole)


def impacted_area(angle: Array, geometry: ValveGeometry = PAPER) -> Array:
    """Return the impacted area A_s (eq. 10), m^2, an array of the shape of ``angle``."""
    return np.asarray(geometry.opening_area - throat_area(angle, geometry))


def _cap(radius: float, distance: Array) -> Array:
    """Return the area of a disc beyond a line at a signed distance from its centre."""
    x = np.clip(distance, -radius, radius)
    chord = np.sqrt(np.maximum(radius**2 - x**2, 0.0))
    return np.asarray(radius**2 * np.arctan2(chord, x) - x * chord)


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
"""Greatest integration step, as a share of the time in which the outflow empties the chamber."""


@compiled
def rates(
    y: float, w: float, z: float, t: float, area: float, c: Array, e: Array
) -> tuple[float, float, float]:
    """Return the time derivatives of ln p, w and ln s at ``t`` s, with a throat of ``area`` m^2."""
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


NOTHING = np.zeros(MISSING_SIZE)  # vector of effects in which all effects are absent


_MOST_STEPS = 60
LAYER_STEP = 2.5e-4  # thickness of a deposit over which the throat area is differentiated, m


@dataclass(frozen=True)
class GasGenerator:
    """Constants of a gas generator in eq. 2 to 8, SI.

    The paper gives the defaults of the first four constants and of the valve; the other defaults
    are assumptions.
    """

    rho_b: float = 1630.0  # density of the propellant, kg/m^3
    D_P: float = 0.350  # diameter of the end-burning grain, m; A_b = pi D_P^2/4
    a: float = 6.3e-3  # burning coefficient, m/s at 1 MPa: r = a (p_g / 1 MPa)^n
    n: float = 0.53  # pressure exponent
    C_r: float = 1000.0  # characteristic velocity, m/s
    gamma: float = 1.25  # specific-heat ratio of the gas; it determines R_g T_g from C_r
    V_0: float = 0.010  # free volume at ignition, m^3
    p_c0: float = 0.5e6  # pressure downstream of the valve, Pa (eq. 10)
    valve: ValveGeometry = field(default_factory=ValveGeometry)  # dimensions of Fig. 3

    def __post_init__(self) -> None:
        """Check the constants, and that combustion is stable."""
        numbers = {
            name: value for name, value in vars(self).items() if name not in ("valve", "p_c0")
        }
        wrong = [
            f"{name} = {value:g}" for name, value in numbers.items() if not 0.0 < value < math.inf
        ]
        if wrong:
            raise ValueError(
                f"{', '.join(wrong)}: constants of the gas generator must be positive and finite"
            )
        if self.n >= 1.0:
            raise ValueError(
                f"n = {self.n:g}: the pressure exponent must be below 1, because from 1 on the "
                "pressure has no stable equilibrium"
            )
        if self.gamma <= 1.0:
            raise ValueError(
                f"gamma = {self.gamma:g}: the ratio of specific heats must be above 1, as it is "
                "for every gas"
            )

    @property
    def A_b(self) -> float:
        """Burning area, m^2."""
        return 0.25 * math.pi * self.D_P**2

    @property
    def Gamma(self) -> float:
        """sqrt(R_g T_g) / C_r of a choked ideal gas (0.658 at gamma = 1.25)."""
        g = self.gamma
        return float(math.sqrt(g) * (2.0 / (g + 1.0)) ** (0.5 * (g + 1.0) / (g - 1.0)))

    @property
    def RT(self) -> float:
        """R_g T_g, J/kg."""
        return (self.Gamma * self.C_r) ** 2


def equilibrium_pressure(throat: Array | float, g: GasGenerator, *, exact: bool = True) -> Array:
    """Return the equilibrium pressure, Pa: the gas produced equals the outflow plus the gas that
    fills the burnt volume.

    Eq. 8 has a closed form. Eq. 7 with x = p^(1-n) reads x A_t/C_r + A_b a x^(1/(1-n)) / R_g T_g =
    rho_b A_b a. The left side is convex and rises from zero, so that the equation has one root,
    which is below the root of eq. 8. Newton's method starts at the root of eq. 8.

    Args:
        throat: Throat area A_t, m^2.
        g: Constants.
        exact: Eq. 7; else eq. 8.
    """
    throat = np.asarray(throat, dtype=np.float64)
    rise = g.A_b * g.a / REFERENCE_PRESSURE**g.n
    power = 1.0 / (1.0 - g.n)
    x = g.rho_b * rise * g.C_r / throat
    if exact:
        for _ in range(_MOST_STEPS):
            value = x * throat / g.C_r + rise * x**power / g.RT - g.rho_b * rise
            step = value / (throat / g.C_r + power * rise * x ** (power - 1.0) / g.RT)
            x = x - step
            if np.all(np.abs(step) <= 1e-14 * x):
                break
    return np.asarray(x**power)


def constants(
    g: GasGenerator,
    corrected: Mapping[str, float],
    start_pressure: float,
    start_volume: float,
    *,
    exact: bool = True,
) -> Array:
    """Pack the constants into the vector of the compiled kernel; values of ``a``, ``n`` and ``C_r``
    in ``corrected`` replace those of ``g``.
    """
    C_r = corrected.get("C_r", g.C_r)
    RT = (g.Gamma * C_r) ** 2
    c = np.zeros(CONSTANTS_SIZE)
    c[DENSITY], c[BURNING_AREA] = g.rho_b, g.A_b
    c[BURNING_COEFFICIENT], c[EXPONENT] = (corrected.get("a", g.a), corrected.get("n", g.n))
    c[VELOCITY], c[ENERGY] = C_r, RT
    c[ENTHALPY] = g.gamma / (g.gamma - 1.0) * RT
    c[EXACT] = 1.0 if exact else 0.0
    c[START_PRESSURE], c[START_VOLUME] = start_pressure, start_volume
    return c


def throat_derivatives(angle: Array, valve: ValveGeometry) -> Array:
    """Return A_t and its first and second derivative with respect to the thickness of a layer on
    all rims, shape (3, n); m^2, m, 1.

    A layer of thickness h reduces the diameters d and D by 2 h. The derivatives are those of the
    parabola through the areas at h = 0, 0.25 and 0.5 mm.
    """
    h = LAYER_STEP
    bare, one, two = (
        throat_area(
            angle, ValveGeometry(valve.d - 2.0 * k * h, valve.D - 2.0 * k * h, valve.b, valve.L1)
        )
        for k in range(3)
    )
    return np.stack(
        [bare, (4.0 * one - 3.0 * bare - two) / (2.0 * h), (bare - 2.0 * one + two) / h**2]
    )
