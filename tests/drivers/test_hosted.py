"""Anybody's machine behind the simulated drive: against the own plant, its limits, its errors."""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.errors import ConfigurationError, MachineError
from drivers.mock.bench import simulated_bench
from drivers.mock.plant.hosted import FmuPlant, HostedMachine, Plant, PlantFile, python_plant
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Loops, Machine, Sensing
from drivers.mock.without_bus import record

from .fmus import build_fmu
from .machines.nominal import Nominal

HERE = Path(__file__)
NOMINAL = HERE.parent / "machines" / "nominal.py"
CYCLE_NS = 1_000_000


def hosted(plant: object, machine: Machine | None = None, seed: int = 3) -> HostedMachine:
    rng = np.random.default_rng(1)
    return HostedMachine(machine or Machine(), rng, PlantFile(cast(Plant, plant), HERE), seed)


def swing(seconds: float, rate_Hz: float = 1000.0) -> np.ndarray:
    """The command of Fig. 10, which begins with its first second."""
    time = np.arange(round(seconds * rate_Hz)) / rate_Hz
    ramp = np.minimum(time, 1.0)
    return np.asarray(np.deg2rad(20.0) * ramp * np.sin(0.4 * np.pi * time))


class Fine(Nominal):
    steps_per_call = 8


EXACT = Machine(sensing=Sensing(0, 0, 0.0))
"""With exact sensors the drive's loops have no limit cycle, which would amplify any difference."""
TOLERANCES = {
    "angle": 2e-6,
    "motor_angle": 2e-4,
    "velocity": 5e-4,
    "current": 0.02,
    "voltage": 0.04,
}
"""Greatest rms difference, SI units; the resolution of the current is 0.015 A."""


def differences(plant: Nominal, seconds: float, weight_kg: float) -> dict[str, np.ndarray]:
    """The same command on the own plant and on a machine of the test: what differs, by channel."""
    found = []
    for machine in (SimulatedMachine(EXACT, np.random.default_rng(1)), hosted(plant, EXACT)):
        machine.hang(weight_kg)
        machine.power(True)
        found.append(record(machine, swing(seconds)))
    own, other = found
    assert np.ptp(own.angle) > 0.3
    assert np.ptp(own.current) > 6.0
    return {name: getattr(own, name) - getattr(other, name) for name in TOLERANCES}


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def agree(plant: Nominal, seconds: float, weight_kg: float) -> None:
    found = differences(plant, seconds, weight_kg)
    for name, bound in TOLERANCES.items():
        assert rms(found[name]) < bound, name
    # What remains is around the breakaways, which a step later or earlier shifts.
    assert np.percentile(np.abs(found["current"]), 98) < 0.04


@pytest.mark.parametrize("weight_kg", [0.0, 30.6])
def test_the_loops_around_it_are_those_of_the_own_plant(weight_kg: float) -> None:
    agree(Fine(), 2.5, weight_kg)


@pytest.mark.proof
@pytest.mark.parametrize("weight_kg", [0.0, 30.6])
def test_a_whole_run_of_figure_10_agrees_with_the_own_plant(weight_kg: float) -> None:
    agree(Fine(), 20.0, weight_kg)


def test_the_difference_is_the_step_of_the_other_integrator() -> None:
    coarse, fine = (differences(plant, 2.5, 30.6)["angle"] for plant in (Nominal(), Fine()))
    assert rms(fine) < 0.4 * rms(coarse)


class Noted(Nominal):
    """Notes what it gets."""

    def __init__(self) -> None:
        self.seeds: list[int] = []
        self.masses: list[float] = []
        self.periods: set[float] = set()
        self.voltages: list[float] = []

    def reset(self, seed: int) -> None:
        self.seeds.append(seed)
        super().reset(seed)

    def hang(self, mass_kg: float) -> None:
        self.masses.append(mass_kg)
        super().hang(mass_kg)

    def step(self, dt_s: float, voltage_V: float) -> tuple[float, float, float, float]:
        self.periods.add(dt_s)
        self.voltages.append(voltage_V)
        return super().step(dt_s, voltage_V)


