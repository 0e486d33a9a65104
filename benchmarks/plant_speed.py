"""Steps per second of the simulated machine against a bare compiled loop of eq. 1, in the same run.

The bare loop has no friction, no drive loops, no sums for the sensors and no work balance: what
remains is the floor that any integration of eq. 1 with this step stands on.

    python benchmarks/plant_speed.py
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from time import perf_counter

import numpy as np
from numba import njit

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import record
from rig.common.tables import table

DURATION_S = 20.0
REPEATS = 9


@njit(cache=True, error_model="numpy")
def bare_loop(
    steps: int,
    h: float,
    voltage: float,
    r: float,
    inductance: float,
    km: float,
    ke: float,
    j: float,
) -> float:
    """Integrate eq. 1 without friction at constant voltage; return the speed reached, rad/s.

    The current by its exact decay over half a step, the speed over a step, the current over half a
    step.
    """
    decay = math.exp(-0.5 * r * h / inductance)
    current = omega = 0.0
    for _ in range(steps):
        settled = (voltage - ke * omega) / r
        current = settled + (current - settled) * decay
        omega += h * km * current / j
        settled = (voltage - ke * omega) / r
        current = settled + (current - settled) * decay
    return omega


def bare() -> float:
    """Run the bare loop over the benchmark's time."""
    m = Machine()
    motor, gear = m.motor, m.motor.gear_ratio
    steps = round(DURATION_S * m.loops.rate_Hz) * m.steps_per_loop
    km, ke = motor.torque_constant_N_m_A * gear, motor.back_emf_constant_V_s_rad * gear
    h = DURATION_S / steps
    return bare_loop(
        steps, h, 10.0, motor.resistance_ohm, motor.inductance_H, km, ke, m.joint.inertia_kg_m2
    )


def plant(weight_kg: float) -> float:
    """Follow 20 deg at 0.2 Hz for the benchmark's time."""
    m = SimulatedMachine(Machine(), np.random.default_rng(0))
    m.hang(weight_kg)
    m.power(True)
    time = np.arange(round(DURATION_S * m.constants.loops.rate_Hz)) / m.constants.loops.rate_Hz
    m.follow(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))
    return m.truth().angle_rad


def recorded(weight_kg: float, effects: dict[str, dict[str, float]]) -> float:
    """Record the same motion with the samples of the bus, but without it."""
    m = SimulatedMachine(replace(Machine(), effects=effects), np.random.default_rng(0))
    m.hang(weight_kg)
    m.power(True)
    time = np.arange(round(DURATION_S * 1e3)) * 1e-3
    return float(record(m, np.deg2rad(20.0) * np.sin(0.4 * np.pi * time)).angle[-1])


def main() -> None:
    """Print steps per second, medians over alternating repeats."""
    jobs: dict[str, Callable[[], float]] = {
        "bare eq. 1": bare,
        "plant, unloaded": lambda: plant(0.0),
        "plant, 30.6 kg": lambda: plant(30.6),
        "recording without the bus": lambda: recorded(0.0, {}),
        "the same, 30.6 kg": lambda: recorded(30.6, {}),
        "hiding asymmetric friction": lambda: recorded(
            0.0, {"asymmetric_coulomb": {"torque_Nm": 0.5}}
        ),
        "the same, 30.6 kg, and a gap": lambda: recorded(
            30.6, {"asymmetric_coulomb": {"torque_Nm": 0.5}, "backlash": {"gap_rad": 0.005}}
        ),
    }
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()  # compiles
    for _ in range(REPEATS):
        for name, job in jobs.items():
            began = perf_counter()
            job()
            seconds[name].append(perf_counter() - began)
    machine = Machine()
    steps = DURATION_S * machine.loops.rate_Hz * machine.steps_per_loop
    floor = median(seconds["bare eq. 1"])
    rows = [
        [
            name,
            f"{median(s) / floor:.2f}",
            f"{DURATION_S / median(s):.0f}",
            f"{steps / median(s) / 1e6:.1f}",
        ]
        for name, s in seconds.items()
    ]
    print(table(["loop", "time over bare", "times real time", "million steps/s"], rows))


if __name__ == "__main__":
    main()
