"""``rig commission``: step by step, at low limits."""

import io
import json
import math
import shutil
import signal
import sys
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.errors import LinkError
from drivers.interfaces import ServoState
from rig.cli.entry import status
from rig.commissioning.commission import STEPS, commission, patched
from rig.commissioning.moving import SMALL_DEG
from rig.commissioning.record import WrongError
from rig.commissioning.setup import FASTEST_DEG_S, Setup, TypedInterview
from rig.common.errors import StorageError
from rig.config.bench import load_bench
from rig.config.serial_bus import NO_WATCHDOG
from rig.control.cycle import Cycle
from rig.control.motion_proof import Change
from rig.runs.mcap.reader import read_run
from rig.runs.recorder import Recorder
from rig.runs.run_record import Ending
from rig.terminal.prompt import Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import device_files
from rig.wiring.teardown import SafeState

from .benches import variant
from .true_motion import watch_machines

PROOF = pytest.mark.proof
SLOW = (
    ("cycle_Hz: 1000", "cycle_Hz: 250"),
    ("sample_age_ms: 5", "sample_age_ms: 20"),
    ("name: practical", "name: new"),
)
"""A quarter of the cycles, to be quick."""
SLOW_SERIAL = (("cycle_Hz: 500", "cycle_Hz: 125"), ("sample_age_ms: 10", "sample_age_ms: 40"))
CORRECTED: dict[str, dict[str, Any]] = {
    "zero_off": {"encoder.offset_deg": -5.0},
    "rpm": {"servo.velocity_unit": "rpm"},
    "current_sign": {"servo.current_sign": -1},
    "encoder_sign": {"encoder.sign": -1},
    "ratio": {"machine.gear_ratio": 66.67},
    "torque_constant": {"machine.torque_constant_N_m_A": 0.06},
}
FOUND = {
    "another_device": ("identity", "the product 999h, but its EDS file is for the product 402h"),
    "limits_ignored": ("limits", "the drive does not accept this value"),
    "position_sign": ("signs", "the position loop or the speed loop of the drive"),
    "velocity_sign": ("signs", "the position loop or the speed loop of the drive"),
    "phases_swapped": ("signs", "two motor phases are swapped"),
    "motor_encoder": ("signs", "the motor encoder counts the other way"),
    "watchdog_dead": ("watchdog", "after this program went silent"),
    "stop_ignored": ("stop", "did not execute the quick stop"),
    "motor_shaft": ("small move", "both are on the same side of the gear"),
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    variant(tmp_path, *SLOW)
    return tmp_path


def commissioned(*options: str) -> tuple[int, dict[str, Any]]:
    ended = status(["commission", "bench.yaml", "--yes", "--out", "out", *options])
    return ended, json.loads(Path("out/commission.json").read_text())


def fastest_deg_s(gear_ratio: float) -> float:
    """Return the greatest joint speed over ten cycles, from the motor encoder."""
    found = [0.0]
    for path in Path("out").glob("recording*.mcap"):
        samples = read_run(path).samples
        if len(samples["time"]) > 10:
            angle, time = samples["motor_angle"], samples["time"]
            speed = (angle[10:] - angle[:-10]) / (time[10:] - time[:-10])
            found.append(float(np.max(np.abs(speed))))
    return math.degrees(max(found)) / gear_ratio


@pytest.mark.parametrize(
    "mistake",
    [
        *("zero_off", "current_sign", "ratio"),
        *(pytest.param(m, marks=PROOF) for m in ("rpm", "encoder_sign", "torque_constant")),
    ],
)
def test_a_wrong_value_is_found_and_corrected_in_a_new_file(here: Path, mistake: str) -> None:
    before = Path("bench.yaml").read_text()
    ended, record = commissioned("--angle", "0", "--mistake", mistake)
    assert (ended, record["state"]) == (0, "done"), record["message"]
    assert {c["key"] for c in record["changes"]} == set(CORRECTED[mistake])
    new = load_bench("bench.commissioned.yaml").value
    for key, value in CORRECTED[mistake].items():
        section, name = key.split(".")
        assert getattr(getattr(new, section), name) == (
            value if isinstance(value, str) else pytest.approx(value, rel=0.03)
        )
    assert Path("bench.yaml").read_text() == before
    assert Path("bench.commissioned.yaml").read_text().count("#") == before.count("#")
    assert f"+++ {Path('bench.yaml').name}" in Path("out/bench.patch").read_text()
    gear = 200 / 3 if mistake == "ratio" else 100.0
    assert fastest_deg_s(gear) < 1.5 * FASTEST_DEG_S
    assert record["drive"]["verified"]


@pytest.mark.parametrize("mistake", FOUND)
def test_what_no_value_corrects_ends_it(here, mistake, monkeypatch):
    true = watch_machines(monkeypatch)
    ended, record = commissioned("--angle", "0", "--mistake", mistake)
    assert (ended, record["state"]) == (1, "tripped")
    step, words = FOUND[mistake]
    last = record["sessions"][-1][-1]
    assert (last["name"], last["verdict"]) == (step, "wrong")
    assert words in last["words"]
    assert words in record["message"]
    assert record["new_bench_file"] is None
    assert not Path("bench.commissioned.yaml").exists()
    assert record["drive"] is None or record["drive"]["verified"]
    assert true.peak_deg_s < 1.5 * FASTEST_DEG_S
    if step == "signs":
        assert true.travel_deg < SMALL_DEG


@pytest.mark.parametrize(
    ("source", "slow"), [("practical_serial", SLOW_SERIAL), ("practical_dbc", ())]
)
def test_a_wrong_sign_is_found_on_every_kind_of_drive(source, slow, elsewhere, monkeypatch):
    true = watch_machines(monkeypatch)
    variant(elsewhere, *slow, source=source)
    ended, record = commissioned("--angle", "0", "--mistake", "phases_swapped")
    assert (ended, record["drive"]["verified"]) == (1, True)
    last = record["sessions"][-1][-1]
    step, words = FOUND["phases_swapped"]
    assert (last["name"], last["verdict"]) == (step, "wrong")
    assert words in last["words"]
    assert true.peak_deg_s < 0.5 * FASTEST_DEG_S
    assert true.travel_deg < SMALL_DEG


def test_what_nothing_protects_is_said_once_at_the_start(elsewhere, capsys):
    """A corrected value connects the bench a second time."""
    variant(elsewhere, *SLOW, ("servo: {node: 1", "servo: {stops_alone: false, node: 1"))
    ended, record = commissioned("--angle", "0", "--mistake", "zero_off")
    assert (ended, len(record["sessions"])) == (0, 2)
    told = capsys.readouterr()
    assert (told.err.count(NO_WATCHDOG), told.out.count(NO_WATCHDOG)) == (1, 0)


def test_a_right_bench_goes_through_all_steps(here: Path) -> None:
    ended, record = commissioned("--json", "copy.json", "--operator", "A. Person")
    assert ended == 0
    (steps,) = record["sessions"]
    assert [step["name"] for step in steps] == [step.name for step in STEPS]
    assert all(step["verdict"] == "good" for step in steps)
    assert record["schema"] == "loadrig.commission/1"
    assert json.loads(Path("copy.json").read_text()) == record
    assert (record["operator"], record["changes"]) == ("A. Person", [])
    events = [e["event"] for e in read_run(Path("out/recording.mcap")).events]
    assert events.count("step") == len(STEPS)
    assert events.count("power on") == events.count("power off")
    assert events.count("power on") > 5


def answers(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_each_step_that_needs_it_is_asked_for(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers(monkeypatch, "yes", "0,0", "yes", "perhaps", "no")
    assert status(["commission", "bench.yaml", "--out", "out"]) == 3
    record = json.loads(Path("out/commission.json").read_text())
    assert record["state"] == "stopped"
    assert [s["name"] for s in record["sessions"][0]] == [s.name for s in STEPS[:5]]
    assert "did not agree to this step" in record["message"]
    assert record["drive"] is None


def test_a_real_bench_takes_no_yes(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = Path("bench.yaml").read_text().split("mock:  ")[0]
    Path("real.yaml").write_text(text.replace("interface: mock", "interface: virtual"))
    assert status(["commission", "real.yaml", "--yes", "--out", "o"]) == 2
    assert "--yes agrees to every step, and this bench is real" in capsys.readouterr().err
    assert status(["commission", "real.yaml", "--mistake", "rpm", "--out", "o"]) == 2
    assert "works with simulated benches only" in capsys.readouterr().err
    assert not Path("o").exists()


@pytest.mark.parametrize(
    ("error", "ended", "state"),
    [(None, 3, "stopped"), (LinkError("bus-off"), 1, "tripped"), (RuntimeError("x"), 5, "crashed")],
)
def test_however_a_step_ends_the_drive_is_read_back_as_off(here, monkeypatch, error, ended, state):
    go = Setup.go

    def interrupted(self: Setup, start: float, end: float, speed: float) -> None:
        if error is not None:
            raise error
        self.stop.press("Ctrl-C")
        go(self, start, end, speed)

    monkeypatch.setattr(Setup, "go", interrupted)
    assert commissioned("--angle", "0")[0] == ended
    record = json.loads(Path("out/commission.json").read_text())
    assert (record["state"], record["sessions"][0][-1]["name"]) == (state, "small move")
    assert record["drive"]["verified"]
    assert record["drive"]["state"] == "switch on disabled"


@pytest.mark.parametrize(("number", "brakes"), [(signal.SIGINT, True), (signal.SIGQUIT, False)])
def test_a_stop_during_the_step_that_stops_ends_it(here, monkeypatch, number, brakes):
    """Ctrl-C leaves the drive its ramp; SIGQUIT takes the power off at once."""
    order, watch = Cia402Servo.quick_stop, Cycle.watch
    orders: list[int] = []
    cycles: list[int] = []

    def ordered(self: Cia402Servo, **keys: bool) -> None:
        order(self, **keys)
        orders.append(number)
        if len(orders) == 1:
            signal.raise_signal(number)

    def counted(self: Cycle) -> ServoState | None:
        if orders:
            cycles.append(len(orders))
        return watch(self)

    monkeypatch.setattr(Cia402Servo, "quick_stop", ordered)
    monkeypatch.setattr(Cycle, "watch", counted)
    ended, record = commissioned("--angle", "0")
    assert (ended, record["state"], record["drive"]["verified"]) == (3, "stopped", True)
    assert record["sessions"][0][-1]["name"] == "stop"
    assert bool(cycles) == brakes
    assert 1 not in cycles


def test_a_quick_stop_that_is_slower_than_promised_is_found(here, monkeypatch):
    variant(here, *SLOW, ("servo: {node: 1", "servo: {quick_stop_deceleration_deg_s2: 20, node: 1"))
    assert commissioned("--angle", "0")[0] == 0
    promised = Cia402Servo.promised_deceleration
    monkeypatch.setattr(Cia402Servo, "promised_deceleration", lambda self: 100 * promised(self))
    ended, _ = commissioned("--angle", "0", "--out", "wrong")
    record = json.loads(Path("wrong/commission.json").read_text())
    last = record["sessions"][0][-1]
    assert (ended, last["name"], last["verdict"]) == (1, "stop", "wrong")
    assert "6085h" in last["words"]


def test_a_new_bench_file_is_not_written_where_its_files_are_not(here, capsys):
    source = Path(device_files(load_bench("practical"))["servo.eds"])
    shutil.copy(source, "own.eds")
    variant(here, ("servo: {node: 1", "servo: {eds: own.eds, node: 1"))
    Path("other").mkdir()
    words = ["commission", "bench.yaml", "--yes", "--out", "out", "--bench-out", "other/b.yaml"]
    assert status(words) == 2
    assert "own.eds" in capsys.readouterr().err
    assert not Path("out").exists()


def test_the_angle_of_the_command_line_is_that_of_the_start(here, monkeypatch):
    answers(monkeypatch, "1,5", "")
    with closing(Screen()) as screen, StopButton() as stop:
        interview = TypedInterview(screen, Prompt(screen), stop, 0.0)
        assert [interview.angle_deg("angle?") for _ in range(3)] == [0.0, 1.5, None]


@pytest.mark.parametrize("verified", [True, False])
def test_nothing_is_asked_while_the_drive_may_be_under_power(here, monkeypatch, verified):
    asked: list[str] = []

    def tripped(*given: Any) -> WrongError:
        result = given[-1]
        result.sessions.append([])
        result.ending, result.safe = Ending.TRIPPED, SafeState(verified, "off")
        return WrongError("wrong", (Change("encoder", "sign", -1),))

    def agrees(words: str) -> bool:
        asked.append(words)
        return False

    monkeypatch.setattr("rig.commissioning.commission._session", tripped)
    interview: Any = SimpleNamespace(agrees=agrees)
    nothing: Any = None
    found = commission(load_bench("bench.yaml"), nothing, interview, nothing, nothing)
    assert (found.ending, len(asked)) == (Ending.TRIPPED, int(verified))


FLOW = "servo: {node: 1, sign: 1}  # kept\nencoder:\n  node: 2  # kept\n  sign: 1\n"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (Change("servo", "sign", -1), FLOW.replace("sign: 1}", "sign: -1}")),
        (Change("servo", "a", 0.5), FLOW.replace("{node", "{a: 0.5, node")),
        (Change("encoder", "sign", -1), FLOW.replace("  sign: 1", "  sign: -1")),
        (Change("encoder", "a", "b"), FLOW.replace("  node: 2", "  a: b\n  node: 2")),
        (Change("machine", "gear_ratio", 66.7), f"{FLOW}machine: {{gear_ratio: 66.7}}\n"),
        (Change("servo", "node", None), FLOW.replace("node: 1, ", "")),
        (Change("servo", "none", None), FLOW),
        (Change("none", "none", None), FLOW),
        (Change("encoder", "sign", None), FLOW.replace("  sign: 1\n", "")),
    ],
)
def test_a_value_is_set_and_the_rest_is_kept(change: Change, text: str) -> None:
    assert patched(FLOW, (change,)) == text


def test_a_recording_that_fails_takes_the_power_off_first(here, monkeypatch, capsys):
    sample = Recorder.sample

    def full(self: Recorder, time_ns: int, *values: Any) -> None:
        if time_ns > 3_000_000_000:
            raise StorageError("disk full")
        sample(self, time_ns, *values)

    monkeypatch.setattr(Recorder, "sample", full)
    assert status(["commission", "bench.yaml", "--yes", "--out", "out"]) == 4
    shown = capsys.readouterr().err
    assert "the drive is de-energised (read back: switch on disabled)" in shown


@pytest.mark.parametrize("limit_deg_s", [pytest.param(None, marks=PROOF), 28.0, 30.0])
def test_soft_gains_are_refused_before_the_motion_with_the_limit_that_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit_deg_s: float | None
) -> None:
    """The joint breaks away at up to 30 deg/s, also by its samples."""
    monkeypatch.chdir(tmp_path)
    # A swing of 7 Hz has its peak in samples of every 4 ms too.
    variant(tmp_path, *SLOW[:2], source="practical_soft")
    given = () if limit_deg_s is None else ("--speed-limit", str(limit_deg_s))
    ended, record = commissioned("--angle", "0", *given)
    last = record["sessions"][-1][-1]
    if limit_deg_s == 30.0:
        assert (ended, last["name"], last["verdict"]) == (0, "large move", "good")
        return
    assert (ended, last["name"], last["verdict"]) == (1, "small move", "wrong")
    assert "nothing was moved: the gains of the drive are low (402 N m/rad)" in last["words"]
    assert "--speed-limit 30, or raise the gains" in last["words"]
    assert fastest_deg_s(100.0) == 0.0
