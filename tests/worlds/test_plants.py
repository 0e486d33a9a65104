"""The three machines of the laboratory against one another.

The voltage that the own plant's drive asks for is given to the third plant's machine, so that both
machines have the same input whatever their drives do. MuJoCo's machine is in the first tests alone.
"""

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
from benchmarks.worlds.own_plant.machine import OF_THE_WORLD
from benchmarks.worlds.own_plant.plant import OwnPlant
from benchmarks.worlds.third.kernel import replay
from benchmarks.worlds.third.plant import OdePlant, initial_state, values_of
from benchmarks.worlds.torque import Course
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


@pytest.fixture(scope="module")
def plain() -> tuple[World, Signals]:
    world = world_of()
    return world, played(world)


def test_a_stuck_joint_is_exactly_still_and_lets_go_at_the_static_limit(plain):
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

        def fits(k: int) -> bool:
            world = draw_world("nothing", (), (77, k))
            asked = load or world.axes["load"]
            return (world.drive.kind, world.motion, world.axes["load"]) == (kind, motion, asked)

        with pytest.MonkeyPatch.context() as still:
            # The courses of the motions, which change no kind, take most of the time.
            still.setattr(drawing, "command", lambda *_: np.linspace(0.0, 0.1, 50))
            still.setattr(drawing, "course", lambda *_: Course(*np.zeros((2, 50))))
            first = next(filter(fits, range(400)))
        world = draw_world("nothing", (), (77, first))
    return replace(
        world,
        sensing=replace(world.sensing, current_noise_A=0.0, flicker=0.0),
        log=replace(world.log, clock=False),
    )


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
    Case("stray_loss", {"coefficient_Nms_A2rad": 0.05}),
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
    Case("constant_torque", {"torque_Nm": 3.0}),
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
        "torque_ripple", "inverter_dead_time", "backlash", "encoder_ripple", "gear_friction",
        "gear_mesh_ripple",
        "coupling_hysteresis",
    }
)  # fmt: skip
"""Effects that the plants define differently; closed forms of the own one are in tests/drivers."""


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


@pytest.mark.parametrize("gap_rad", [0.01, 0.003])
def test_a_gap_is_as_wide_in_both(gap_rad: float) -> None:
    """Teeth in contact are stiff, 700 Hz, and 250 Hz in the third plant."""
    own, other, _ = both(quiet(effects={"backlash": {"gap_rad": gap_rad}}))
    for motions, tolerance in ((own, 0.02), (other, 0.08)):
        twist = (motions.rotor - motions.joint)[4000:]
        width = np.ptp(np.quantile(twist, (0.05, 0.95)))
        assert width == pytest.approx(gap_rad, rel=tolerance)
