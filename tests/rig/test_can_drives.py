"""The packaged benches of ODrive's protocol and of MIT-style motors."""

import dataclasses
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cantools.database
import pytest

import rig.wiring.connect
from drivers.can.port import REMOTE_FLAG
from drivers.interfaces import RawFrame
from drivers.mock import can_drives
from drivers.mock.bench import SimulatedCanBench, simulated_can_bench
from rig.cli.entry import status
from rig.common.sample import Phase
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.operator import AutomaticOperator
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.planning.plan import make_plan
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.run import load_run
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton

from .benches import stages, swing
from .test_feedforward import result_file, tracking_rms

SHORT = stages(swing(duration_s=0.4), swing("heavy", duration_s=0.4, weight_kg=10))
BENCHES = ["odrive_can", "mit_mini"]
ENCODER = {0x000, 0x080, 0x602, 0x77F}
"""What a run sends to the CANopen encoder: NMT, SYNC, SDO, heartbeat."""
POWERED = {
    Phase.FIRST_PASS, Phase.WEIGH, Phase.APPROACH, Phase.SETTLE, Phase.EXCITE, Phase.HOLD,
    Phase.RELEASE,
}  # fmt: skip


@pytest.fixture
def sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(SHORT)
    return "short.yaml"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[SimulatedCanBench]:
    benches: list[SimulatedCanBench] = []

    def noting(*arguments: object) -> SimulatedCanBench:
        benches.append(simulated_can_bench(*arguments))  # type: ignore[arg-type]
        return benches[-1]

    monkeypatch.setattr(rig.wiring.connect, "simulated_can_bench", noting)
    return benches


def sent_to_drive(folder: str) -> list[RawFrame]:
    return [
        frame
        for message in read_run(Path(folder, "recording.mcap")).messages["/frames"]
        for frame in decode_frames(message.data)
        if frame.sent and frame.identifier not in ENCODER
    ]


def run(bench: str, sequence: str) -> list[RawFrame]:
    assert status(["run", sequence, "--yes", "--bench", bench, "--out", "run"]) == 0
    return sent_to_drive("run")


@cache
def independent_decoder(bench: str) -> Any:
    return cantools.database.load_file(
        can_drives.ODRIVE_DBC if bench == "odrive_can" else can_drives.MIT_DBC
    )


def told(bench: str, frames: list[RawFrame]) -> str:
    """Decode what a run sent by an independent decoder; return one letter an order."""
    database = independent_decoder(bench)
    story = ""
    for frame in frames:
        message = database.get_message_by_frame_id(frame.identifier & 0x7FF)
        if frame.identifier & REMOTE_FLAG:
            assert (frame.data, message.senders) == (b"", ["AXIS"])
            continue
        assert message.senders == ["HOST"]
        values = message.decode(frame.data, decode_choices=False)
        if message.name == "SetState":
            story += {1: "I", 8: "R"}[values["State"]]
        elif message.name == "SetMode":
            assert values == {"Control": 3, "Input": 1}
            story += "M"
        elif message.name == "SetLimits":
            assert values["Speed"] == pytest.approx(120 / 3.6, rel=1e-6)
            assert 24.99 < values["Current"] <= 25.0
        elif message.name == "InputPosition":
            assert abs(values["Position"]) * 3.6 < 6.0  # Degrees at the joint: 100 turns to one.
            assert (values["SpeedAhead"], values["TorqueAhead"]) == (0.0, 0.0)
        else:
            assert message.name == "Command"  # Never Clear_Errors, Estop or Reboot.
            special = {can_drives.MIT_ENTER: "E", can_drives.MIT_LEAVE: "L"}.get(frame.data)
            story += special or "T"
            if special is None:
                assert abs(math.degrees(values["Position"]) / 100) < 6.0
                assert abs(values["Torque"]) < 1e-3
                assert abs(values["Speed"]) < 0.1
                assert values["Stiffness"] > 90
    return story


