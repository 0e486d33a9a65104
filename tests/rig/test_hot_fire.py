"""Hot firings: planned, refused, run in the open and the closed loop, tripped, read back."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import Clock
from identification.model.gas_generator import GasGenerator, equilibrium_pressure, throat_area
from identification.model.parameters import NOMINAL
from identification.prepare import contact_force
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.config.sequence import FlowController, FlowSection, FlowStep, load_sequence
from rig.control.operator import AutomaticOperator
from rig.control.remote import RunProgress
from rig.control.safety import Check
from rig.control.session import Inputs, execute
from rig.planning.hot_fire import LawState, Regulator, angle_for, control, make_law, pressure_for
from rig.planning.plan import make_plan
from rig.planning.reference import Reference
from rig.runs.mcap.reader import read_run
from rig.runs.run import load_run, read_record
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton
from rig.weighing.weight_check import comparable, off_label
from rig.wiring.connect import connect

from .benches import variant

STEPS = "{steps: [{at_s: 0, flow_kg_s: 1.8}, {at_s: 1.5, flow_kg_s: 1.2}], ramp_s: 0.2}"
HOT = f"""\
sequence: 1
name: hot
stages:
  - {{name: sine, stage: hot_fire, tones: [{{amplitude_deg: 10, frequency_Hz: 1}}], duration_s: 1.5,
     ramp_in_s: 0.3, ramp_out_s: 0.3}}
  - {{name: flow, stage: hot_fire, role: validate, flow: {STEPS}, duration_s: 4}}
  - {{name: empty, stage: unloaded, tones: [{{amplitude_deg: 10, frequency_Hz: 1}}],
     duration_s: 1.5,
     ramp_in_s: 0.3, ramp_out_s: 0.3}}
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hot.yaml").write_text(HOT)


