"""The machine sampled in every loop period: the motion of the plain machine, and what it adds."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.own_plant.sampled import Sampled, SampledMachine, Sent
from drivers.mock.plant.machine import SimulatedMachine, simulate
from drivers.mock.plant.parts.constants import Loops, Machine, Sensing

RATE_HZ = 4000.0
QUIET = Machine(loops=Loops(rate_Hz=RATE_HZ), sensing=Sensing(0, 0, 0.0), steps_per_loop=8)
OPEN = replace(QUIET, loops=replace(QUIET.loops, position_gain=0.0, velocity_gain_N_m_s_rad=None))
ARM_N_M = QUIET.motor.torque_constant_N_m_A * QUIET.motor.gear_ratio


def built(machine: Machine, count_rad: float = 0.0) -> SampledMachine:
    found = SampledMachine(machine, np.random.default_rng(1), count_rad)
    found.power(True)
    return found


def sent(path: np.ndarray, torque: float = 0.0, every: int = 1) -> Sent:
    at = np.arange(len(path))
    return Sent(path, np.full(len(path), torque), 1.0 * (at % every == 0), np.zeros(len(path)))


def sine(t: np.ndarray) -> np.ndarray:
    return np.asarray(0.2 * np.sin(np.pi * t))


@pytest.mark.parametrize(
    "effects", [{}, {"return_spring": {"stiffness_Nm_rad": 9.0, "rest_rad": 0}}]
)
def test_the_motion_is_that_of_the_plain_machine(effects: Mapping[str, dict[str, float]]) -> None:
    machine = replace(QUIET, effects=effects)
    exact = simulate(machine, sine, 1.0, RATE_HZ)
    path = sine(np.arange(1, round(RATE_HZ) + 1) / RATE_HZ)
    found = built(machine).sample(sent(path))
    assert np.array_equal(found.joint_rad, exact["angle"][:-1])
    assert np.array_equal(found.current_A, exact["current"][:-1])
    assert np.allclose(found.voltage_V, exact["voltage"][1:], rtol=1e-12)
    assert np.array_equal(found.terminal_V, found.voltage_V)
    assert found.supply_V[-1] == machine.supply_V


def test_a_load_that_is_held_from_the_start_moves_nothing() -> None:
    """The integrals of the loops hold it; without them the joint would fall first."""
    load = -1.5 * QUIET.joint.Ms_N_m
    rest = np.zeros(2000)

    def carrying(held: float) -> Sampled:
        machine = built(QUIET)
        machine.carry(load, 0.5)
        machine.hold(held)
        return machine.sample(sent(rest))

    still, fell = carrying(-load), carrying(0.0)
    assert not still.joint_rad.any()
    assert np.allclose(ARM_N_M * still.current_A, -load, rtol=1e-9)
    assert np.abs(fell.joint_rad).max() > 1e-6


def test_the_mean_current_is_that_of_the_winding() -> None:
    """A stuck joint: within a period the current approaches U / R with the time constant L / R."""
    slow = Loops(1000.0, 0.0, None, current_gain_V_A=0.5)
    machine = replace(OPEN, loops=slow, steps_per_loop=40)
    found = built(machine).sample(sent(np.zeros(200), 0.5 * OPEN.joint.Ms_N_m, 50), (0.0, 0.0))
    motor = OPEN.motor
    time_s = motor.inductance_H / motor.resistance_ohm
    final = found.voltage_V / motor.resistance_ohm
    share = time_s / 1e-3 * (1.0 - np.exp(-1e-3 / time_s))
    expected = final + (found.current_A - final) * share
    assert not found.joint_rad.any()
    assert np.allclose(found.mean_current_A, expected, atol=1e-3 * np.abs(final).max())
    line = 0.5 * (found.current_A[1:] + found.current_A[:-1])
    assert np.abs(line - expected[:-1]).max() > 0.01 * np.abs(final).max()


def test_effects_of_any_size_and_of_known_names_alone() -> None:
    soft = replace(QUIET, effects={"compliance": {"stiffness_Nm_rad": 20.0}})
    with pytest.raises(ValueError, match="must be within 300"):
        SimulatedMachine(soft, np.random.default_rng(1))
    found = built(soft).sample(sent(sine(np.arange(4000) / RATE_HZ)))
    assert np.ptp(found.rotor_rad - found.joint_rad) > 0.1
    for wrong in ({"no_effect": {}}, {"compliance": {}}, {"compliance": {"stiffness": 1.0}}):
        with pytest.raises(ValueError, match=r"compliance|no_effect"):
            built(replace(QUIET, effects=wrong))