def require_only_orders_of_a_run(bench: str) -> None:
    """Hold every frame of the run against what a run of two stages may send; it ends off."""
    story = told(bench, sent_to_drive("run"))
    short = re.sub(r"(.)\1+", r"\1", story)
    # Closed loop only right after its mode, and once; a target at stiffness only after enter.
    pattern = "I?(MRI?|MI?){0,2}" if bench == "odrive_can" else "L?(ETL|EL|ET|E){0,2}"
    assert re.fullmatch(pattern, short), short
    assert story[-1:] in ("", "I", "L"), short[-8:]
    assert "RR" not in story
    assert "MM" not in story


@pytest.mark.parametrize(
    ("bench", "pattern"), [("odrive_can", "I+(MRI+){2}"), ("mit_mini", "L+(E+T+L+){2}")]
)
def test_a_drive_gets_each_order_in_turn_and_no_other(bench, pattern, sequence, made):
    story = told(bench, run(bench, sequence))
    # Off; then twice the mode or enter, closed loop or targets, and off again.
    assert re.fullmatch(pattern, story), re.sub(r"(.)\1+", r"\1+", story)
    drive = made[0].drive
    if isinstance(drive, can_drives.ODriveAxis):
        assert can_drives.CLEAR not in drive.received
    else:
        assert story.count("T") > 800
    assert not drive.powered


def stopped(bench: str, sequence: str, press: Callable[[str, Phase, StopButton], None]) -> Outcome:
    """Run until ``press`` presses the button at the start of a phase."""
    document, steps = load_bench(bench), load_sequence(sequence)
    stop = StopButton()
    inputs = Inputs(document, steps, 0, realtime=False)
    Path("run").mkdir()
    with rig.wiring.connect.connect(document, 0, realtime=False) as devices:
        watched = dataclasses.replace(devices, observer=lambda name, at: press(name, at, stop))
        _, outcome = execute(
            inputs,
            make_plan(steps, document),
            watched,
            Path("run"),
            AutomaticOperator(),
            stop,
            lambda *_: None,
        )
    require_only_orders_of_a_run(bench)
    return outcome


@pytest.mark.parametrize("stage", [pytest.param("empty", marks=pytest.mark.proof), "heavy"])
@pytest.mark.parametrize("presses", [1, 2])
@pytest.mark.parametrize(
    "phase",
    [
        Phase.PREPARE, Phase.ENABLE, Phase.SETTLE, Phase.EXCITE,
        Phase.RELEASE,
    ],
)  # fmt: skip
@pytest.mark.parametrize("bench", BENCHES)
def test_a_stop_in_any_phase_ends_without_power(bench, phase, presses, stage, sequence, made):
    powered = []

    def press(name: str, at: Phase, stop: StopButton) -> None:
        if (name, at) == (stage, phase):
            powered.append(made[0].drive.powered)
            for _ in range(presses):
                stop.press("the test")

    outcome = stopped(bench, sequence, press)
    assert powered == [phase in POWERED]
    assert outcome.ending is Ending.STOPPED, outcome.message
    assert outcome.safe.verified
    drive = made[0].drive
    assert isinstance(drive, can_drives.ODriveAxis | can_drives.MitMotor)
    assert not drive.powered
    assert drive.fault_code == 0
    last = sent_to_drive("run")[-1]
    if last.identifier == can_drives.SET_STATE:
        assert last.data == b"\1\0\0\0"


@pytest.mark.parametrize(
    ("bench", "code"), [("odrive_can", can_drives.NOT_CALIBRATED), ("mit_mini", 0xA)]
)
def test_a_fault_in_the_middle_ends_the_run_and_is_named(bench, code, sequence, made):
    def press(name: str, at: Phase, stop: StopButton) -> None:
        if (name, at) == ("empty", Phase.EXCITE):
            made[0].drive.fail(code)

    outcome = stopped(bench, sequence, press)
    assert outcome.ending in (Ending.FAILED, Ending.TRIPPED)
    assert outcome.safe.verified
    assert "fault" in outcome.message
    assert not made[0].drive.powered


