"""Simulates the exact motion of machine and control loops for a commanded angle, without a bus.

The result contains the true state and the latched current and voltage. `rig paper` and tests use
this simulation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants


def simulate(
    machine: constants.Machine,
    command: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    duration_s: float,
    rate_Hz: float,
    weight_kg: float = 0.0,
    contact_force_N: float | None = None,
    burning: bool = False,
    rng: np.random.Generator | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Follow ``command`` (joint angle in rad of time in s) from rest and sample the exact state.

    Args:
        machine: The simulated machine.
        command: Vectorised function of time that returns the joint angle; 0 at time 0.
        duration_s: Length of the simulation, s.
        rate_Hz: Sample rate; the drive's loop rate must be a multiple of it.
        weight_kg: Mass on the lever.
        contact_force_N: Contact force F_P in place of that of a weight, N.
        burning: Whether the load is a gas generator, steady at the first angle, not a weight.
        rng: Random generator; needed only if the machine has current noise.

    Returns:
        ``time``, ``command``, ``angle``, ``velocity`` (of the joint), ``current`` (at the sample),
        ``mean_current`` (over the period that ends at the sample), ``voltage``, ``pressure`` and
        ``contact_force``; each of shape (n,), SI units.

    Raises:
        ValueError: The loop rate is not a multiple of the sample rate.
    """
    plant = SimulatedMachine(machine, rng or np.random.default_rng(0))
    _load(plant, weight_kg, contact_force_N, burning)
    loops_per_sample = round(machine.loops.rate_Hz / rate_Hz)
    if abs(loops_per_sample * rate_Hz - machine.loops.rate_Hz) > 1e-9 * rate_Hz:
        raise ValueError(
            f"loop rate {machine.loops.rate_Hz:g} Hz: not a multiple of sample rate {rate_Hz:g} Hz"
        )
    n = round(duration_s * rate_Hz) + 1
    time = np.arange(n) / rate_Hz
    path = command(np.arange(1, (n - 1) * loops_per_sample + 1) / machine.loops.rate_Hz)
    plant.power(True)
    out = np.zeros((7, n))
    out[5, 0], out[6, 0] = plant.truth().pressure_Pa, plant.truth().contact_force_N
    for k in range(1, n):
        plant.follow(path[(k - 1) * loops_per_sample : k * loops_per_sample])
        state, reading = plant.truth(), plant.latch()
        out[:3, k] = state.angle_rad, state.velocity_rad_s, state.current_A
        out[3:5, k] = reading.current_A, reading.voltage_V
        out[5:, k] = state.pressure_Pa, state.contact_force_N
    return {
        "time": time,
        "command": command(time),
        "angle": out[0],
        "velocity": out[1],
        "current": out[2],
        "mean_current": out[3],
        "voltage": out[4],
        "pressure": out[5],
        "contact_force": out[6],
    }


def _load(
    plant: SimulatedMachine, weight_kg: float, contact_force_N: float | None, burning: bool
) -> None:
    """Load the valve with a burning gas generator, with a contact force if it is given, or with a
    weight.
    """
    if burning:
        plant.ignite()
    elif contact_force_N is None:
        plant.hang(weight_kg)
    else:
        plant.press(contact_force_N)
