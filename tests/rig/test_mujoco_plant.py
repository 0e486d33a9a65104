"""MuJoCo's machine in the drive's loops: its stiction, its motor, its effects."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds.draw import draw_world
from benchmarks.worlds.mujoco_plant import plant as module
from benchmarks.worlds.mujoco_plant.model import xml
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.world import COMMAND_S, Array, Pendulum, Planned, Signals, World
from rig.common.errors import InputError

mujoco = pytest.importorskip("mujoco")
PLANT = MujocoPlant()


def world_of(
    command: Array, effects: dict[str, dict[str, float]] | None = None, **recording: object
) -> World:
    """Return a quiet machine of the valve's size with one recording."""
    world = draw_world("nothing", (), (12, 1))
    constants = replace(
        world.constants, J=0.2, Mc=7.0, Ms=12.0, omega_sf=0.06, sigma_2=5.0, mu_c=0.05, mu_s=0.08,
        omega_sL=0.03, mu_2=0.03,
    )  # fmt: skip
    motor = replace(
        world.motor, resistance_ohm=1.5, inductance_H=1.3e-3, constant=0.03, gear_ratio=100.0,
        supply_V=60.0, limit_A=25.0, friction_share=0.2,
    )  # fmt: skip
    sensing = replace(
        world.sensing, motor_bits=14, joint_bits=20, flicker=0.0, lines_error=0.0,
        current_noise_A=0.0,
    )  # fmt: skip
    drive = replace(
        world.drive, kind="cascade", rate_Hz=4000, position_Hz=6.0, velocity_Hz=25.0,
        current_Hz=400.0, feedforward=1.0,
    )  # fmt: skip
    planned = Planned("a", "fit", "sine", command, 0.0, **recording)  # type: ignore[arg-type]
    return replace(
        world, effects=effects or {}, constants=constants, motor=motor, sensing=sensing,
        drive=drive, recordings=(planned,), moment_arm_m=0.095, lever_ratio=10.0, motion="rotary",
    )  # fmt: skip


def sine(amplitude_rad: float = 0.3, frequency_Hz: float = 0.5, seconds: float = 4.0) -> Array:
    t = np.arange(round(seconds / COMMAND_S)) * COMMAND_S
    ease = np.minimum(t / 0.5, 1.0)
    return np.asarray(amplitude_rad * ease * np.sin(2.0 * np.pi * frequency_Hz * t))


def played(world: World) -> Signals:
    (signals,) = PLANT.play(world)
    return signals


def torque(world: World, signals: Signals) -> Array:
    return np.asarray(world.motor.torque_per_A * signals.current)


def speed(signals: Signals) -> Array:
    return np.asarray(np.gradient(signals.angle, 1.0 / 4000.0))


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


def test_friction_is_what_the_constants_say(plain: tuple[World, Signals]) -> None:
    world, signals = plain
    c, w = world.constants, speed(signals)
    assert np.sqrt(np.mean((signals.angle - signals.command)[2000:] ** 2)) < 0.02
    acceleration = np.gradient(w, 1.0 / 4000.0)
    law = c.Mc + (c.Ms - c.Mc) * np.exp(-((w / c.omega_sf) ** 2))
    moving = (np.abs(w) > 0.3) & (np.abs(np.arange(len(w)) - len(w) / 2) < len(w) / 2 - 99)
    left = torque(world, signals) - c.J * acceleration - np.sign(w) * law - c.sigma_2 * w
    assert np.sqrt(np.mean(left[moving] ** 2)) < 0.02 * c.Mc
    assert np.abs(np.mean(left[moving])) < 0.005 * c.Mc


def test_current_and_angle_have_the_same_stamps(plain: tuple[World, Signals]) -> None:
    """A current that is late by one step of the loop is a time skew that nobody injected."""
    world, signals = plain
    step, moment = 1.0 / 4000.0, torque(world, signals)
    w = (signals.angle[2:] - signals.angle[:-2]) / (2.0 * step)
    acceleration = np.diff(signals.angle, 2) / step**2
    change = (moment[2:] - moment[:-2]) / 2.0
    c, moving = world.constants, np.abs(w) > 0.3
    falls = np.sign(w) * np.exp(-((w / c.omega_sf) ** 2))
    columns = np.column_stack((acceleration, w, np.sign(w), falls, change))
    found = np.linalg.lstsq(columns[moving], moment[1:-1][moving], rcond=None)[0]
    assert -found[4] == pytest.approx(0.0, abs=0.05), "steps that the current is late"


