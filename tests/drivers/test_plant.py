"""The true machine against closed forms: friction, motor, motion under the loops, sensing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from drivers.mock.plant.effects import kernel, table
from drivers.mock.plant.effects.friction import WORK_SIZE, step_slipping
from drivers.mock.plant.effects.pack import effect_vector
from drivers.mock.plant.machine import SimulatedMachine, drive_vector, friction_vector, simulate
from drivers.mock.plant.parts import loops
from drivers.mock.plant.parts.constants import Joint, Loops, Machine, Sensing
from drivers.mock.plant.parts.friction import friction

MACHINE = Machine(sensing=Sensing(0, 0, 0.0))
JOINT = Joint()
STEP_S = 25e-6
FORCES_N = (0.0, 3000.0)

NO_EFFECTS = effect_vector(Machine())


def step_velocity(
    speed: float, held: float, torque: float, force_N: float
) -> tuple[float, float, float]:
    w = np.zeros(WORK_SIZE)
    p = friction_vector(JOINT, force_N)
    w[: len(p)] = p
    return step_slipping(speed, held, torque, STEP_S, w, NO_EFFECTS)


def magnitude(speed: float, force_N: float) -> float:
    """Eq. 9 and 13 with the printed values, written out."""
    system = 6.825 + (12.025 - 6.825) * math.exp(-((speed / 0.0557) ** 2)) + 5.3462 * speed
    load = 0.052 + (0.086 - 0.052) * math.exp(-((speed / 0.0326) ** 2)) + 0.032 * speed
    return system + force_N * 0.095 * load


def exact_machine() -> SimulatedMachine:
    return SimulatedMachine(MACHINE, np.random.default_rng(0))


@given(speed=st.floats(0.0, 3.0), force=st.floats(0.0, 5000.0))
def test_magnitude_is_eq_9_plus_13(speed: float, force: float) -> None:
    found, _ = friction(speed, friction_vector(JOINT, force))
    assert found == pytest.approx(magnitude(speed, force), rel=1e-13)


@given(share=st.floats(-1.0, 1.0), force=st.floats(0.0, 5000.0))
def test_shaft_at_rest_stays_exactly_there_below_the_static_limit(share, force):
    static = magnitude(0.0, force)
    torque = math.copysign(min(abs(share), 1.0 - 1e-12) * static, share)
    speed, impulse, held = step_velocity(0.0, static, torque, force)
    assert speed == 0.0
    assert impulse == 0.0
    assert held == pytest.approx(static)


@given(
    excess=st.floats(1e-3, 50.0), side=st.sampled_from([-1.0, 1.0]), force=st.floats(0.0, 5000.0)
)
def test_shaft_breaks_away_just_above_it_toward_the_torque(excess, side, force):
    static = magnitude(0.0, force)
    speed, _, _ = step_velocity(0.0, static, side * (static + excess), force)
    assert side * speed > 0.0


@given(
    speed=st.floats(-2.0, 2.0).filter(lambda v: abs(v) > 1e-6),
    torque=st.floats(-80.0, 80.0),
    force=st.floats(0.0, 5000.0),
)
def test_one_step_conserves_momentum_and_never_passes_through_zero(speed, torque, force):
    p = friction_vector(JOINT, force)
    after, impulse, _ = step_velocity(speed, friction(abs(speed), p)[0], torque, force)
    assert after * speed >= 0.0
    assert impulse >= 0.0
    if after != 0.0:
        change = JOINT.inertia_kg_m2 * (after - speed)
        assert change == pytest.approx(torque * STEP_S - math.copysign(impulse, speed), abs=1e-12)


@pytest.mark.parametrize("force", FORCES_N)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_sliding_below_coulomb_stops_and_holds_without_chatter(force: float, side: float) -> None:
    p = friction_vector(JOINT, force)
    torque = (
        side * 0.999 * magnitude(0.0, force)
    )  # below Ms, far above Mc: the worst case for a regularised law
    speed, held = side * 0.01, friction(0.01, p)[0]
    speeds = []
    for _ in range(20000):
        speed, _, held = step_velocity(speed, held, -torque, force)
        speeds.append(speed)
    stopped = speeds.index(0.0)
    assert 0 < stopped < 1000
    assert all(v * side > 0.0 for v in speeds[:stopped])
    assert all(v == 0.0 for v in speeds[stopped:])


@pytest.mark.parametrize("force", FORCES_N)
def test_coasting_loses_exactly_its_kinetic_energy_over_the_distance_of_the_closed_form(force):
    machine = exact_machine()
    machine.press(force)
    machine.power(True)
    machine.follow(1.2 * np.arange(1, 6001) / 20000.0)
    machine.power(False)
    start = machine.truth()
    machine.advance(400_000_000)
    stop = machine.truth()
    inertia = JOINT.inertia_kg_m2
    kinetic = 0.5 * inertia * start.velocity_rad_s**2
    assert start.velocity_rad_s > 1.0
    assert stop.velocity_rad_s == 0.0
    assert stop.friction_work_J - start.friction_work_J == pytest.approx(kinetic, rel=1e-6)
    distance, _ = integrate.quad(
        lambda v: inertia * v / magnitude(v, force), 0.0, start.velocity_rad_s
    )
    assert stop.angle_rad - start.angle_rad == pytest.approx(distance, rel=1e-6)


def test_electrical_torque_work_is_kinetic_energy_plus_friction_work() -> None:
    machine = exact_machine()
    machine.power(True)
    time = np.arange(1, 40001) / 20000.0
    path = 0.3 * np.sin(2.0 * np.pi * time) * np.minimum(time, 1.0) ** 2
    torque_per_ampere = 0.03 * 100.0
    work = angle = dissipated = 0.0
    for target in np.split(path, len(path)):
        machine.follow(target)
        current, now = machine.latch().current_A, machine.truth()
        work += torque_per_ampere * current * (now.angle_rad - angle)
        assert now.friction_work_J >= dissipated
        angle, dissipated = now.angle_rad, now.friction_work_J
        kinetic = 0.5 * JOINT.inertia_kg_m2 * now.velocity_rad_s**2
        # Twice the speed in a period times half the torque's change in it: order h^2 over the run.
        assert work == pytest.approx(kinetic + dissipated, abs=1e-6)
    assert dissipated > 10.0


RESISTANCE, INDUCTANCE, EMF, TORQUE_PER_AMPERE = 1.56, 0.00132, 0.02588 * 100.0, 0.03 * 100.0
FRICTIONLESS = Joint(Mc_N_m=0.0, Ms_N_m=0.0, sigma_2_N_m_s_rad=0.0)


def at_constant_voltage(machine: Machine, voltage: float, periods: int) -> np.ndarray:
    """State after each loop period, shape (periods, states)."""
    s = np.zeros(loops.STATE_SIZE)
    d, p = drive_vector(machine), friction_vector(machine.joint, 0.0)
    x, w, e = np.zeros(table.EXTRA_SIZE), np.zeros(WORK_SIZE), effect_vector(machine)
    w[: len(p)] = p
    decay = float(np.exp(-0.5 * RESISTANCE * d[loops.LOOP_S] / d[loops.STEPS] / INDUCTANCE))
    out = np.empty((periods, loops.STATE_SIZE))
    for k in range(periods):
        kernel.integrate(s, x, d, w, e, voltage, True, decay, RESISTANCE)
        out[k] = s
    return out


def test_free_motor_runs_up_as_the_second_order_system_of_eq_1() -> None:
    machine = replace(MACHINE, joint=FRICTIONLESS, steps_per_loop=4)
    states = at_constant_voltage(machine, 12.0, 20000)
    matrix = np.array(
        [
            [-RESISTANCE / INDUCTANCE, -EMF / INDUCTANCE],
            [TORQUE_PER_AMPERE / machine.joint.inertia_kg_m2, 0.0],
        ]
    )
    poles, vectors = np.linalg.eig(matrix)
    settled = np.array([0.0, 12.0 / EMF])
    time = np.arange(1, 20001) / machine.loops.rate_Hz
    parts = np.linalg.solve(vectors, -settled)
    expected = (vectors @ (parts[:, None] * np.exp(poles[:, None] * time))).real + settled[:, None]
    assert np.max(np.abs(states[:, loops.OMEGA] - expected[1])) < 1e-5
    assert np.max(np.abs(states[:, loops.CURRENT] - expected[0])) < 1e-3


@pytest.mark.parametrize("weight", [0.0, 10.0, 30.6])
@pytest.mark.parametrize("speed", [0.2, 1.0, -0.5])
def test_steady_sliding_current_balances_eq_9_and_13(weight: float, speed: float) -> None:
    out = simulate(MACHINE, lambda t: speed * t, 1.5, 1000.0, weight)
    assert out["velocity"][-1] == pytest.approx(speed, rel=1e-9)
    torque = TORQUE_PER_AMPERE * out["current"][-1]
    assert torque == pytest.approx(
        np.sign(speed) * magnitude(abs(speed), 10.0 * weight * 9.80665), rel=1e-8
    )


def test_weight_presses_with_the_lever_ratio() -> None:
    """Eq. 17: F'_P = (L3/L4) m_w g, so that hanging 30.6 kg is pressing with 3001 N."""
    how = ({"weight_kg": 30.6}, {"contact_force_N": 10.0 * 30.6 * 9.80665})
    hung, pressed = (simulate(MACHINE, np.sin, 0.4, 1000.0, **load) for load in how)
    assert np.array_equal(hung["current"], pressed["current"])


