"""Eq. 1, the gear, the lever and the limits of the drive, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.effects import kernel, table
from drivers.mock.plant.effects.friction import WORK_SIZE
from drivers.mock.plant.effects.pack import effect_vector
from drivers.mock.plant.machine import SimulatedMachine, drive_vector, friction_vector, simulate
from drivers.mock.plant.parts import loops
from drivers.mock.plant.parts.constants import Joint, Loops, Machine, Sensing

MACHINE = Machine(sensing=Sensing(0, 0, 0.0))
RESISTANCE, INDUCTANCE, EMF, TORQUE_PER_AMPERE = 1.56, 0.00132, 0.02588 * 100.0, 0.03 * 100.0
LOCKED = Joint(Mc_N_m=1e9, Ms_N_m=1e9)
FRICTIONLESS = Joint(Mc_N_m=0.0, Ms_N_m=0.0, sigma_2_N_m_s_rad=0.0)


def at_constant_voltage(
    machine: Machine, voltage: float, periods: int, speed: float = 0.0
) -> np.ndarray:
    """State after each loop period, shape (periods, states)."""
    s = np.zeros(loops.STATE_SIZE)
    s[loops.OMEGA] = speed
    d, p = drive_vector(machine), friction_vector(machine.joint, 0.0)
    x, w, e = np.zeros(table.EXTRA_SIZE), np.zeros(WORK_SIZE), effect_vector(machine)
    w[: len(p)] = p
    decay = float(np.exp(-0.5 * RESISTANCE * d[loops.LOOP_S] / d[loops.STEPS] / INDUCTANCE))
    out = np.empty((periods, loops.STATE_SIZE))
    for k in range(periods):
        kernel.integrate(s, x, d, w, e, voltage, True, decay, RESISTANCE)
        out[k] = s
    return out


def friction_magnitude(speed: float, weight_kg: float) -> float:
    system = 6.825 + (12.025 - 6.825) * np.exp(-((speed / 0.0557) ** 2)) + 5.3462 * speed
    load = 0.052 + (0.086 - 0.052) * np.exp(-((speed / 0.0326) ** 2)) + 0.032 * speed
    return float(system + 0.095 * 10.0 * weight_kg * 9.80665 * load)


def test_current_of_a_locked_shaft_rises_as_eq_1_says() -> None:
    machine = replace(MACHINE, joint=LOCKED)
    states = at_constant_voltage(machine, 12.0, 100)
    time = np.arange(1, 101) / machine.loops.rate_Hz
    expected = 12.0 / RESISTANCE * (1.0 - np.exp(-time * RESISTANCE / INDUCTANCE))
    assert states[:, loops.CURRENT] == pytest.approx(expected, rel=1e-12)
    assert np.all(states[:, loops.OMEGA] == 0.0)


def test_back_emf_takes_its_part_of_the_voltage_at_constant_speed() -> None:
    machine = replace(MACHINE, joint=replace(FRICTIONLESS, inertia_kg_m2=1e12))
    states = at_constant_voltage(machine, 12.0, 400, speed=2.0)
    assert states[-1, loops.OMEGA] == pytest.approx(2.0, abs=1e-9)
    assert states[-1, loops.CURRENT] == pytest.approx((12.0 - EMF * 2.0) / RESISTANCE, rel=1e-9)


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
        np.sign(speed) * friction_magnitude(abs(speed), weight), rel=1e-8
    )


def test_weight_presses_with_the_lever_ratio() -> None:
    """Eq. 17: F'_P = (L3/L4) m_w g, so that hanging 30.6 kg is pressing with 3001 N."""
    hung, pressed = (simulate(MACHINE, np.sin, 0.4, 1000.0, **how) for how in HOW_LOADED)
    assert np.array_equal(hung["current"], pressed["current"])


HOW_LOADED = ({"weight_kg": 30.6}, {"contact_force_N": 10.0 * 30.6 * 9.80665})


def test_current_stays_within_its_limit() -> None:
    machine = replace(MACHINE, loops=replace(Loops(), current_limit_A=10.0))
    out = simulate(machine, lambda t: np.where(t > 0.1, 1.0, 0.0), 0.4, 20000.0)
    assert np.max(np.abs(out["current"])) > 9.9
    assert np.max(np.abs(out["current"])) < 10.0 * 1.05  # the current loop's own overshoot


def test_lowered_current_limit_holds_the_torque_below_the_static_limit() -> None:
    machine = SimulatedMachine(MACHINE, np.random.default_rng(0))
    machine.limit_current(0.9 * 12.025 / TORQUE_PER_AMPERE)
    machine.power(True)
    machine.track(0.5e6, 1_000_000)  # 0.5 rad: with exact sensors a count is 1 urad
    machine.advance(300_000_000)
    assert machine.truth().angle_rad == 0.0
    assert machine.truth().current_A == pytest.approx(0.9 * 12.025 / TORQUE_PER_AMPERE, rel=1e-3)


@pytest.mark.parametrize(("limit", "supply"), [(6.0, 60.0), (60.0, 6.0)])
def test_voltage_stays_within_the_lower_of_limit_and_supply(limit: float, supply: float) -> None:
    machine = replace(MACHINE, loops=replace(Loops(), voltage_limit_V=limit), supply_V=supply)
    out = simulate(machine, lambda t: np.where(t > 0.1, 1.0, 0.0), 0.3, 20000.0)
    assert np.max(np.abs(out["voltage"])) == pytest.approx(6.0)
    assert np.max(np.abs(out["current"])) <= 6.0 / RESISTANCE + 1e-9


def test_power_off_leaves_no_current() -> None:
    machine = SimulatedMachine(MACHINE, np.random.default_rng(0))
    machine.power(True)
    machine.follow(1.0 * np.arange(1, 4001) / 20000.0)
    assert abs(machine.truth().current_A) > 2.0
    machine.power(False)
    machine.latch()
    machine.advance(1_000_000)
    assert machine.truth().current_A == 0.0
    reading = machine.latch()
    assert (reading.current_A, reading.voltage_V, reading.following_error_counts) == (0.0, 0.0, 0.0)


def test_power_on_again_holds_where_the_shaft_is() -> None:
    machine = SimulatedMachine(MACHINE, np.random.default_rng(0))
    machine.power(True)
    machine.follow(1.0 * np.arange(1, 4001) / 20000.0)
    machine.power(False)
    machine.advance(500_000_000)
    rest = machine.truth().angle_rad
    machine.track(0.0, 1_000_000)  # ignored: the power is off
    machine.power(True)
    machine.advance(500_000_000)
    assert machine.truth().angle_rad == rest
