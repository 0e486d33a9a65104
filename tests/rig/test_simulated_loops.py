"""A simulated current loop is called unstable where the simulation shows that it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Loops, Machine, Motor, Sensing
from rig.config.simulated_machine import unstable_current_loop

SMALL = Motor(
    resistance_ohm=0.6,
    inductance_H=1e-4,
    torque_constant_N_m_A=0.02,
    back_emf_constant_V_s_rad=0.02,
)


def machine(motor: Motor, gain: float, **loops: float) -> Machine:
    return Machine(
        motor=motor,
        loops=Loops(current_gain_V_A=gain, **loops),
        sensing=Sensing(current_noise_A=1e-6),
    )


def swing(bench: Machine) -> float:
    """Return how far the current swings at rest, A, with noise of a microampere to set it off."""
    plant = SimulatedMachine(bench, np.random.default_rng(0))
    plant.power(True)
    greatest = 0.0
    for _ in range(200):
        plant.advance(plant.loop_ns)
        greatest = max(greatest, abs(plant.latch().current_A))
    return greatest


def edge(motor: Motor, **loops: float) -> float:
    """Return the gain at the edge of stability, by bisection on the verdict."""
    low, high = 1e-3, 1e4
    for _ in range(60):
        middle = (low * high) ** 0.5
        low, high = (
            (middle, high)
            if unstable_current_loop(machine(motor, middle, **loops)) is None
            else (low, middle)
        )
    return low


@pytest.mark.parametrize(
    ("motor", "rate_Hz"),
    [(Motor(), 8000.0), (SMALL, 20000.0), (dataclasses.replace(SMALL, inductance_H=1e-5), 8000.0)],
)
def test_both_sides_of_the_edge_in_the_simulation(motor: Motor, rate_Hz: float) -> None:
    gain = edge(motor, rate_Hz=rate_Hz)
    assert swing(machine(motor, 0.9 * gain, rate_Hz=rate_Hz)) < 1e-3
    assert swing(machine(motor, 1.1 * gain, rate_Hz=rate_Hz)) > 0.05


def test_the_paper_s_motor_is_stable_with_a_wide_margin() -> None:
    assert unstable_current_loop(Machine()) is None
    assert edge(Motor()) > 5 * Loops().current_gain_V_A


def test_the_words_name_a_gain_that_is_stable() -> None:
    words = unstable_current_loop(machine(SMALL, 5.0))
    assert words is not None
    assert (
        "with 0.0001 H and 0.6 ohm at 20000 Hz the current loop of the simulated drive is unstable"
        in words
    )
    advised = float(words.split("lower the gain to ")[1].split(" or less")[0])
    assert unstable_current_loop(machine(SMALL, advised)) is None
    assert swing(machine(SMALL, advised)) < 1e-3


def test_a_motor_without_inductance_is_judged_too() -> None:
    bare = dataclasses.replace(SMALL, inductance_H=0.0)
    assert unstable_current_loop(machine(bare, 0.1)) is None
    assert unstable_current_loop(machine(bare, 5.0)) is not None
