"""The three machines of the laboratory against one another, and against closed forms.

The voltage that the own plant's drive asks for is given to the third plant's machine, so that both
machines have the same input whatever their drives do. Where the two define an effect differently,
closed forms say what each of them has. MuJoCo's machine is in the first tests alone; its own
properties are in ``test_mujoco_plant``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.draw import draw_world
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.own_plant.machine import OF_THE_WORLD, STIFF_HZ
from benchmarks.worlds.own_plant.plant import OwnPlant
from benchmarks.worlds.third.kernel import replay
from benchmarks.worlds.third.plant import OdePlant, initial_state, values_of
from benchmarks.worlds.world import (
    COMMAND_S,
    Array,
    LoopKind,
    Motion,
    Pendulum,
    Planned,
    Signals,
    World,
)
from drivers.mock.plant.effects.table import CATALOGUE

pytestmark = pytest.mark.proof
RATE_HZ = 4000
ODE = OdePlant()


def world_of(
    effects: Mapping[str, Mapping[str, float]] = {},
    kind: str = "cascade",
    command: Array | None = None,
    **recording: object,
) -> World:
    """Return a quiet machine of the valve's size with one recording of a slow sine."""
    t = np.arange(3000) * COMMAND_S
    slow = 0.3 * np.minimum(t / 0.5, 1.0) * np.sin(np.pi * t)
    command = slow if command is None else command
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


OWN = OwnPlant()
INNER_S = 3e-5
Effects = Mapping[str, Mapping[str, float]]
NOTHING: Effects = {}
LOADS: Mapping[str, Mapping[str, object]] = {
    "none": {},
    "lever": {"weight_kg": 20.0},
    "pendulum": {"pendulum": Pendulum(5.0, 0.1, -1.0)},
    "hoisted": {"hoisted_kg": 0.5},
    "force": {"pull_N_m": 4.0},
}


class Motions(NamedTuple):
    """Current, A, and angles of the motor's side and of the joint, rad, at each period of the
    loops.
    """

    current: Array
    rotor: Array
    joint: Array


def quiet(load: str = "none", effects: Effects = NOTHING, kind: LoopKind = "cascade") -> World:
    """Return the machine of the valve's size, without friction on the motor's side, with a fine
    encoder.
    """
    world = world_of(effects, kind, **LOADS[load])
    return replace(
        world,
        motor=replace(world.motor, friction_share=0.0),
        sensing=replace(world.sensing, motor_bits=24),
    )


def both(world: World, k: int = 0) -> tuple[Motions, Motions, Array]:
    """Return recording ``k`` of the own plant, of the third plant at the same voltage, and that
    voltage.
    """
    signals = list(OWN.play(world))[k]
    rate = world.drive.rate_Hz
    own = Motions(signals.current, signals.motor_angle / world.motor.gear_ratio, signals.angle)
    out = np.zeros((3, len(signals.voltage)))
    inner = math.ceil(1.0 / (rate * INNER_S))
    start = initial_state(world, k)
    replay(values_of(world, k, 0.0), start, inner, 1.0 / rate, signals.voltage, out)
    return own, Motions(*out), signals.voltage


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def gap(own: Array, other: Array) -> float:
    return rms(own - other) / rms(own)


def between(values: Array) -> Array:
    return np.asarray(0.5 * (values[1:] + values[:-1]))


@pytest.mark.parametrize("motion", ["rotary", "linear"])
@pytest.mark.parametrize("kind", ["cascade", "pd", "torque", "host"])
def test_drawn_machines_without_effects_agree(kind: LoopKind, motion: Motion) -> None:
    for load in ("lever", "pendulum") if motion == "rotary" else ("hoisted", "carriage"):
        world = drawn(kind, motion, load)
        starts = tuple(replace(r, lead_s=0.0) for r in world.recordings)
        world = replace(world, recordings=starts)
        for k in range(len(starts)):
            own, other, _ = both(world, k)
            assert gap(own.current, other.current) < 1e-4
            assert gap(own.joint, other.joint) < 1e-4
            assert np.ptp(own.joint) > 0.0


@pytest.mark.parametrize("load", LOADS)
def test_every_load_agrees(load: str) -> None:
    own, other, _ = both(quiet(load))
    assert gap(own.current, other.current) < 1e-5
    assert gap(own.joint, other.joint) < 5e-5


class Case(NamedTuple):
    """An effect that both plants define alike, and the greatest rms difference of its traces in the
    current, over the trace.
    """

    name: str
    given: Mapping[str, float]
    tolerance: float = 5e-3
    load: str = "none"


