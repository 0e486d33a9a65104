"""MuJoCo's machine in the drive's loops: its stiction, its motor, its effects."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.mujoco_plant.model import xml
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.world import COMMAND_S, Array, Signals, World
from tests.worlds import test_plants as plants
from tests.worlds.test_plants import speed, torque

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.proof


def world_of(
    command: Array, effects: plants.Effects = plants.NOTHING, **recording: object
) -> World:
    return plants.world_of(effects, command=command, **recording)


def played(world: World) -> Signals:
    return plants.played(world, MujocoPlant())


def sine(amplitude_rad: float = 0.3, frequency_Hz: float = 0.5, seconds: float = 4.0) -> Array:
    t = np.arange(round(seconds / COMMAND_S)) * COMMAND_S
    ease = np.minimum(t / 0.5, 1.0)
    return np.asarray(amplitude_rad * ease * np.sin(2.0 * np.pi * frequency_Hz * t))


@pytest.fixture(scope="module")
def plain() -> tuple[World, Signals]:
    world = world_of(sine())
    return world, played(world)


def test_stiction_is_sharp() -> None:
    """MuJoCo's friction is a soft constraint: how soft is what its solver's settings leave."""
    world = world_of(sine())
    model = mujoco.MjModel.from_xml_string(xml(world, 0, 1.25e-4))
    data = mujoco.MjData(model)
    model.dof_frictionloss[0] = 12.0
    torques = np.linspace(0.0, 13.0, 8000)
    broke, crept = None, 0.0
    for value in torques:
        data.qfrc_applied[0] = value
        mujoco.mj_step(model, data)
        if abs(data.qvel[0]) > 5e-5 and broke is None:
            broke = value
        if value < 11.8:
            crept = max(crept, abs(float(data.qvel[0])))
    assert broke == pytest.approx(12.0, rel=5e-3)
    assert crept < 2e-6


def test_springs_stops_and_waves_are_the_catalogues(plain: tuple[World, Signals]) -> None:
    world, signals = plain
    inside = (np.abs(speed(signals)) > 0.3) & (np.arange(len(signals.angle)) > 4000)

    def gap(effect: str, **given: float) -> tuple[Array, Signals]:
        other = played(replace(world, effects={effect: given}))
        return torque(world, other) - torque(world, signals), other

    spring, other = gap("return_spring", stiffness_Nm_rad=10.0, rest_rad=0.1)
    expected = 10.0 * (other.angle - 0.1)
    assert np.sqrt(np.mean((spring - expected)[inside] ** 2)) < 0.3
    wave, other = gap("cogging", torque_Nm=1.0, per_motor_turn=2.0, phase_rad=0.3)
    slow = np.sin(2.0 * other.motor_angle + 0.3)
    assert np.mean((wave * slow)[inside]) / np.mean((slow**2)[inside]) < -0.5
    stop, other = gap("end_stop", angle_rad=0.2, stiffness_Nm_rad=100.0)
    past = (other.angle > 0.22) & (np.abs(speed(other)) > 0.05)
    assert np.median((stop / (other.angle - 0.2))[past]) == pytest.approx(100.0, rel=0.2)


def test_a_gap_is_as_wide_as_it_says() -> None:
    world = replace(world_of(sine()), effects={"backlash": {"gap_rad": 0.01}})
    signals = played(world)
    twist = signals.motor_angle / world.motor.gear_ratio - signals.angle
    assert np.ptp(np.quantile(twist[4000:], (0.05, 0.95))) == pytest.approx(0.01, rel=0.05)