def test_voltage_and_current_keep_to_ohms_law(plain: tuple[World, Signals]) -> None:
    world, signals = plain
    m = world.motor
    slope = np.gradient(signals.current, 1.0 / 4000.0)
    shaft = np.gradient(signals.motor_angle, 1.0 / 4000.0)
    left = signals.voltage - m.resistance_ohm * signals.current - m.constant * shaft
    left -= m.inductance_H * slope
    smooth = np.convolve(left, np.ones(40) / 40.0, mode="same")[2000:-100]
    assert np.sqrt(np.mean(smooth**2)) < 0.01 * np.abs(signals.voltage).max()


def test_load_friction_and_a_weight_on_the_joint_add_what_they_should(
    plain: tuple[World, Signals],
) -> None:
    world, signals = plain

    def further(**recording: object) -> Array:
        other = played(world_of(sine(), **recording))
        both = (speed(other) > 0.4) & (speed(signals) > 0.4)
        return (torque(world, other) - torque(world, signals))[both]

    loaded = further(weight_kg=20.0)
    c, force = world.constants, 10.0 * 20.0 * world.gravity_m_s2
    low = 0.095 * force * (c.mu_c + c.mu_2 * 0.4)
    assert np.median(loaded) == pytest.approx(low * 1.1, rel=0.15)
    pulled = further(pendulum=Pendulum(10.0, 0.1, -math.pi / 2.0))
    assert np.median(pulled) == pytest.approx(10.0 * 0.1 * 9.80665, rel=0.1)


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


def test_a_spring_between_motor_and_joint_twists_with_the_torque() -> None:
    world = replace(world_of(sine()), effects={"compliance": {"stiffness_Nm_rad": 3000.0}})
    signals = played(world)
    twist = signals.motor_angle / world.motor.gear_ratio - signals.angle
    forward = (speed(signals) > 0.4)[4000:]
    share = world.motor.friction_share
    passed = (1.0 - share) * torque(world, signals)[4000:][forward]
    assert np.median(passed / twist[4000:][forward]) == pytest.approx(3000.0, rel=0.1)


def test_bristles_give_way_before_they_slide() -> None:
    """A loop of torque below breakaway moves the joint as a spring would."""
    effects = {"presliding": {"stiffness_Nm_rad": 2000.0}}
    signals = played(replace(world_of(sine(1e-3, 1.0, 2.0)), effects=effects))
    stuck = played(world_of(sine(1e-3, 1.0, 2.0)))
    assert np.ptp(signals.angle) > 5e-4
    assert np.ptp(stuck.angle) < 0.3 * np.ptp(signals.angle)


def test_a_hot_winding_draws_more_voltage() -> None:
    effects = {"winding_heating": {"rise_K_per_W": 20.0, "time_s": 1.0}}
    world, hot = world_of(sine()), played(replace(world_of(sine()), effects=effects))
    m = world.motor
    ohm = hot.voltage - m.constant * np.gradient(hot.motor_angle, 1.0 / 4000.0)
    driven = np.abs(hot.current) > 2.0
    late = driven & (np.arange(len(ohm)) > 12000)
    resistance = np.median((ohm / np.where(driven, hot.current, 1.0))[late])
    assert resistance > 1.2 * m.resistance_ohm


def test_without_the_package_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'loadrig\[mujoco\]'"):
        next(iter(PLANT.play(world_of(sine()))))


def test_a_constant_load_beyond_a_flexible_shaft_stays_constant() -> None:
    """It is set in each step, not added to that of the step before."""
    stiffness = 2000.0
    signals = played(
        world_of(sine(), {"compliance": {"stiffness_Nm_rad": stiffness}}, pull_N_m=5.0)
    )
    free = played(world_of(sine(), {"compliance": {"stiffness_Nm_rad": stiffness}}))
    moved = (signals.angle - signals.motor_angle / 100.0) - (free.angle - free.motor_angle / 100.0)
    assert np.max(np.abs(signals.angle)) < 0.4
    assert float(np.median(moved)) == pytest.approx(5.0 / stiffness, rel=0.2)
