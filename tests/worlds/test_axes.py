"""All plants under torques that a host sends, and on a linear axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.draw import draw_world
from benchmarks.worlds.files import write_world
from benchmarks.worlds.logger import columns
from benchmarks.worlds.motion import MOTIONS, Reach
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.own_plant.plant import OwnPlant
from benchmarks.worlds.third.plant import OdePlant
from benchmarks.worlds.torque import Load, course
from benchmarks.worlds.world import COMMAND_S, Array, LoopKind, Motion, Signals, World
from rig.sources import load_source

ODE = OdePlant()
MISSING = find_spec("mujoco") is None
PLANTS = [
    pytest.param(ODE, id="ode"),
    pytest.param(OwnPlant(), id="own"),
    pytest.param(
        MujocoPlant(),
        id="mujoco",
        marks=pytest.mark.skipif(MISSING, reason="mujoco is not installed"),
    ),
]
BoolArray = NDArray[np.bool_]
Plants = OdePlant | MujocoPlant | OwnPlant


@cache
def drawn(kind: LoopKind, motion: Motion, load: str = "") -> World:
    """Return the first short world of this kind."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("SHORTEST_S", 2.0), ("LONGEST_S", 3.0), ("MOST", 3)):
            patch.setattr(drawing, name, value)
        for k in range(400):
            world = draw_world("nothing", (), (77, k))
            if (world.drive.kind, world.motion) == (kind, motion) and load in (
                "",
                world.axes["load"],
            ):
                return replace(
                    world,
                    sensing=replace(world.sensing, current_noise_A=0.0, flicker=0.0),
                    log=replace(world.log, clock=False),
                )
    raise AssertionError("not drawn")


def smooth(values: Array, samples: int) -> Array:
    return np.convolve(values, np.ones(samples) / samples, mode="same")


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("motion", ["rotary", "linear"])
def test_the_drive_makes_the_torque_that_the_host_sends(plant: Plants, motion: Motion) -> None:
    world = drawn("torque", motion)
    stiffness, damping = world.host_law
    for planned, signals in zip(world.recordings, plant.play(world), strict=True):
        rate, first = world.drive.rate_Hz, round(planned.lead_s * world.drive.rate_Hz)
        at = (first + np.arange(len(signals.angle))) / rate
        sent = planned.sent(at)[1]
        law = sent - stiffness * signals.angle
        law -= damping * np.gradient(signals.angle, 1.0 / rate)
        made = world.motor.torque_per_A * signals.current
        late = 3 * rate // world.drive.host_Hz
        scale = float(np.abs(sent).max())
        left = smooth(made - law, late)[late:-late]
        assert np.sqrt(np.mean(left**2)) < 0.05 * scale
        assert not signals.command.any()


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("motion", ["rotary", "linear"])
def test_a_torque_moves_the_joint_as_expected_and_within_its_range(
    plant: Plants, motion: Motion
) -> None:
    world = drawn("torque", motion)
    for planned, signals in zip(world.recordings, plant.play(world), strict=True):
        expected = planned.command[round(planned.lead_s / COMMAND_S) :]
        at = np.arange(len(signals.angle)) / world.drive.rate_Hz
        path = np.interp(at, np.arange(len(expected)) * COMMAND_S, expected)
        span = float(np.abs(planned.command).max())
        assert np.abs(signals.angle).max() < 1.2 * span
        assert np.sqrt(np.mean((signals.angle - path) ** 2)) < 0.15 * span


@pytest.mark.parametrize("motion", MOTIONS)
def test_an_amplitude_is_found_within_travel_and_speed(motion: str) -> None:
    constants = drawn("torque", "rotary").constants
    peak, reach = 8.0 * constants.Ms, Reach(0.4, 2.0, 0.0)
    for seed in range(6):
        sent, angle = course(
            np.random.default_rng(seed), motion, (4.0, 0.0),
            (constants, peak, reach, constants.Ms / 0.4), Load(steady=-0.2 * peak),
        )  # fmt: skip
        assert np.abs(angle).max() <= 0.4
        assert np.abs(np.diff(angle)).max() / COMMAND_S <= 2.0
        assert np.abs(sent).max() <= 1.1 * peak
        assert sent[0] == pytest.approx(0.2 * peak), "the steady load is held from the start"


def test_the_host_keeps_no_phase_to_the_log() -> None:
    """With a fixed phase a held voltage would be sampled early or late, as by a time skew."""
    world = drawn("torque", "rotary")
    rate, host_Hz = world.drive.rate_Hz, world.drive.host_Hz
    sends = world.host_sends(0, 40 * rate)
    at = np.flatnonzero(sends)
    assert sends[0] == 1.0
    assert len(at) / 40.0 == pytest.approx(host_Hz, rel=0.05)
    phase = 2.0 * np.pi * at * host_Hz / rate
    assert abs(np.mean(np.exp(1j * phase))) < 0.1
    assert not drawn("cascade", "rotary").host_sends(0, 100).any()


