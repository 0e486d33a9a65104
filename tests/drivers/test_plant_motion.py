"""Motion under the drive's loops: order of convergence, stick-slip of the soft drive, braking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.machine import SimulatedMachine, simulate
from drivers.mock.plant.parts.constants import Loops, Machine, Sensing

STIFF = Machine(sensing=Sensing(0, 0, 0.0))
SOFT = replace(STIFF, loops=replace(Loops(), velocity_gain_N_m_s_rad=None, position_gain=400.0))
ENCODER_RAD = 2.0 * np.pi / 409600.0


def sine(time: np.ndarray) -> np.ndarray:
    return np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * np.clip(time, 0.0, 1.0) ** 2


def rests(velocity: np.ndarray) -> np.ndarray:
    """Length in samples of each stretch at exactly zero speed."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (velocity == 0.0).astype(int), [0]))))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize(
    ("machine", "weight"), [(STIFF, 30.6), (SOFT, 0.0)], ids=["stiff, loaded", "soft"]
)
def test_halving_the_step_changes_less_than_an_encoder_step(
    machine: Machine, weight: float
) -> None:
    """Second order: each halving leaves a quarter of the change."""
    coarse, medium, fine = (
        simulate(replace(machine, steps_per_loop=n), sine, 6.0, 1000.0, weight)["angle"]
        for n in (2, 4, 8)
    )
    first, second = np.max(np.abs(coarse - medium)), np.max(np.abs(medium - fine))
    assert 0.0 < first < 0.1 * ENCODER_RAD
    assert second < 0.4 * first


@pytest.mark.parametrize("weight", [0.0, 30.6])
def test_soft_drive_sticks_and_slips_on_a_slow_ramp(weight: float) -> None:
    """Fig. 2 and 9: the valve waits, jumps, waits, and ends short of where it was sent."""
    duration = 20.0
    out = simulate(SOFT, lambda t: 0.02 * np.clip(t, 0.0, 18.0), duration, 1000.0, weight)
    waits = rests(out["velocity"])
    assert len(waits) >= 4
    assert np.min(waits[1:-1]) > 200  # each wait is long, not chatter
    assert np.max(out["velocity"]) > 10.0 * 0.02
    static = 12.025 + 0.095 * 10.0 * weight * 9.80665 * 0.086
    error = out["command"][-1] - out["angle"][-1]
    assert 1e-3 < error < static / 400.0
    assert out["angle"][-1] == out["angle"][-1000]


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("weight", [0.0, 30.6])
def test_soft_drive_breaks_away_at_the_static_limit(weight: float, side: float) -> None:
    """Position P asks for 400 N m/rad, so that the error at breakaway measures Ms + F_P L1 mu_s."""
    out = simulate(SOFT, lambda t: side * 0.1 * t, 1.5, 1000.0, weight)
    assert rests(out["velocity"])[0] > 100
    moved = int(np.flatnonzero(out["velocity"])[0])
    static = 12.025 + 0.095 * 10.0 * weight * 9.80665 * 0.086
    lag = 2e-3  # the current loop follows the ramp a millisecond late, sampling adds one
    assert static <= 400.0 * abs(out["command"][moved]) <= static + 400.0 * 0.1 * lag
    assert np.all(out["angle"][:moved] == 0.0)


def test_speed_never_alternates_in_sign() -> None:
    """Every reversal of a sine passes through a rest; the friction law does not chatter there."""
    machine = SimulatedMachine(STIFF, np.random.default_rng(0))
    machine.hang(30.6)
    machine.power(True)
    path = np.deg2rad(20.0) * np.sin(0.4 * np.pi * np.arange(1, 100_001) / 20000.0)
    speeds = np.empty(len(path))
    for k in range(len(path)):
        machine.follow(path[k : k + 1])
        speeds[k] = machine.truth().velocity_rad_s
    assert np.all(speeds[1:] * speeds[:-1] >= 0.0)
    reversals = np.flatnonzero(np.diff(np.sign(speeds[speeds != 0.0])))
    assert len(reversals) == 2
    waits = rests(speeds)
    assert len(waits) >= 3
    assert np.min(waits[1:]) > 20  # a millisecond at the least: it waits for the torque to build up


def test_brake_ramps_the_commanded_speed_to_a_standstill() -> None:
    machine = SimulatedMachine(STIFF, np.random.default_rng(0))
    machine.power(True)
    machine.track(2e6, 2_000_000_000)  # 1 rad/s; a count is 1 urad
    machine.advance(1_000_000_000)
    start = machine.truth()
    machine.brake(4.0)
    machine.advance(100_000_000)
    assert machine.truth().velocity_rad_s == pytest.approx(1.0 - 4.0 * 0.1, abs=0.02)
    machine.advance(400_000_000)
    stop = machine.truth()
    assert abs(stop.velocity_rad_s) < 1e-6
    assert stop.angle_rad - start.angle_rad == pytest.approx(1.0**2 / (2.0 * 4.0), rel=0.02)
    machine.advance(500_000_000)
    assert machine.truth().angle_rad == pytest.approx(stop.angle_rad, abs=1e-6)
