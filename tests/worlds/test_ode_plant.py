"""The third plant against the paper's equations, and against MuJoCo's where both have the same
machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.draw import draw_world
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.third.plant import OdePlant
from benchmarks.worlds.world import COMMAND_S, Array, Pendulum, Planned, Signals, World

RATE_HZ = 4000
ODE = OdePlant()


def world_of(
    effects: Mapping[str, Mapping[str, float]] = {}, kind: str = "cascade", **recording: object
) -> World:
    """Return a quiet machine of the valve's size with one recording of a slow sine."""
    t = np.arange(3000) * COMMAND_S
    command = 0.3 * np.minimum(t / 0.5, 1.0) * np.sin(np.pi * t)
    world = draw_world("nothing", (), (12, 1))
    return replace(
        world,
        effects=effects,
        constants=replace(
            world.constants, J=0.2, Mc=7.0, Ms=12.0, omega_sf=0.06, sigma_2=5.0, mu_c=0.05,
            mu_s=0.08, omega_sL=0.03, mu_2=0.03,
        ),
        motor=replace(
            world.motor, resistance_ohm=1.5, inductance_H=1.3e-3, constant=0.03, gear_ratio=100.0,
            supply_V=60.0, limit_A=25.0, friction_share=0.2, rotor_share=0.5,
        ),
        sensing=replace(
            world.sensing, motor_bits=16, joint_bits=20, flicker=0.0, current_noise_A=0.0
        ),
        drive=replace(
            world.drive, kind=kind, rate_Hz=RATE_HZ, position_Hz=6.0, velocity_Hz=25.0,
            current_Hz=400.0, feedforward=1.0,
        ),
        log=replace(world.log, clock=False),
        recordings=(Planned("a", "fit", "sine", command, 0.0, **recording),),  # type: ignore[arg-type]
        moment_arm_m=0.095,
        lever_ratio=10.0,
        motion="rotary",
    )  # fmt: skip


def played(world: World, plant: OdePlant | MujocoPlant = ODE) -> Signals:
    (signals,) = plant.play(world)
    return signals


def torque(world: World, signals: Signals) -> Array:
    return np.asarray(world.motor.torque_per_A * signals.current)


def speed(signals: Signals) -> Array:
    return np.asarray(np.gradient(signals.angle, 1.0 / RATE_HZ))


def twist(world: World, signals: Signals) -> Array:
    return np.asarray(signals.motor_angle / world.motor.gear_ratio - signals.angle)


@pytest.fixture(scope="module")
def plain() -> tuple[World, Signals]:
    world = world_of()
    return world, played(world)


def test_a_stuck_joint_is_exactly_still_and_lets_go_at_the_static_limit(
    plain: tuple[World, Signals],
) -> None:
    world, signals = plain
    still = np.flatnonzero(np.diff(signals.angle[:1500]) == 0.0)
    assert len(still) > 100
    first = int(np.flatnonzero(np.diff(signals.angle) != 0.0)[0])
    before = np.abs(torque(world, signals)[: first + 1])
    assert before.max() == pytest.approx(world.constants.Ms, rel=0.02)


def test_sliding_friction_is_eq_9(plain: tuple[World, Signals]) -> None:
    world, signals = plain
    c, w = world.constants, speed(signals)
    moving = (np.abs(w) > 0.3) & (np.arange(len(w)) > 4000)
    law = c.Mc + (c.Ms - c.Mc) * np.exp(-((w / c.omega_sf) ** 2)) + c.sigma_2 * np.abs(w)
    acceleration = np.gradient(np.convolve(w, np.ones(21) / 21.0, mode="same"), 1.0 / RATE_HZ)
    left = torque(world, signals) - c.J * acceleration - np.sign(w) * law
    assert np.sqrt(np.mean(left[moving][:-50] ** 2)) < 0.02 * c.Mc


def test_events_do_not_chatter(plain: tuple[World, Signals]) -> None:
    signals = plain[1]
    signs = np.sign(np.diff(signals.angle))
    turns = np.count_nonzero(np.diff(signs[signs != 0.0]))
    assert turns <= 4