@pytest.fixture(scope="module")
def fired(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fired")
    (folder / "hot.yaml").write_text(HOT)
    arguments = [str(folder / "hot.yaml"), *BENCH, "--yes", "--out", str(folder / "run")]
    assert status(["run", *arguments]) == 0
    return folder / "run"


BENCH = ("--bench", "practical_hot")


def problems(bench: str | Path) -> str:
    with pytest.raises(InputError) as caught:
        make_plan(load_sequence("hot.yaml"), load_bench(bench))
    return "\n".join(caught.value.problems)


def test_the_chamber_pressure_is_logged_and_loads_the_valve(fired: Path) -> None:
    sine, flow, empty = load_run(fired).recordings
    assert "pressure" not in empty.channels
    assert [r.role for r in (sine, flow, empty)] == ["fit", "validate", "fit"]
    for recording in (sine, flow):
        assert recording.hot_fire
        assert recording.stage == "loaded"
        angle = recording.channels["angle"]
        force = contact_force(recording, recording.time, angle)
        generator = recording.bench.gas_generator
        assert generator == GasGenerator()
        steady = equilibrium_pressure(throat_area(angle, generator.valve), generator)
        # Between the steady pressures of the least and the greatest throat it came by.
        assert 0.98 * steady.min() < recording.channels["pressure"].min()
        assert recording.channels["pressure"].max() < 1.02 * steady.max()
        assert force.max() > 1000.0


def test_the_closed_loop_brings_the_flow_asked_for(fired: Path) -> None:
    flow = load_run(fired).recordings[1]
    g = GasGenerator()
    for end, wanted in ((1.5, 1.8), (4.0, 1.2)):
        late = (flow.time - flow.time[0] > end - 0.3) & (flow.time - flow.time[0] < end)
        assert late.any()
        pressure = flow.channels["pressure"][late].mean()
        found = g.rho_b * g.A_b * g.a * (pressure * 1e-6) ** g.n
        assert found == pytest.approx(wanted, rel=0.02)
    assert np.ptp(flow.channels["command"]) > math.radians(4.0)


def test_the_run_says_that_no_weight_was_hung(fired: Path) -> None:
    record = read_record(fired)
    assert [(s.stage, s.weight_kg, s.confirmed_kg) for s in record.stages[:2]] == [
        ("hot_fire", 0.0, 0.0)
    ] * 2
    assert record.parts[0].devices["pressure"]["product_code"] == 0x404
    assert "pressure.eds" in record.inputs
    events = [event["event"] for event in read_run(fired / "recording.mcap").events]
    assert events.count("ignition") == 2
    assert events.index("prompt") < events.index("ignition") < events.index("stage start")


def test_a_bench_without_transmitter_says_what_it_lacks() -> None:
    found = problems("practical")
    assert "hot.yaml:4:25: stages[0].stage: a hot firing is loaded by its chamber pressure" in found
    assert status(["run", "hot.yaml", "--yes"]) == 2


CONTROLLER = "ramp_s: 0.2, controller: {angle_min_deg: 31}}"
WIDE = "ramp_s: 0.2, controller: {angle_max_deg: 89}}"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("stage: hot_fire, role: validate, flow", "stage: loaded, weight_kg: 3, flow", "a flow"),
        ("stage: hot_fire, tones", "role: validate, stage: hot_fire, tones", "flow is loaded and"),
        ("at_s: 0,", "at_s: 1,", "the first step must be at 0 s"),
        ("ramp_s: 0.2}", CONTROLLER, "angle_min_deg 31"),
        ("ramp_s: 0.2}", WIDE, "flow.controller.angle_max_deg: the controller may command"),
        ("flow_kg_s: 1.2", "flow_kg_s: 0.5", "flow_kg_s: outside 0.7526 to 2.159 kg/s"),
        ("  pressure_MPa: 6\n", "", "`pressure` needs limits.pressure_MPa"),
        ("pressure_MPa: 6", "pressure_MPa: 11", "at most pressure.range_MPa 10"),
        ("pressure_MPa: 6", "pressure_MPa: 4", "the pressure would rise to 4.37 MPa"),
        ("force_N: 4000", "force_N: 2900", "2964 N is above the bench limit contact_force_N 2900"),
        ("exponent: 0.53\n    ch", "exponent: 1.0\n    ch", "no chamber pressure is stable"),
        ("bitrate: 1000000", "bitrate: 500000", "lower cycle_Hz"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_burns(old: str, new: str, words: str) -> None:
    bench: str | Path = "practical_hot"
    if old in HOT:
        Path("hot.yaml").write_text(HOT.replace(old, new, 1))
    else:
        bench = variant(Path(), (old, new), source="practical_hot")
    assert words in problems(bench)


def test_too_much_pressure_ends_the_run_and_takes_the_power_off() -> None:
    """The bench believes in a wider hole than there is."""
    Path("hot.yaml").write_text(HOT.split("  - {name: flow")[0])
    wider = ("  hole_diameter_m: 0.025", "  hole_diameter_m: 0.030")
    bench = variant(Path(), wider, ("pressure_MPa: 6", "pressure_MPa: 4"), source="practical_hot")
    assert status(["run", "hot.yaml", "--bench", str(bench), "--yes", "--out", "tripped"]) == 1
    record = read_record(Path("tripped"))
    assert record.trip["check"] == "chamber pressure"
    assert record.de_energised is True


def test_a_transmitter_in_another_unit_stops_before_power() -> None:
    bench = variant(Path(), ("unit_Pa: 100", "unit_Pa: 1000"), source="practical_hot")
    assert status(["run", "hot.yaml", "--bench", str(bench), "--yes", "--out", "unit"]) == 4
    told = read_record(Path("unit")).message
    assert "one unit of the pressure is 100 Pa, but the bench file states 1000 Pa" in told


def test_its_friction_is_not_held_against_a_weight(fired: Path) -> None:
    dataset = load_run(fired)
    assert not comparable(dataset)
    assert (
        off_label(
            dataset, Reference(NOMINAL, dict.fromkeys(NOMINAL, 1e-4), 2.0, 9.3163, "known.json")
        )
        == []
    )


def test_a_transmitter_that_falls_silent_ends_the_run() -> None:
    """Its process data stop, its heartbeat goes on."""
    bench, sequence = load_bench("practical_hot"), load_sequence("hot.yaml")
    plan = make_plan(sequence, bench)

    def attach(simulated: Any) -> Clock:
        def lose(
            time_ns: int, identifier: int, data: bytes, _sent: bool
        ) -> tuple[int, bytes] | None:
            return None if identifier == 0x184 and time_ns > 1_200_000_000 else (identifier, data)

        simulated.bus.frame_filters.append(lose)
        return simulated.clock  # type: ignore[no-any-return]

    folder = Path("silent")
    folder.mkdir()
    progress = RunProgress(plan.cycle_s, plan.duration_s)
    with connect(bench, 0, False, attach) as devices:
        inputs = Inputs(bench, sequence, 0, False)
        _, outcome = execute(
            inputs, plan, devices, folder, AutomaticOperator(), StopButton(), progress
        )
    assert outcome.ending is Ending.FAILED
    assert outcome.trip.check is Check.SAMPLE_AGE
    assert outcome.safe.verified
    assert outcome.trip.time == pytest.approx(1.2, abs=0.02)


CYCLE_S = 1e-3
LAW = make_law(FlowController(), CYCLE_S, math.radians(120.0))


def held(angle: float, pressure: float) -> LawState:
    return LawState(pressure, angle, angle)


def test_pressure_as_wanted_leaves_the_valve_where_it_is() -> None:
    state = held(0.2, 2e6)
    assert control(LAW, state, 2e6, 2e6) == state


def test_too_much_pressure_opens_the_valve_by_gain_and_integral() -> None:
    state = held(0.2, 2e6)
    wanted = 2e6 / math.exp(0.005)
    after = control(LAW, state, wanted, 2e6)
    assert after.angle - 0.2 == pytest.approx(
        math.radians(8.0) * 0.005 * (1.0 + 8.0 * CYCLE_S), rel=1e-9
    )


def test_at_its_bound_the_integral_waits() -> None:
    state = held(LAW.most, 2e6)
    for _ in range(5000):
        state = control(LAW, state, 0.5e6, 2e6)
    assert state.angle == LAW.most
    assert state.integral == LAW.most
    # Once the pressure falls below what is wanted, it leaves the bound at once.
    state = LawState(0.4e6, state.integral, state.angle)
    assert control(LAW, state, 0.5e6, 0.4e6).angle < LAW.most


def test_from_outside_its_range_it_comes_back_at_its_own_speed() -> None:
    state = held(-0.1, 2e6)
    after = control(LAW, state, 2e6, 2e6)
    assert after.angle == pytest.approx(-0.1 + LAW.step)


@given(
    angle=st.floats(0.0, LAW.most),
    pressure=st.floats(1e5, 1e7),
    wanted=st.floats(1e5, 1e7),
    reading=st.floats(-1e6, 2e7),
)
def test_it_always_stays_in_range_and_below_its_speed(angle, pressure, wanted, reading):
    after = control(LAW, held(angle, pressure), wanted, reading)
    assert LAW.least <= after.angle <= LAW.most
    assert abs(after.angle - angle) <= LAW.step * (1.0 + 1e-9)


def test_the_regulator_starts_where_the_valve_is_and_answers_each_sample() -> None:
    regulator = Regulator(LAW, [2e6] * 3, 0.2)
    targets = regulator.targets()
    assert next(targets) == 0.2
    regulator.see(Sample(*[0.0] * 16, 2e6))  # type: ignore[arg-type]
    assert next(targets) == pytest.approx(0.2)
    regulator.see(Sample(*[0.0] * 16, 4e6))  # type: ignore[arg-type]
    assert next(targets) > 0.2


def test_a_flow_asks_for_its_pressure_and_angle() -> None:
    g = GasGenerator()
    angles = np.deg2rad([6.0, 15.0, 25.0])
    pressure = equilibrium_pressure(throat_area(angles, g.valve), g, exact=False)
    flow = g.rho_b * g.A_b * g.a * (pressure * 1e-6) ** g.n
    np.testing.assert_allclose(pressure_for(flow, g), pressure, rtol=1e-12)
    np.testing.assert_allclose(angle_for(flow, g), angles, atol=1e-5)
    # Beyond what the valve gives, the nearest angle at which its throat changes.
    assert np.rad2deg(angle_for(np.array([5.0, 0.1]), g)) == pytest.approx([4.23, 29.65], abs=0.02)


def test_the_command_goes_from_step_to_step() -> None:
    steps = (FlowStep(at_s=0.0, flow_kg_s=1.0), FlowStep(at_s=1.0, flow_kg_s=2.0))
    command = FlowSection(steps=steps, ramp_s=0.2).command(2.0, CYCLE_S)
    assert command.shape == (2000,)
    np.testing.assert_allclose(command[[0, 1000, 1100, 1200, 1999]], [1.0, 1.0, 1.5, 2.0, 2.0])
    np.testing.assert_allclose(
        FlowSection(steps=steps, ramp_s=0.0).command(2.0, CYCLE_S)[[1000, 1001]], [1.0, 2.0]
    )