@pytest.mark.parametrize(("limit", "supply"), [(6.0, 60.0), (60.0, 6.0)])
def test_voltage_stays_within_the_lower_of_limit_and_supply(limit: float, supply: float) -> None:
    machine = replace(MACHINE, loops=replace(Loops(), voltage_limit_V=limit), supply_V=supply)
    out = simulate(machine, lambda t: np.where(t > 0.1, 1.0, 0.0), 0.3, 20000.0)
    assert np.max(np.abs(out["voltage"])) == pytest.approx(6.0)
    assert np.max(np.abs(out["current"])) <= 6.0 / RESISTANCE + 1e-9


def test_power_on_again_holds_where_the_shaft_is() -> None:
    machine = exact_machine()
    machine.power(True)
    machine.follow(1.0 * np.arange(1, 4001) / 20000.0)
    assert abs(machine.truth().current_A) > 2.0
    machine.power(False)
    machine.latch()
    machine.advance(500_000_000)
    assert machine.truth().current_A == 0.0
    assert machine.latch()[3:5] == (0.0, 0.0)
    rest = machine.truth().angle_rad
    machine.track(0.0, 1_000_000)  # ignored: the power is off
    machine.power(True)
    machine.advance(500_000_000)
    assert machine.truth().angle_rad == rest