def test_it_gets_seed_mass_and_the_voltage_of_each_loop_period() -> None:
    plant = Noted()
    machine = hosted(plant, seed=11)
    machine.hang(12.5)
    machine.power(True)
    record(machine, swing(0.2))
    assert plant.seeds == [11]
    assert plant.masses == [0.0, 12.5]
    (period,) = plant.periods
    assert period == pytest.approx(5e-5, rel=1e-12)
    assert len(plant.voltages) == 1 + 20 * 200
    assert np.std(plant.voltages) > 0.1


def test_without_power_it_gets_no_voltage_and_with_a_stuck_stage_it_does() -> None:
    plant = Noted()
    machine = hosted(plant)
    machine.power(True)
    machine.track(2e4, 50 * CYCLE_NS)
    machine.advance(40 * CYCLE_NS)
    assert machine.truth().velocity_rad_s > 0.1
    machine.stuck = True
    machine.power(False)
    plant.voltages.clear()
    machine.advance(CYCLE_NS)
    assert machine.powered
    assert all(plant.voltages)
    machine.stuck = False
    machine.power(False)
    plant.voltages.clear()
    machine.advance(300 * CYCLE_NS)
    assert not machine.powered
    assert set(plant.voltages) == {0.0}
    assert machine.truth().velocity_rad_s == 0.0
    assert machine.truth().current_A == 0.0


@pytest.mark.parametrize(("supply_V", "limit_V", "most_V"), [(6.0, 60.0, 6.0), (60.0, 8.0, 8.0)])
def test_rail_and_limit_of_the_drive_bound_the_voltage(supply_V, limit_V, most_V):
    plant = Noted()
    own = Machine(supply_V=supply_V, loops=Loops(voltage_limit_V=limit_V))
    machine = hosted(plant, own)
    machine.power(True)
    machine.track(1e6, CYCLE_NS)
    machine.advance(100 * CYCLE_NS)
    assert max(plant.voltages) == most_V


def test_the_current_limit_bounds_the_current() -> None:
    found = []
    for limit_A in (25.0, 6.0):
        machine = hosted(Nominal())
        machine.limit_current(limit_A)
        machine.power(True)
        machine.track(1e5, CYCLE_NS)
        machine.advance(20 * CYCLE_NS)
        found.append(machine.truth().current_A)
    assert found[0] > 10.0
    assert found[1] == pytest.approx(6.0, abs=0.5)


def test_swapped_phases_turn_the_motor_the_other_way() -> None:
    """Each loop sees the current that it drives; the speed loop is told of the swap, as the
    motor encoder in the mistake ``motor_encoder`` is.
    """
    angles, currents = [], []
    for swapped in (False, True):
        machine = hosted(Nominal())
        if swapped:
            machine.reverse("phases")
            machine.reverse("velocity")  # the sign that the loop had before
        machine.control(position=False, speed=False)
        machine.power(True)
        machine.feed(8.0)
        machine.advance(30 * CYCLE_NS)
        angles.append(machine.truth().angle_rad)
        currents.append(machine.truth().current_A)
    assert angles[0] > 1e-3
    assert angles[1] == pytest.approx(-angles[0], rel=1e-6)
    assert currents[1] == pytest.approx(currents[0], rel=1e-6)


class Turned(Nominal):
    """At rest 0.5 rad from zero."""

    def reset(self, seed: int) -> None:
        super().reset(seed)
        self.angle = 0.5


def test_it_may_start_at_another_angle() -> None:
    machine = hosted(Turned())
    machine.power(True)
    machine.advance(20 * CYCLE_NS)
    seen = machine.latch()
    assert machine.truth().angle_rad == pytest.approx(0.5, abs=1e-4)
    assert seen.motor_counts == pytest.approx(0.5 / machine.motor_count_rad, abs=2)
    assert seen.joint_counts == pytest.approx(0.5 / machine.joint_count_rad, abs=4)
    assert abs(seen.current_A) < 0.5


def broken(how: Callable[[float], Any]) -> type[Nominal]:
    """A machine that goes wrong after 10 ms."""

    class Broken(Nominal):
        def reset(self, seed: int) -> None:
            super().reset(seed)
            self.steps = 0

        def step(self, dt_s: float, voltage_V: float) -> Any:
            self.steps += 1
            good = super().step(dt_s, voltage_V)
            return how(voltage_V) if self.steps > 200 else good

    return Broken


