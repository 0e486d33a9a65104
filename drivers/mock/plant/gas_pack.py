"""Packs the constants of a gas generator and its state at ignition for compiled code."""

from __future__ import annotations

import math

import numpy as np

from drivers.mock.plant import gas
from drivers.mock.plant.effects import gas as hidden
from drivers.mock.plant.effects.pack import GAS_KNOWN
from drivers.mock.plant.parts import constants
from drivers.mock.plant.parts.compiled import Vector, compiled
from drivers.mock.plant.parts.friction import open_throat

HEAT_RATIO = 1.25
"""Specific-heat ratio of the gas."""


def gas_vector(machine: constants.Machine) -> Vector:
    """Pack the gas generator and valve of a machine; L1 is the joint's moment arm."""
    generator, valve = machine.gas, machine.gas.valve
    g = np.zeros(gas.PARAMETER_SIZE)
    g[gas.DENSITY] = generator.propellant_density_kg_m3
    g[gas.BURNING_AREA] = 0.25 * math.pi * generator.chamber_diameter_m**2
    g[gas.RATE] = 1e-3 * generator.burning_rate_mm_s * 1e-6**generator.pressure_exponent
    g[gas.EXPONENT] = generator.pressure_exponent
    g[gas.ENERGY] = generator.energy_J_kg
    g[gas.ENTHALPY] = HEAT_RATIO / (HEAT_RATIO - 1.0) * generator.energy_J_kg
    g[gas.VELOCITY] = generator.characteristic_velocity_m_s
    g[gas.BACK_PRESSURE] = generator.back_pressure_Pa
    g[gas.SIMPLIFIED] = float(generator.equation == 8)
    g[gas.ARM] = machine.joint.moment_arm_m
    g[gas.HOLE] = 0.5 * valve.hole_diameter_m
    g[gas.OPENING] = 0.5 * valve.opening_diameter_m
    g[gas.HALF_WIDTH] = 0.5 * valve.plate_width_m
    g[gas.LOOPS_PER_STEP] = generator.loops_per_step
    g[gas.THROAT_SHARE] = g[gas.BURNING_SHARE] = g[gas.RATE_SHARE] = g[gas.HEAT_SHARE] = 1.0
    hides = GAS_KNOWN.keys() & machine.effects.keys()
    for name in hides:
        for key, value in machine.effects[name].items():
            g[gas.HIDDEN + GAS_KNOWN[name][key].slot] = value
    g[gas.HIDING] = float(bool(hides))
    return g


def unlit(machine: constants.Machine) -> Vector:
    """Return the state without combustion: no gas, and the pressure downstream of the valve."""
    y = np.zeros(gas.GAS_SIZE)
    y[gas.PRESSURE] = machine.gas.back_pressure_Pa
    return y


def lit(
    machine: constants.Machine, g: Vector, angle_rad: float, pressure_Pa: float | None = None
) -> Vector:
    """Return the state at ignition.

    Args:
        machine: The machine with the gas generator.
        g: Vector of the gas generator.
        angle_rad: Valve angle, rad.
        pressure_Pa: Pressure at the start, or None for the steady pressure at this angle.
    """
    y = np.zeros(gas.GAS_SIZE)
    y[gas.THROAT] = valve_throat(g, np.array([angle_rad]))[0]
    y[gas.PRESSURE] = (
        steady_pressures(g, y[gas.THROAT : gas.THROAT + 1])[0]
        if pressure_Pa is None
        else pressure_Pa
    )
    y[gas.VOLUME] = machine.gas.free_volume_m3
    burnt = g[gas.DENSITY] * g[gas.BURNING_AREA] * g[gas.RATE] * y[gas.PRESSURE] ** g[gas.EXPONENT]
    cooled = hidden.settled_chill(burnt, g[gas.ENTHALPY], g, gas.HIDDEN)
    y[gas.MEMORY + hidden.COOLED] = cooled
    y[gas.MASS] = (
        y[gas.PRESSURE] * y[gas.VOLUME] / (g[gas.ENERGY] * g[gas.HEAT_SHARE] * (1.0 - cooled))
    )
    y[gas.FORCE] = gas.contact_force(y[gas.PRESSURE], y[gas.THROAT], g)
    return y


@compiled
def valve_throat(g: Vector, angle: Vector) -> Vector:
    """Return A_t at each valve angle (rad), m^2, shape (n,)."""
    out = np.empty_like(angle)
    for k in range(len(angle)):
        out[k] = open_throat(angle[k], g[gas.ARM], g[gas.HOLE], g[gas.OPENING], g[gas.HALF_WIDTH])
    return out


@compiled
def steady_pressures(g: Vector, throat: Vector) -> Vector:
    """Return the steady pressure at each throat area (m^2), Pa, shape (n,)."""
    out = np.empty_like(throat)
    for k in range(len(throat)):
        out[k] = gas.settled_pressure(throat[k], g)
    return out
