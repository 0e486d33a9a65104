"""The simulated machine of a bench file follows the bench; its current loop is judged."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Loops, Machine, Motor, Sensing
from rig.common.yaml_tree import parse
from rig.config.bench import Bench, load_bench
from rig.config.configuration import resolve
from rig.config.simulated_machine import derived, unstable_current_loop
from rig.wiring.connect import connect

SMALL = """\
bench: 1
name: small
machine: {torque_constant_N_m_A: 0.0259, back_emf_constant_V_s_rad: 0.0259, resistance_ohm: 0.6,
          inductance_H: 0.0002, gear_ratio: 51, moment_arm_m: 0.15, lever_ratio: 1}
servo: {counts_per_motor_turn: 2048, rated_current_A: 3.2, rated_torque_N_m: 0.083}
encoder: {counts_per_turn: 65536}
cycle_Hz: 500
limits: {angle_min_deg: -30, angle_max_deg: 30, speed_deg_s: 120, torque_N_m: 6.6, current_A: 5,
         following_error_deg: 2, encoder_disagreement_deg: 1, weight_kg: 8, contact_force_N: 100,
         supply_min_V: 20, supply_max_V: 28}
"""


def small(folder: Path, extra: str = "") -> Bench:
    path = folder / "small.yaml"
    path.write_text(SMALL + extra)
    return load_bench(path).value


def test_a_bench_without_mock_is_simulated_as_the_file_describes_it(tmp_path: Path) -> None:
    mock = small(tmp_path).mock
    assert mock.motor.gear_ratio == 51
    assert (mock.motor.resistance_ohm, mock.motor.inductance_H) == (0.6, 0.0002)
    assert (mock.joint.moment_arm_m, mock.joint.lever_ratio) == (0.15, 1)
    assert (mock.supply_V, mock.loops.voltage_limit_V, mock.loops.current_limit_A) == (24, 24, 5)
    assert (mock.sensing.motor_counts_per_turn, mock.sensing.joint_counts_per_turn) == (2048, 65536)
    assert mock.sensing.cycle_s == 0.002
    share = 6.6 / 75
    assert mock.joint.Mc_N_m == pytest.approx(6.825 * share)
    assert mock.joint.inertia_kg_m2 == pytest.approx(0.204 * share)
    assert unstable_current_loop(mock) is None


def test_what_the_file_says_of_the_simulated_machine_wins(tmp_path: Path) -> None:
    stated = "mock: {motor: {gear_ratio: 50}, joint: {Mc_N_m: 0.7}, supply_V: 22}\n"
    mock = small(tmp_path, stated).mock
    assert (mock.motor.gear_ratio, mock.motor.resistance_ohm) == (50, 0.6)
    assert (mock.joint.Mc_N_m, mock.supply_V, mock.loops.voltage_limit_V) == (0.7, 22, 22)


def test_the_derived_machine_of_the_practical_bench_is_the_default_one(tmp_path: Path) -> None:
    text = resolve("practical", "benches").read_text()
    path = tmp_path / "b.yaml"
    path.write_text(text.split("mock:  ")[0])
    assert load_bench(path).value.mock == Machine()


def test_the_simulated_drive_rates_what_the_bench_says(tmp_path: Path) -> None:
    small(tmp_path)
    with connect(load_bench(tmp_path / "small.yaml"), 0, False) as devices:
        devices.prepare(0.002)
        own = devices.servo.read_limits()
    # Its unit of current is a thousandth of 3.2 A, rounded up: a limit of the file is never looser.
    assert 5.0 <= own.current_A <= 5.0 + 3.2e-3
    torque_per_ampere = 0.0259 * 51
    assert 5.0 * torque_per_ampere <= own.torque_N_m <= 5.0 * torque_per_ampere + 0.083 * 51e-3


@given(st.floats(0.01, 20.0), st.floats(1e-6, 0.1))
def test_the_derived_current_loop_is_stable_whatever_the_motor(resistance, inductance):
    tree, _ = parse(f"machine: {{resistance_ohm: {resistance!r}, inductance_H: {inductance!r}}}")
    parts = derived(tree.plain())
    motor, loops = parts["motor"], parts["loops"]
    assert isinstance(motor, dict)
    assert isinstance(loops, dict)
    assert unstable_current_loop(Machine(motor=Motor(**motor), loops=Loops(**loops))) is None


WINDING = Motor(
    resistance_ohm=0.6,
    inductance_H=1e-4,
    torque_constant_N_m_A=0.02,
    back_emf_constant_V_s_rad=0.02,
)


def machine(motor: Motor, gain: float, **loops: float) -> Machine:
    return Machine(
        motor=motor,
        loops=Loops(current_gain_V_A=gain, **loops),
        sensing=Sensing(current_noise_A=1e-6),
    )


def swing(bench: Machine) -> float:
    """Return how far the current swings at rest, A, with noise of a microampere to set it off."""
    plant = SimulatedMachine(bench, np.random.default_rng(0))
    plant.power(True)
    greatest = 0.0
    for _ in range(200):
        plant.advance(plant.loop_ns)
        greatest = max(greatest, abs(plant.latch().current_A))
    return greatest


def edge(motor: Motor, **loops: float) -> float:
    """Return the gain at the edge of stability, by bisection on the verdict."""
    low, high = 1e-3, 1e4
    for _ in range(60):
        middle = (low * high) ** 0.5
        low, high = (
            (middle, high)
            if unstable_current_loop(machine(motor, middle, **loops)) is None
            else (low, middle)
        )
    return low


@pytest.mark.parametrize(
    ("motor", "rate_Hz"),
    [
        (Motor(), 8000.0),
        (WINDING, 20000.0),
        (dataclasses.replace(WINDING, inductance_H=1e-5), 8000.0),
    ],
)
def test_both_sides_of_the_edge_in_the_simulation(motor: Motor, rate_Hz: float) -> None:
    gain = edge(motor, rate_Hz=rate_Hz)
    assert swing(machine(motor, 0.9 * gain, rate_Hz=rate_Hz)) < 1e-3
    assert swing(machine(motor, 1.1 * gain, rate_Hz=rate_Hz)) > 0.05


def test_the_paper_s_motor_is_stable_with_a_wide_margin() -> None:
    assert unstable_current_loop(Machine()) is None
    assert edge(Motor()) > 5 * Loops().current_gain_V_A


def test_the_words_name_a_gain_that_is_stable() -> None:
    words = unstable_current_loop(machine(WINDING, 5.0))
    assert (
        "with 0.0001 H and 0.6 ohm at 20000 Hz the current loop of the simulated drive is unstable"
        in words
    )
    advised = float(words.split("lower the gain to ")[1].split(" or less")[0])
    assert unstable_current_loop(machine(WINDING, advised)) is None
    assert swing(machine(WINDING, advised)) < 1e-3


def test_a_motor_without_inductance_is_judged_too() -> None:
    bare = dataclasses.replace(WINDING, inductance_H=0.0)
    assert unstable_current_loop(machine(bare, 0.1)) is None
    assert unstable_current_loop(machine(bare, 5.0)) is not None