def test_an_odrive_in_error_is_cleared_once_where_it_is_asked_for(sequence, made, monkeypatch):
    boot = can_drives.ODriveAxis.boot

    def faulty(self: can_drives.ODriveAxis) -> None:
        self.fault_code = can_drives.NOT_CALIBRATED
        boot(self)

    monkeypatch.setattr(can_drives.ODriveAxis, "boot", faulty)
    options = ["--yes", "--bench", "odrive_can"]
    assert status(["run", sequence, *options, "--out", "refused"]) == 4
    assert status(["run", sequence, *options, "--reset-fault", "--out", "run"]) == 0
    drives = [bench.drive for bench in made]
    cleared = [drive.received.get(can_drives.CLEAR, 0) for drive in drives]
    assert cleared == [0, 1]


OFTEN = {(Phase.ENABLE, 1 << 30), (Phase.EXCITE, 3), (Phase.EXCITE, 1 << 30), (Phase.RELEASE, 40)}
"""Cases of each frame that every test run has."""
LOST = {
    "odrive_can": [
        *(can_drives.HEARTBEAT, can_drives.SET_STATE, can_drives.SET_MODE, can_drives.INPUT_POS),
        *(can_drives.ESTIMATES, can_drives.ESTIMATES | REMOTE_FLAG, can_drives.IQ, can_drives.BUS),
        *(can_drives.SET_LIMITS, 0x080),
    ],
    "mit_mini": [can_drives.MIT_COMMAND, can_drives.MIT_REPLY, 0x080],
}  # fmt: skip


@pytest.mark.parametrize(
    ("phase", "count"),
    [
        pytest.param(phase, count, marks=() if (phase, count) in OFTEN else pytest.mark.proof)
        for phase in (Phase.PREPARE, Phase.ENABLE, Phase.EXCITE, Phase.RELEASE)
        for count in (1, 3, 40, 1 << 30)
    ],
)
@pytest.mark.parametrize(
    ("bench", "identifier"), [(bench, lost) for bench, found in LOST.items() for lost in found]
)
def test_lost_frames_never_leave_a_drive_that_follows(
    bench: str,
    identifier: int,
    count: int,
    phase: Phase,
    sequence: str,
    made: list[SimulatedCanBench],
) -> None:
    """Where the drive can no longer be reached, its own watchdog takes the power off."""
    left = [count]

    def lose(_time: int, found: int, data: bytes, _sent: bool) -> tuple[int, bytes] | None:
        if found == identifier and left[0]:
            left[0] -= 1
            return None
        return found, data

    def press(name: str, at: Phase, stop: StopButton) -> None:
        if (name, at) == ("empty", phase):
            made[0].bus.frame_filters.append(lose)

    outcome = stopped(bench, sequence, press)
    drive, clock = made[0].drive, made[0].clock
    clock.sleep_until_ns(clock.now_ns() + 150_000_000)
    assert not drive.powered
    assert outcome.ending in (Ending.DONE, Ending.FAILED, Ending.TRIPPED)
    assert outcome.error is None
    if outcome.ending is Ending.DONE:
        assert outcome.safe.verified


def test_an_odrive_adds_the_torque_of_feed_forward(sequence, made):
    Path(sequence).write_text(
        "sequence: 1\nname: slow\nstages:\n"
        "  - {name: sine, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 0.5}],\n"
        "     duration_s: 4}\n"
    )
    options = ["run", sequence, "--yes", "--bench", "odrive_can"]
    assert status([*options, "--out", "plain"]) == 0
    assert status([*options, "--feedforward", str(result_file()), "--out", "run"]) == 0
    plain, fed = (load_run(Path(folder)).recordings for folder in ("plain", "run"))
    assert all(
        tracking_rms(one) > 1.3 * tracking_rms(other) for one, other in zip(plain, fed, strict=True)
    )
    database = cantools.database.load_file(can_drives.ODRIVE_DBC)
    running, added = False, []
    for frame in sent_to_drive("run"):
        if frame.identifier & REMOTE_FLAG:
            continue
        values = database.decode_message(frame.identifier, frame.data, decode_choices=False)
        if frame.identifier == can_drives.SET_STATE:
            running = values["State"] == can_drives.CLOSED_LOOP
        elif frame.identifier == can_drives.INPUT_POS:
            added.append(values["TorqueAhead"])
            assert running or not values["TorqueAhead"]
    assert max(added) > 0.07 > -0.07 > min(added)  # Friction alone takes 0.068 N m at the motor.
