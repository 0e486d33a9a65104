"""Simulates the gas generator without the machine: pressure and masses from the valve angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.gas import (
    BURNT,
    FORCE,
    GAS_SIZE,
    MASS,
    OUTFLOW,
    PRESSURE,
    THROAT,
    VOLUME,
    step_gas,
)
from drivers.mock.plant.gas_pack import gas_vector, lit, steady_pressures, valve_throat
from drivers.mock.plant.parts import constants
from drivers.mock.plant.parts.compiled import Vector, compiled


class Burn(NamedTuple):
    """A simulated firing, sampled at the times of its valve angles; arrays of shape (n,).

    ``burnt`` and ``outflow`` are counted from the first sample.
    """

    pressure_Pa: Vector
    throat_m2: Vector
    contact_force_N: Vector
    free_volume_m3: Vector
    stored_kg: Vector
    burnt_kg: Vector
    outflow_kg: Vector


def burn(
    machine: constants.Machine,
    angle_rad: Vector,
    period_s: float,
    steps: int = 1,
    pressure_Pa: float | None = None,
) -> Burn:
    """Simulate a firing while the valve follows given angles, with linear interpolation between
    samples.

    Args:
        machine: The machine with the gas generator.
        angle_rad: Valve angles, rad, shape (n,).
        period_s: Sampling period, s.
        steps: Integration steps per sample.
        pressure_Pa: Pressure at the start, or None for the steady pressure at the first angle.
    """
    g = gas_vector(machine)
    y = lit(machine, g, float(angle_rad[0]), pressure_Pa)
    out = np.zeros((len(angle_rad), GAS_SIZE))
    _follow(y, g, np.ascontiguousarray(angle_rad, dtype=np.float64), period_s, steps, out)
    return Burn(
        out[:, PRESSURE],
        out[:, THROAT],
        out[:, FORCE],
        out[:, VOLUME],
        out[:, MASS],
        out[:, BURNT],
        out[:, OUTFLOW],
    )


def throat_area(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the effective throat area A_t at each valve angle, m^2, shape (n,)."""
    return valve_throat(gas_vector(machine), np.ascontiguousarray(angle_rad, dtype=np.float64))


def impacted_area(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the impacted area A_s = pi D^2/4 - A_t at each valve angle, m^2, shape (n,)."""
    opening = 0.25 * np.pi * machine.gas.valve.opening_diameter_m**2
    return np.asarray(opening - throat_area(machine, angle_rad))


def steady_pressure(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the pressure of steady burning at each valve angle, Pa, shape (n,)."""
    return steady_pressures(gas_vector(machine), throat_area(machine, angle_rad))


@compiled
def _follow(
    y: Vector, g: Vector, angle: Vector, period: float, steps: int, out: NDArray[np.float64]
) -> None:
    out[0] = y
    for k in range(1, len(angle)):
        for j in range(1, steps + 1):
            step_gas(y, g, angle[k - 1] + (angle[k] - angle[k - 1]) * j / steps, period / steps)
        out[k] = y
