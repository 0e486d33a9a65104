"""What drive and encoder report about the machine's state: means, noise, counts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Joint, Machine, Sensing

CYCLE_NS = 1_000_000
TORQUE_PER_AMPERE = 0.03 * 100.0


def free_machine(noise_A: float) -> SimulatedMachine:
    """Without friction the momentum gained is the torque impulse, whatever the drive reports."""
    machine = Machine(
        joint=Joint(Mc_N_m=0.0, Ms_N_m=0.0, sigma_2_N_m_s_rad=0.0),
        sensing=Sensing(current_noise_A=noise_A),
    )
    made = SimulatedMachine(machine, np.random.default_rng(7))
    made.power(True)
    return made


def logged_less_true_mean(noise_A: float, cycles: int) -> np.ndarray:
    machine = free_machine(noise_A)
    inertia = machine.constants.joint.inertia_kg_m2
    out = np.empty(cycles)
    before = 0.0
    for k in range(cycles):
        time = (k * 20 + np.arange(1, 21)) / 20000.0
        machine.follow(0.5 * time + 0.02 * np.sin(2.0 * np.pi * time))  # never back through rest
        speed = machine.truth().velocity_rad_s
        out[k] = machine.latch().current_A - inertia * (speed - before) / (1e-3 * TORQUE_PER_AMPERE)
        before = speed
    return out


def test_logged_current_is_the_mean_that_accelerated_the_shaft() -> None:
    assert np.max(np.abs(logged_less_true_mean(0.0, 500))) < 1e-9


def test_noise_of_the_logged_mean_is_white_and_has_the_stated_rms() -> None:
    noise = logged_less_true_mean(0.020, 4000)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.020, rel=0.05)
    assert abs(float(np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2))) < 0.06


def test_means_over_parts_make_the_mean_over_the_whole() -> None:
    path = 0.1 * np.sin(2.0 * np.pi * np.arange(1, 401) / 20000.0)
    whole, parts = free_machine(0.0), free_machine(0.0)
    whole.follow(path)
    latched = []
    for piece in np.split(path, 4):
        parts.follow(piece)
        latched.append(parts.latch())
    mean = whole.latch()
    assert mean.current_A == pytest.approx(np.mean([r.current_A for r in latched]), rel=1e-12)
    assert mean.voltage_V == pytest.approx(np.mean([r.voltage_V for r in latched]), rel=1e-12)


def test_encoders_count_whole_steps_downwards() -> None:
    machine = SimulatedMachine(Machine(), np.random.default_rng(1))
    machine.power(True)
    for k in range(400):
        machine.follow(0.3 * np.sin(2.0 * np.pi * (k * 20 + np.arange(1, 21)) / 4000.0))
        angle, reading = machine.truth().angle_rad, machine.latch()
        assert reading.motor_counts == math.floor(angle * 100.0 * 4096.0 / (2.0 * math.pi))
        assert reading.joint_counts == math.floor(angle * 262144.0 / (2.0 * math.pi))


def test_following_error_is_in_motor_counts() -> None:
    machine = SimulatedMachine(
        Machine(joint=Joint(Mc_N_m=1e9, Ms_N_m=1e9)), np.random.default_rng(1)
    )
    machine.power(True)
    machine.track(500.0, 5 * CYCLE_NS)
    machine.advance(2 * CYCLE_NS)
    assert machine.latch().following_error_counts == pytest.approx(200.0)
    machine.advance(8 * CYCLE_NS)
    assert machine.latch().following_error_counts == pytest.approx(500.0)