def test_it_agrees_with_mujoco_on_the_nominal_machine(plain: tuple[World, Signals]) -> None:
    """Two formulations of one machine in two different drives: the same torque at each speed."""
    pytest.importorskip("mujoco")
    world, ours = plain
    for loaded in ({}, {"weight_kg": 20.0}, {"pendulum": Pendulum(5.0, 0.1, -1.0)}):
        one = replace(world, recordings=world_of(**loaded).recordings)  # type: ignore[arg-type]
        curves = []
        for signals in (played(one) if loaded else ours, played(one, MujocoPlant())):
            w, at = speed(signals), signals.command
            inside = (w > 0.5) & (np.abs(at) < 0.1) & (np.arange(len(w)) > 4000)
            curves.append(np.mean(torque(one, signals)[inside]))
        assert curves[0] == pytest.approx(curves[1], rel=0.02)


def test_play_and_twist_are_as_wide_as_they_say() -> None:
    world = world_of({"backlash": {"gap_rad": 0.01}})
    gap = twist(world, played(world))[4000:]
    assert np.ptp(np.quantile(gap, (0.05, 0.95))) == pytest.approx(0.01, rel=0.1)
    world = world_of({"compliance": {"stiffness_Nm_rad": 3000.0}})
    signals = played(world)
    forward = speed(signals) > 0.4
    share = world.motor.friction_share
    passed = (1.0 - share) * torque(world, signals)[forward] / twist(world, signals)[forward]
    assert np.median(passed) == pytest.approx(3000.0, rel=0.1)


def test_loops_of_a_lossy_coupling_do_not_depend_on_speed() -> None:
    world = world_of({"coupling_hysteresis": {"torque_Nm": 4.0, "deflection_rad": 2e-3}})
    signals = played(world)
    bent, push = twist(world, signals)[4000:], torque(world, signals)[4000:]
    loop = abs(float(np.trapezoid(push, bent)))
    plain = world_of({"compliance": {"stiffness_Nm_rad": 6000.0}})
    other = played(plain)
    narrow = abs(float(np.trapezoid(torque(plain, other)[4000:], twist(plain, other)[4000:])))
    assert loop > 2.0 * narrow


def test_bristles_bend_and_rest_strengthens() -> None:
    world = world_of({"presliding": {"stiffness_Nm_rad": 1500.0}})
    signals = played(world)
    w = np.convolve(speed(signals), np.ones(9) / 9.0, mode="same")
    friction = torque(world, signals) - 0.2 * np.gradient(w, 1.0 / RATE_HZ) - 5.0 * w
    at = int(np.flatnonzero(np.abs(signals.angle) > 2e-3)[0])
    bent = 12.0 * (1.0 - np.exp(-1500.0 * 2e-3 / 12.0))
    assert abs(np.mean(friction[at - 8 : at + 9])) == pytest.approx(bent, rel=0.2)
    aged = world_of({"dwell_static_friction": {"growth_Nm": 5.0, "time_s": 0.02}}, kind="pd")
    plain = world_of(kind="pd")
    rises = [np.abs(torque(w, played(w))[:2500]).max() for w in (aged, plain)]
    assert rises[0] - rises[1] == pytest.approx(5.0, rel=0.3)


def test_electric_effects_are_in_the_voltage(plain: tuple[World, Signals]) -> None:
    signals = plain[1]

    def more(effect: str, **given: float) -> float:
        other = played(world_of({effect: given}))
        both = (speed(signals) > 0.4) & (speed(other) > 0.4) & (signals.current > 1.0)
        return float(np.median((other.voltage - signals.voltage)[both]))

    assert more("inverter_dead_time", voltage_V=1.5) == pytest.approx(1.5, rel=0.1)
    assert more("brush_drop", voltage_V=1.5, current_A=0.2) == pytest.approx(1.5, rel=0.1)
    assert more("winding_heating", rise_K_per_W=20.0, time_s=0.5) > 0.5
    assert more("supply_sag", resistance_ohm=2.0) > 0.1


def test_every_effect_plays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "LONGEST_S", drawing.SHORTEST_S)
    monkeypatch.setattr(drawing, "MOST", 3)
    from identification.effects import MOTION

    assert ODE.effects <= {e.name for e in MOTION}
    for n, name in enumerate(sorted({*ODE.effects, *ODE.outside})):
        world = draw_world("one", (name,), (31, n))
        last = world.recordings[-1]
        torque = None if last.torque is None else last.torque[:600]
        short = replace(last, command=last.command[:600], torque=torque, lead_s=0.0)
        signals = played(replace(world, recordings=(short,)))
        assert np.isfinite(signals.current).all()
        assert np.isfinite(signals.angle).all()
