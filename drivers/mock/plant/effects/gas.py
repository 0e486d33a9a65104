"""Injected effects in the gas generator: deposits, tapered grain, erosion, heat loss, leak.

The module also has effects that are in no catalogue.

Slots are counted from the start of the injected part of the gas vector and of the gas state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.mock.plant.effects.outside import scatter
from drivers.mock.plant.effects.table import Parameter
from drivers.mock.plant.parts.compiled import Vector, inlined

(
    LAYER_RATE,
    TAPER,
    EROSION,
    HEAT_FLOW,
    HEAT_TIME,
    LEAK,
    BAND_SHARE,
    BAND_LENGTH,
    WAVE_SHARE,
    WAVE_FREQUENCY,
    WEAR_RATE,
    PUFF_SHARE,
    PUFF_PERIOD,
    PUFF_LENGTH,
    HIDDEN_SIZE,
) = range(15)

# Indices of the state of the effects, after those of the nominal state.
(
    WEB,  # m, burnt since ignition
    COOLED,  # share of the flame temperature that the gas has lost
    WARMED,  # temperature rise of the walls, relative to the flame temperature
    MEMORY_SIZE,
) = range(4)

GAS_CATALOGUE: Mapping[str, Mapping[str, Parameter]] = {
    "throat_deposition": {"rate_m_s": Parameter(LAYER_RATE, 0.0, 2e-4)},
    "burning_area_change": {"taper_per_m": Parameter(TAPER, -2.0, 2.0)},
    "erosive_burning": {"coefficient_s_m": Parameter(EROSION, 0.0, 1.0)},
    "heat_loss": {
        "heat_flow_W": Parameter(HEAT_FLOW, 0.0, 1e6),
        "time_s": Parameter(HEAT_TIME, 0.1, 1e4),
    },
    "leakage": {"area_m2": Parameter(LEAK, 0.0, 2e-4)},
}
"""Parameters of each effect; ``rate_m_s`` is the growth of the layer on all rims."""

GAS_OUTSIDE: Mapping[str, Mapping[str, Parameter]] = {
    "x_propellant_bands": {
        "share": Parameter(BAND_SHARE, 0.0, 0.5),
        "length_m": Parameter(BAND_LENGTH, 1e-3, 1.0),
    },
    "x_burning_wave": {
        "share": Parameter(WAVE_SHARE, 0.0, 0.5),
        "frequency_Hz": Parameter(WAVE_FREQUENCY, 0.01, 100.0),
    },
    "x_throat_wear": {"rate_m_s": Parameter(WEAR_RATE, 0.0, 2e-4)},
    "x_slag_puffs": {
        "share": Parameter(PUFF_SHARE, 0.0, 0.5),
        "period_s": Parameter(PUFF_PERIOD, 0.05, 100.0),
        "length_s": Parameter(PUFF_LENGTH, 1e-3, 10.0),
    },
}
"""Slot and range of each parameter of each effect that is in no catalogue."""


@inlined
def layer(burn_time: float, g: Vector, at: int) -> float:
    """Return the layer thickness on the rims of the throat, m; negative for wear."""
    return float((g[at + LAYER_RATE] - g[at + WEAR_RATE]) * burn_time)


@inlined
def open_share(burn_time: float, g: Vector, at: int) -> float:
    """Return the share of the throat area that slag does not close."""
    if g[at + PUFF_SHARE] == 0.0:
        return 1.0
    slot = math.floor(burn_time / g[at + PUFF_PERIOD])
    begin = scatter(slot) * max(g[at + PUFF_PERIOD] - g[at + PUFF_LENGTH], 0.0)
    shut = 0.0 <= burn_time - slot * g[at + PUFF_PERIOD] - begin < g[at + PUFF_LENGTH]
    return float(1.0 - g[at + PUFF_SHARE] if shut else 1.0)


@inlined
def burning_share(web: float, g: Vector, at: int) -> float:
    """Return the burning area of a tapered grain, relative to that at ignition."""
    return float((1.0 + g[at + TAPER] * web) ** 2)


@inlined
def rate_share(burn_time: float, web: float, gas_speed: float, g: Vector, at: int) -> float:
    """Return the ratio of the burning rate to a p^n; the gas leaves at ``gas_speed`` m/s."""
    share = 1.0 + g[at + EROSION] * gas_speed
    if g[at + BAND_SHARE] != 0.0:
        share *= 1.0 + g[at + BAND_SHARE] * math.sin(2.0 * math.pi * web / g[at + BAND_LENGTH])
    if g[at + WAVE_SHARE] != 0.0:
        share *= 1.0 + g[at + WAVE_SHARE] * math.sin(
            2.0 * math.pi * g[at + WAVE_FREQUENCY] * burn_time
        )
    return float(share)


@inlined
def chill(cooled: float, warmed: float, g: Vector, at: int) -> float:
    """Return the heat flow to the walls, W, proportional to the temperature difference."""
    return float(g[at + HEAT_FLOW] * (1.0 - cooled - warmed))


@inlined
def settled_chill(burnt: float, enthalpy: float, g: Vector, at: int) -> float:
    """Return the relative temperature loss if ``burnt`` kg/s mix at once and walls are cold."""
    return float(g[at + HEAT_FLOW] / (g[at + HEAT_FLOW] + burnt * enthalpy))


@inlined
def cool(
    cooled: float,
    warmed: float,
    burnt: float,
    stored: float,
    enthalpy: float,
    h: float,
    g: Vector,
    at: int,
) -> tuple[float, float]:
    """Advance gas and wall temperatures by ``h`` s.

    Fresh gas at flame temperature mixes with the stored gas, which loses heat to the walls: stored
    ds/dt = burnt (1 - s) - Q/enthalpy, walls dx/dt = (s - x)/time. The step is exact for the mixing
    and explicit for the heat flow.

    Args:
        cooled: 1 - s.
        warmed: x.
        burnt: Mass flow of fresh gas, kg/s.
        stored: Gas in the chamber, kg.
        enthalpy: Specific enthalpy at flame temperature, J/kg.
        h: Step, s.
        g: Parameters of the gas generator.
        at: Start of the injected part of ``g``.
    """
    heat = chill(cooled, warmed, g, at) / enthalpy
    settled = heat / burnt
    mixed = -math.expm1(-h * burnt / stored)
    return cooled + (settled - cooled) * mixed, warmed + (1.0 - cooled - warmed) * -math.expm1(
        -h / g[at + HEAT_TIME]
    )
