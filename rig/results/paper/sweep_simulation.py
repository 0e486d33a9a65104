"""Simulation of Fig. 4: the valve opens at constant speed, and current, chamber pressure and
impacted area are computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from drivers.mock.plant import gas
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.without_bus import record

Array = NDArray[np.float64]

PAPER_DEG_S = 50.0
"""Opening speed in the paper, deg/s."""
SLOW_DEG_S = 5.0
"""Speed, deg/s, at which the pressure follows the throat area within 7 % and the joint does not
stick.
"""
OPEN_DEG = 30.0
CYCLE_S = 0.001
UNIFORM = 0.05
"""Relative deviation of the speed up to which the motion counts as uniform."""
SMOOTHING_S = 0.020
"""Time, s, over which the speed is computed from the joint encoder."""
REST_S = 0.2


@dataclass(frozen=True)
class Sweep:
    """One opening of the valve as measured by the sensors of the bench; arrays of shape (n,), from
    the start of the motion.

    Attributes:
        speed_deg_s: Commanded speed.
        time: Time, s.
        angle: Angle of the joint encoder, rad.
        current: Mean current over each cycle, A.
        pressure: Pressure by the transmitter, Pa.
        area: Impacted area A_s at the angle, m^2.
        steady_pressure: Steady pressure at that angle, Pa.
        uniform: Samples at the commanded speed.
        rank_pressure: Spearman's rank correlation of current and pressure over the samples in
            ``uniform``.
        rank_area: Spearman's rank correlation of current and area over the samples in ``uniform``.
    """

    speed_deg_s: float
    time: Array
    angle: Array
    current: Array
    pressure: Array
    area: Array
    steady_pressure: Array
    uniform: NDArray[np.bool_]
    rank_pressure: float
    rank_area: float

    @property
    def lag(self) -> float:
        """Greatest relative excess of the pressure over the steady pressure."""
        return float(np.max(self.pressure[self.uniform] / self.steady_pressure[self.uniform]) - 1.0)

    def at(self, degrees: Array) -> Array:
        """Return angle (deg), current (A), pressure (MPa) and area (mm^2) at these angles, shape
        (m, 4).

        Means over the samples within half a degree in uniform motion, or NaN if there are none.
        """
        angle = np.rad2deg(self.angle)
        rows = np.full((len(degrees), 4), np.nan)
        for row, degree in zip(rows, degrees, strict=True):
            near = self.uniform & (np.abs(angle - degree) <= 0.5)
            row[0] = degree
            if near.any():
                row[1:] = [
                    np.mean(v[near]) for v in (self.current, self.pressure * 1e-6, self.area * 1e6)
                ]
        return rows


def sweep(machine: constants.Machine, speed_deg_s: float, seed: int = 0) -> Sweep:
    """Open the valve of a burning gas generator from 0 to 30 deg at constant speed.

    Args:
        machine: The bench; its gas generator burns steadily at the closed valve when the motion
            starts.
        speed_deg_s: Commanded speed.
        seed: Seed of the sensor noise.

    Raises:
        ValueError: The joint sticks, or is in stick-slip, during the whole motion.
    """
    noise, transmitter = np.random.default_rng(seed).spawn(2)
    plant = SimulatedMachine(machine, noise)
    plant.power(True)
    plant.advance(round(REST_S * 1e9))
    plant.ignite()
    plant.latch()
    time = np.asarray(
        np.arange(math.ceil(OPEN_DEG / speed_deg_s / CYCLE_S)) * CYCLE_S, dtype=np.float64
    )
    samples = record(plant, np.deg2rad(speed_deg_s) * time, CYCLE_S, pressure_rng=transmitter)
    area = gas.impacted_area(machine, samples.angle)
    uniform = _uniform(samples.angle, math.radians(speed_deg_s))
    if not uniform.any():
        raise ValueError(
            f"at {speed_deg_s:g} deg/s the joint never moves uniformly; sweep faster, or stiffen "
            f"the drive"
        )
    ranks = [
        float(spearmanr(samples.current[uniform], v[uniform]).statistic)
        for v in (samples.pressure, area)
    ]
    return Sweep(
        speed_deg_s,
        time,
        samples.angle,
        samples.current,
        samples.pressure,
        area,
        gas.steady_pressure(machine, samples.angle),
        uniform,
        *ranks,
    )


def _uniform(angle: Array, wanted: float) -> NDArray[np.bool_]:
    """Return a mask of the samples at this speed (rad/s)."""
    width = round(SMOOTHING_S / CYCLE_S)
    kernel = np.ones(width) / width
    speed = np.convolve(np.gradient(angle, CYCLE_S), kernel, mode="same")
    marks = np.abs(speed - wanted) <= UNIFORM * wanted
    marks[:width] = marks[-width:] = False
    return np.asarray(marks)