def line_of(text: str) -> int:
    """Number of the first line of this file with a text."""
    return next(n for n, line in enumerate(HERE.read_text().splitlines(), 1) if text in line)


@pytest.mark.parametrize(
    ("how", "line", "said"),
    [
        (lambda _: 1 / 0, "(lambda _: 1 / 0", "ZeroDivisionError"),
        (lambda _: int("x"), '(lambda _: int("x")', "ValueError"),
        (lambda _: None, "def step(self, dt_s: float, voltage_V: float) -> Any", "None"),
        (lambda _: (0.0, 0.0, 0.0), "def step(self, dt_s: float, voltage_V: float) -> Any", "(0.0"),
        (lambda _: (0.0,) * 5, "def step(self, dt_s: float, voltage_V: float) -> Any", "(0.0"),
        (lambda _: (0.0, math.nan, 0.0, 0.0), "voltage_V: float) -> Any", "nan"),
        (lambda _: (0.0, 0.0, math.inf, 0.0), "voltage_V: float) -> Any", "inf"),
        (lambda _: ("a", "b", "c", "d"), "voltage_V: float) -> Any", "'a'"),
        (lambda _: (0.0, 1j, 0.0, 0.0), "voltage_V: float) -> Any", "1j"),
    ],
)
def test_an_error_names_its_line_and_the_machine_stands_still(how, line, said):
    plant = broken(how)()
    machine = hosted(plant)
    machine.power(True)
    machine.track(1e4, 50 * CYCLE_NS)
    with pytest.raises(MachineError) as failed:
        machine.advance(20 * CYCLE_NS)
    assert str(failed.value).startswith(f"{HERE}:{line_of(line)}: step")
    assert said in str(failed.value)
    steps = plant.steps
    machine.latch()
    machine.power(True)
    machine.hang(3.0)
    machine.advance(20 * CYCLE_NS)
    assert plant.steps == steps
    assert not machine.powered
    assert machine.truth().velocity_rad_s == 0.0
    seen = machine.latch()
    assert (seen.current_A, seen.voltage_V, seen.motor_velocity_rad_s) == (0.0, 0.0, 0.0)


def test_on_a_bus_the_error_is_raised_once_and_the_devices_go_on() -> None:
    file = PlantFile(cast(Plant, broken(lambda _: None)()), HERE)
    bench = simulated_bench(Machine(), 1, plant=file)
    bench.clock.sleep_until_ns(50 * CYCLE_NS)
    read_position = bytes.fromhex("4064600000000000")
    bench.bus.transmit(0x601, read_position)
    with pytest.raises(MachineError):
        bench.clock.sleep_until_ns(60 * CYCLE_NS)
    for _ in range(2):
        bench.bus.transmit(0x601, read_position)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + CYCLE_NS)
    answers = [frame for frame in bench.bus.collect(0.01) if frame[1] == 0x581]
    assert [answer[2][1:4] for answer in answers] == [read_position[1:4]] * 3


def test_an_error_in_reset_is_raised_at_once() -> None:
    class Sleepy(Nominal):
        def reset(self, seed: int) -> None:
            raise RuntimeError("out of bed")

    with pytest.raises(MachineError, match=rf"{HERE}:\d+: reset\(3\) raised RuntimeError: out of"):
        hosted(Sleepy())