WAVE = {"per_motor_turn": 2.0, "phase_rad": 0.3}
CASES = (
    Case("cogging", {"torque_Nm": 1.0, **WAVE}),
    Case("torque_saturation", {"knee_A": 12.0}),
    Case("torque_saturation", {"knee_A": 12.0, "rational": 1.0}),
    Case("current_loop_lag", {"time_s": 3e-3}),
    # The current passes through the brushes' curve within a period.
    Case("brush_drop", {"voltage_V": 1.5, "current_A": 0.5}, 0.03),
    Case("winding_heating", {"rise_K_per_W": 20.0, "time_s": 5.0, "magnet": 0.0}, 0.02),
    Case("supply_sag", {"resistance_ohm": 2.0}),
    # The own plant's shaft has another damping, 0.08 in place of 0.03.
    Case("compliance", {"stiffness_Nm_rad": 3000.0}, 0.02),
    Case("transmission_efficiency", {"efficiency": 0.8}),
    Case("asymmetric_coulomb", {"torque_Nm": 1.0}),
    Case("asymmetric_viscous", {"coefficient_Nms_rad": 1.0}),
    Case("quadratic_drag", {"coefficient_Nms2_rad2": 3.0}),
    Case("stribeck_shape", {"alpha": 1.0}),
    Case("friction_memory", {"time_s": 0.03, "of_speed": 1.0}),
    # They forget a rest after 1 mrad, or above four Stribeck speeds.
    Case("dwell_static_friction", {"growth_Nm": 4.0, "time_s": 0.05}, 0.02),
    # LuGre's bristles are damped, Dahl's are not.
    Case("presliding", {"stiffness_Nm_rad": 3000.0}, 0.02),
    Case("position_dependent_friction", {"torque_Nm": 2.0, "center_rad": 0.1, "width_rad": 0.05}),
    Case("viscous_thermal_drift", {"fraction": 0.5, "time_s": 3.0}),
    Case("coulomb_drift", {"rate_Nm_s": 0.3, "time_s": 3.0}),
    Case("gravity_imbalance", {"torque_Nm": 3.0, "zero_rad": 0.5}),
    Case("return_spring", {"stiffness_Nm_rad": 10.0, "rest_rad": 0.1}),
    # The own plant's stop is damped, 2 ms times its stiffness.
    Case("end_stop", {"angle_rad": 0.2, "stiffness_Nm_rad": 100.0}, 0.02),
    Case("end_stop", {"angle_rad": -0.2, "stiffness_Nm_rad": 100.0}, 0.02),
    Case("end_stop", {"angle_rad": -0.2, "stiffness_Nm_rad": 100.0, "other_rad": 0.2}, 0.02),
    Case("load_exponent", {"exponent": 1.2}, load="lever"),
    Case("load_position_dependence", {"slope_per_rad": 1.0}, load="lever"),
    Case("wrong_weight", {"mass_kg": 25.0, "recording": 1.0}, load="lever"),
    Case("load_swing", {"fraction": 0.3, "frequency_Hz": 1.0, "decay_s": 5.0}, load="lever"),
    Case("load_inertia", {"inertia_kgm2": 0.2}, load="lever"),
    Case("lever_pivot_friction", {"torque_Nm": 2.0}, load="lever"),
    Case("load_dependent_friction", {"coefficient": 0.2}, load="pendulum"),
    Case("load_dependent_friction", {"coefficient": 0.2}, load="hoisted"),
    Case("x_timed_torque", {"torque_Nm": 1.0, "frequency_Hz": 3.0, "phase_rad": 0.2}),
    # The own plant's drag follows the acceleration with 2.5 ms.
    Case("x_acceleration_drag", {"coefficient_Nms2_rad": 0.06}, 0.1),
)
APART = frozenset(
    {
        "torque_ripple", "inverter_dead_time", "backlash", "gear_mesh_ripple",
        "coupling_hysteresis",
    }
)  # fmt: skip
"""Effects that the plants define differently; each has a closed form below."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.load}")
@pytest.mark.parametrize("kind", ["cascade", "pd"])
def test_the_trace_of_an_effect_agrees(case: Case, kind: LoopKind) -> None:
    plain, plain_other, _ = both(quiet(case.load, NOTHING, kind))
    own, other, _ = both(quiet(case.load, {case.name: case.given}, kind))
    trace = own.current - plain.current
    found = other.current - plain_other.current
    assert rms(trace) > 100.0 * rms(plain.current - plain_other.current)
    assert rms(trace - found) < case.tolerance * rms(trace)


def test_every_effect_of_the_machine_is_compared() -> None:
    assert set(OWN.effects) == CATALOGUE.keys()
    compared = {case.name for case in CASES} | APART
    assert set(OWN.effects) - compared == OF_THE_WORLD - {"wrong_weight"}


def ohm(world: World, voltage: Array, motions: Motions, flux: Array | float = 1.0) -> Array:
    """Return the voltage that resistance, inductance and back-EMF leave, means over the periods."""
    m, rate = world.motor, world.drive.rate_Hz
    left = voltage[:-1] - m.resistance_ohm * between(motions.current)
    left -= m.inductance_H * np.diff(motions.current) * rate
    return np.asarray(left - m.torque_per_A * np.diff(motions.rotor) * rate * flux)


def unbalanced(world: World, motions: Motions, lever: Array | float = 1.0) -> tuple[Array, Array]:
    """Return the torque that inertia and friction leave, at the inner periods, and where the joint
    slides.
    """
    c, rate = world.constants, world.drive.rate_Hz
    w = np.diff(motions.joint) * rate
    mean = between(w)
    level = c.Mc + (c.Ms - c.Mc) * np.exp(-((mean / c.omega_sf) ** 2))
    drive = world.motor.torque_per_A * motions.current[1:-1] * lever
    left = drive - c.J * np.diff(w) * rate - np.sign(mean) * level - c.sigma_2 * mean
    return np.asarray(left), np.abs(mean) > 0.2


def test_a_rippled_magnet_ripples_the_back_emf_too() -> None:
    """The electrical power that turns into motion is the mechanical one; the third plant ripples
    the torque alone.
    """
    world = quiet(effects={"torque_ripple": {"fraction": 0.1, **WAVE}})
    own, other, voltage = both(world)
    for motions, emf in ((own, True), (other, False)):
        ripple = 1.0 + 0.1 * np.sin(2.0 * world.motor.gear_ratio * motions.rotor + 0.3)
        left, slides = unbalanced(world, motions, ripple[1:-1])
        flat, _ = unbalanced(world, motions)
        assert rms(left[slides]) < 0.2 * rms(flat[slides])
        right, wrong = (
            rms(ohm(world, voltage, motions, flux))
            for flux in ((between(ripple), 1.0) if emf else (1.0, between(ripple)))
        )
        assert right < 0.05 * wrong


def test_dead_time_holds_a_small_current_at_zero() -> None:
    """The third plant takes the sign of the current once in a period, and chatters there."""
    world = quiet(effects={"inverter_dead_time": {"voltage_V": 1.5}})
    own, other, voltage = both(world)
    weak = np.abs(voltage[:400]) < 1.5
    assert np.count_nonzero(weak) > 10
    assert not own.current[:400][weak].any()
    assert other.current[:400][weak].any()
    near = np.abs(between(own.current)) < 1.0
    far = np.convolve(near, np.ones(161), mode="same") < 0.5
    for motions in (own, other):
        lost = ohm(world, voltage, motions) - 1.5 * np.sign(between(motions.current))
        assert rms(lost[far]) < 0.01
    assert rms((own.current - other.current)[1:][far]) < 1e-5 * rms(own.current)


def test_a_mesh_error_is_kinematic_and_keeps_the_power() -> None:
    """The teeth's ratio varies by A n cos(n theta + p), and the torque with it; the third plant's
    error makes no torque.
    """
    wave = {"amplitude_rad": 1e-3, "per_turn": 20.0, "phase_rad": 0.3}
    world = quiet(effects={"gear_mesh_ripple": wave})
    own, other, _ = both(world)
    turn = 20.0 * own.joint + 0.3
    assert np.allclose(own.rotor - own.joint, 1e-3 * np.sin(turn), atol=1e-12)
    left, slides = unbalanced(world, own, (1.0 + 0.02 * np.cos(turn))[1:-1])
    without, _ = unbalanced(world, own)
    plain, _ = unbalanced(world, other)
    assert rms(left[slides]) < 1.1 * rms(plain[slides])
    assert rms(without[slides]) > 2.0 * rms(left[slides])


def test_the_exponent_is_that_of_both_stribeck_curves() -> None:
    """The catalogue's exponent is that of the curve under load too (eq. 13), as in the diagnosis;
    the third plant changes the curve without load (eq. 9) alone.
    """
    world = quiet("lever", {"stribeck_shape": {"alpha": 1.0}})
    c, moment = world.constants, world.contact_N(0) * world.moment_arm_m
    own, other, _ = both(world)
    for motions, under_load in ((own, 1.0), (other, 2.0)):
        w = np.diff(motions.joint) * RATE_HZ
        mean, left = between(w), {}
        for alpha in (1.0, 2.0):
            level = c.Mc + (c.Ms - c.Mc) * np.exp(-np.abs(mean / c.omega_sf))
            falls = np.exp(-(np.abs(mean / c.omega_sL) ** alpha))
            level += moment * (c.mu_c + (c.mu_s - c.mu_c) * falls + c.mu_2 * np.abs(mean))
            drive = world.motor.torque_per_A * motions.current[1:-1]
            torque = drive - c.J * np.diff(w) * RATE_HZ - np.sign(mean) * level - c.sigma_2 * mean
            slides = (np.abs(mean) > 0.02) & (np.abs(mean) < 0.1)
            left[alpha] = rms(torque[slides])
        assert left[under_load] < 0.2 * left[3.0 - under_load]


@pytest.mark.parametrize("gap_rad", [0.01, 0.003])
def test_a_gap_is_as_wide_in_both(gap_rad: float) -> None:
    """Teeth in contact are stiff, 700 Hz, and 250 Hz in the third plant."""
    own, other, _ = both(quiet(effects={"backlash": {"gap_rad": gap_rad}}))
    for motions, tolerance in ((own, 0.02), (other, 0.08)):
        twist = (motions.rotor - motions.joint)[4000:]
        width = np.ptp(np.quantile(twist, (0.05, 0.95)))
        assert width == pytest.approx(gap_rad, rel=tolerance)


def test_a_lossy_coupling_is_the_play_of_the_catalogue() -> None:
    """phi / i - theta = x sat(P / M_h), P the play of half width M_h along the torque."""
    world = quiet(effects={"coupling_hysteresis": {"torque_Nm": 4.0, "deflection_rad": 2e-3}})
    own = both(world)[0]
    rotor = world.motor.rotor_share * world.constants.J
    speed = np.gradient(own.rotor) * RATE_HZ
    torque = world.motor.torque_per_A * own.current - rotor * np.gradient(speed) * RATE_HZ
    torque = np.convolve(torque, np.ones(21) / 21.0, mode="same")
    play, now = np.zeros(len(torque)), 0.0
    for k, value in enumerate(torque):
        now = min(max(now, value - 4.0), value + 4.0)
        play[k] = now
    reduced = rotor * (1.0 - world.motor.rotor_share)
    spring = torque / (reduced * (2.0 * math.pi * STIFF_HZ) ** 2)
    expected = 2e-3 * np.clip(play / 4.0, -1.0, 1.0) + spring
    twist = own.rotor - own.joint
    assert rms((twist - expected)[200:-200]) < 0.02 * rms(twist)


def test_drifts_and_heat_go_on_through_a_session_on_one_clock() -> None:
    drift = {"coulomb_drift": {"rate_Nm_s": 0.3, "time_s": 30.0}}
    world = quiet(effects=drift)
    twice = tuple(replace(r, pause_s=10.0) for r in 2 * world.recordings)
    levels = {}
    for clock in (True, False):
        session = replace(world, log=replace(world.log, clock=clock), recordings=twice)
        played = list(OWN.play(session))
        levels[clock] = [float(np.mean(np.abs(s.current[4000:]))) for s in played]
        starts = [s.start_s for s in played]
        assert starts == ([10.0, 23.0] if clock else [0.0, 0.0])
    more = world.motor.torque_per_A * (levels[True][1] - levels[True][0])
    risen = [9.0 * (1.0 - math.exp(-t / 30.0)) for t in (12.0, 25.0)]
    assert more == pytest.approx(risen[1] - risen[0], rel=0.1)
    assert levels[False][0] == levels[False][1]


@pytest.mark.parametrize("sensed", ["current_noise_A", "flicker"])
def test_noise_of_the_drive_s_sensors_is_in_its_loops(sensed: str) -> None:
    world = quiet()
    noisy = replace(world, sensing=replace(world.sensing, motor_bits=12, **{sensed: 0.5}))
    coarse = replace(world, sensing=replace(world.sensing, motor_bits=12))
    (a,), (b,) = OWN.play(noisy), OWN.play(coarse)
    assert rms(a.voltage - b.voltage) > 0.05
    assert rms(a.angle - b.angle) < 0.01
    (again,) = OWN.play(noisy)
    assert np.array_equal(a.voltage, again.voltage)