SOFT = replace(MACHINE, loops=replace(Loops(), velocity_gain_N_m_s_rad=None, position_gain=400.0))
ENCODER_RAD = 2.0 * np.pi / 409600.0


def sine(time: np.ndarray) -> np.ndarray:
    return np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * np.clip(time, 0.0, 1.0) ** 2


def rests(velocity: np.ndarray) -> np.ndarray:
    """Length in samples of each stretch at exactly zero speed."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (velocity == 0.0).astype(int), [0]))))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize(
    ("machine", "weight"), [(MACHINE, 30.6), (SOFT, 0.0)], ids=["stiff, loaded", "soft"]
)
def test_halving_the_step_changes_less_than_an_encoder_step(machine, weight):
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
    machine = exact_machine()
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
    machine = exact_machine()
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


CYCLE_NS = 1_000_000


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


def test_encoders_count_whole_steps_downwards() -> None:
    machine = SimulatedMachine(Machine(), np.random.default_rng(1))
    machine.power(True)
    for k in range(400):
        machine.follow(0.3 * np.sin(2.0 * np.pi * (k * 20 + np.arange(1, 21)) / 4000.0))
        angle, reading = machine.truth().angle_rad, machine.latch()
        assert reading.motor_counts == math.floor(angle * 100.0 * 4096.0 / (2.0 * math.pi))
        assert reading.joint_counts == math.floor(angle * 262144.0 / (2.0 * math.pi))