GOOD = NOMINAL.read_text()
FILES = {
    "no class": ("", "Machine", ": has no class Machine; it has no class"),
    "other class": ("class Other:\n    pass\n", "Machine", ": has no class Machine; it has Other"),
    "no methods": ("\nclass M:\n    def reset(self, seed): ...\n", "M", ":2: class M lacks hang("),
    "syntax": ("x = 1\nx = = 2\n", "M", ":2: SyntaxError"),
    "import": ("x = 1\n\nimport nonesuch\n", "M", ":3: ModuleNotFoundError"),
    "exit": ("import sys\nsys.exit(3)\n", "M", ":2: SystemExit"),
    "constructor": ("class M:\n    def __init__(self):\n        1 / 0\n", "M", ":3: ZeroDivision"),
    "arguments": ("class M:\n    def __init__(self, a): ...\n", "M", ": TypeError"),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_holds_no_machine_is_refused_with_its_line(case: str, tmp_path: Path) -> None:
    text, name, said = FILES[case]
    path = tmp_path / "machine.py"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as refused:
        python_plant(path, name)
    assert str(refused.value).startswith(f"{path}{said}")


def test_a_file_is_read_anew_and_may_import_what_is_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "machine.py"
    (tmp_path / "beside_machine.py").write_text("NUMBER = 4\n")
    for number in (1, 2):
        path.write_text(
            f"{GOOD}\n\nimport beside_machine\n\nclass M(Nominal):\n    mine = {number}\n"
        )
        assert vars(type(python_plant(path, "M").plant))["mine"] == number
    with pytest.raises(ConfigurationError, match="No such file"):
        python_plant(tmp_path / "none.py", "M")


FMU_RUN = replace(Machine(), sensing=Sensing(current_noise_A=0.0))


def needs_fmpy() -> None:
    """Skip where the package of the extra `fmu` is not installed."""
    pytest.importorskip("fmpy")


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_gives_the_samples_of_the_same_equations_in_python(fmi: int, tmp_path: Path) -> None:
    needs_fmpy()
    plant = FmuPlant(build_fmu(tmp_path / "machine.fmu", fmi))
    found = []
    for machine in (hosted(plant, FMU_RUN, seed=0), hosted(Nominal(), FMU_RUN)):
        machine.hang(30.6)
        machine.power(True)
        found.append(record(machine, swing(0.5)))
        assert machine.truth().angle_rad > 1e-3
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    seeded = hosted(plant, FMU_RUN, seed=7).truth()
    assert seeded.angle_rad == 0.0
    assert plant.step(5e-5, 0.0)[3] == pytest.approx(7e-3)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_that_fails_says_why(fmi: int, tmp_path: Path) -> None:
    needs_fmpy()
    path = build_fmu(tmp_path / "machine.fmu", fmi)
    machine = HostedMachine(Machine(), np.random.default_rng(1), PlantFile(FmuPlant(path), path), 0)
    machine.hang(100.0)
    with pytest.raises(MachineError) as failed:
        machine.advance(CYCLE_NS)
    assert str(failed.value).startswith(
        f"{path}: step(5e-05, 0) raised RuntimeError: fmi{fmi}DoStep"
    )
    assert "the lever breaks" in str(failed.value)


def test_an_fmu_that_ends_the_simulation_is_an_error(tmp_path: Path) -> None:
    needs_fmpy()
    machine = hosted(FmuPlant(build_fmu(tmp_path / "machine.fmu", 3)))
    machine.hang(77.0)
    with pytest.raises(MachineError, match="ends the simulation"):
        machine.advance(CYCLE_NS)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("built", "said"),
    [
        (
            {"renamed": {"current_A": "i", "mass_kg": "m"}},
            "mass_kg (input or parameter), current_A",
        ),
        ({"kind": "ModelExchange"}, "is no FMU for co-simulation"),
        ({"integer": "voltage_V"}, "voltage_V"),
        (
            {"renamed": {"voltage_V": "current_A", "current_A": "voltage_V"}},
            "variables voltage_V (input), current",
        ),
    ],
)
def test_an_fmu_that_does_not_fit_is_refused(fmi, built, said, tmp_path):
    needs_fmpy()
    path = build_fmu(tmp_path / "machine.fmu", fmi, **built)
    with pytest.raises(ConfigurationError) as refused:
        FmuPlant(path)
    assert str(refused.value).startswith(str(path))
    assert said in str(refused.value)


def test_a_file_that_is_no_fmu_is_refused(tmp_path: Path) -> None:
    needs_fmpy()
    path = tmp_path / "machine.fmu"
    path.write_text("nothing")
    with pytest.raises(ConfigurationError, match="cannot be used as an FMU"):
        FmuPlant(path)


def test_without_the_package_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'loadrig\[fmu\]'"):
        FmuPlant(tmp_path / "machine.fmu")