@pytest.mark.parametrize("kind", ["torque", "host"])
def test_a_log_has_a_command_only_where_an_angle_is_sent(kind: LoopKind) -> None:
    world = drawn(kind, "rotary")
    zero = np.zeros(4 * world.drive.rate_Hz // world.log.rate_Hz)
    signals = Signals(*(zero for _ in range(7)), 0.0)
    logged = columns(world, 0, signals, np.random.default_rng(1))
    assert ("command" in logged) is (kind == "host")


@pytest.mark.parametrize("plant", PLANTS)
def test_a_slow_host_closes_a_position_loop(plant: Plants) -> None:
    world = drawn("host", "rotary")
    for planned, signals in zip(world.recordings, plant.play(world), strict=True):
        span = float(np.abs(planned.command).max())
        assert np.abs(signals.angle).max() < 1.2 * span
        late = smooth(signals.angle, 99)[99:-99] - signals.command[99:-99]
        assert np.sqrt(np.mean(late**2)) < 0.5 * span


def carriage(load: str, effects: Mapping[str, Mapping[str, float]] = {}) -> World:
    return replace(drawn("cascade", "linear", load), effects=effects)


def unexplained(world: World, k: int, signals: Signals) -> tuple[Array, BoolArray]:
    """Return the drive's force less inertia, friction and known load, N, and where the carriage
    moves steadily.
    """
    c, rate, planned = world.constants, world.drive.rate_Hz, world.recordings[k]
    width = max(rate // 200, 3)
    w = smooth(np.gradient(signals.angle, 1.0 / rate), width)
    force = smooth(world.motor.torque_per_A * signals.current, width)
    mass, moment = c.J + planned.hoisted_kg, world.contact_N(k) * world.moment_arm_m
    own = c.Mc + (c.Ms - c.Mc) * np.exp(-((w / c.omega_sf) ** 2))
    own += moment * (c.mu_c + (c.mu_s - c.mu_c) * np.exp(-((w / c.omega_sL) ** 2)))
    friction = np.sign(w) * own + (c.sigma_2 + moment * c.mu_2) * w
    left = force - mass * np.gradient(w, 1.0 / rate) - friction
    left += planned.steady_N_m(world.gravity_m_s2)
    moving = np.abs(w) > max(3.0 * max(c.omega_sf, c.omega_sL), 0.1 * np.abs(w).max())
    steady = smooth(moving.astype(float), 8 * width) > 0.999
    steady[: 9 * width] = steady[-9 * width :] = False
    return left, steady


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("load", ["lever", "carriage", "hoisted", "force"])
def test_forces_on_a_carriage_add_up(plant: Plants, load: str) -> None:
    world = carriage(load)
    seen = 0
    for k, signals in enumerate(plant.play(world)):
        left, steady = unexplained(world, k, signals)
        error = left[steady] / world.constants.Mc
        if error.size:
            assert abs(float(np.mean(error))) < 0.05
            assert float(np.sqrt(np.mean(error**2))) < 0.15
            seen += 1
    assert seen >= 2


@pytest.mark.parametrize("plant", PLANTS)
def test_a_screw_turns_the_motor_and_waves_follow_the_motor(plant: Plants) -> None:
    world = carriage("lever")
    size = 0.3 * world.constants.Mc
    wave = {"torque_Nm": size, "per_motor_turn": 1.0, "phase_rad": 0.3}
    world = replace(world, effects={"cogging": wave})
    left, shape = [], []
    for k, signals in enumerate(plant.play(world)):
        ratio = np.ptp(signals.motor_angle) / np.ptp(signals.angle)
        assert ratio == pytest.approx(world.motor.gear_ratio, rel=1e-3)
        rest, steady = unexplained(world, k, signals)
        width = max(world.drive.rate_Hz // 200, 3)
        left.append(rest[steady])
        shape.append(smooth(np.sin(signals.motor_angle + 0.3), width)[steady])
    gap, sine = np.concatenate(left), np.concatenate(shape)
    assert float(gap @ sine / (sine @ sine)) == pytest.approx(-size, rel=0.3)


def test_a_mass_that_is_lifted_is_a_load_of_the_campaign(tmp_path: Path) -> None:
    for load in ("carriage", "hoisted", "force"):
        world = carriage(load)
        logged = [
            columns(world, k, s, np.random.default_rng(k)) for k, s in enumerate(ODE.play(world))
        ]
        dataset = load_source(write_world(tmp_path / load, world, logged))
        for planned, read in zip(world.recordings, dataset.recordings, strict=True):
            assert read.bench.motion == "linear"
            assert read.bench.gear_ratio == world.motor.gear_ratio
            assert read.steady_torque == pytest.approx(planned.steady_N_m(world.gravity_m_s2))
            assert read.known_inertia == planned.hoisted_kg
            assert read.contact_force == pytest.approx(
                planned.weight_kg * world.lever_ratio * world.gravity_m_s2
            )
