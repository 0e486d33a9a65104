"""A bench whose drive speaks its own CAN frames, from its file to a finished run."""

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import drivers.mock.bench
from drivers.mock.dbc_drive import DRIVE_DBC, SERIAL_NUMBER, DbcDrive
from rig.cli.commands.bench import _agreed
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.dbc import DbcServoSection
from rig.config.sequence import load_sequence
from rig.planning.plan import make_plan
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.recorded_inputs import truth_of
from rig.terminal.prompt import Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton

from .benches import stages, swing, variant

SHORT = stages(
    swing(duration_s=0.6),
    swing("heavy", duration_s=0.6, weight_kg=10),
    head="limits: {torque_N_m: 60, following_error_deg: 1.5, angle_max_deg: 25}\n",
)
TEXT = resolve("practical_dbc", "benches").read_text(encoding="utf-8")


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Write the packaged bench with pieces of text replaced, into the present folder."""
    monkeypatch.chdir(tmp_path)

    def write(*changes: tuple[str, str]) -> Path:
        return variant(tmp_path, *changes, source="practical_dbc", count=1)

    return write


def line_of(path: Path, words: str) -> int:
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if words in line)


def test_a_sequence_runs_ends_safe_and_keeps_every_frame(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sequence, run = tmp_path / "short.yaml", tmp_path / "run"
    sequence.write_text(SHORT)
    assert (
        status(["run", str(sequence), "--yes", "--bench", "practical_dbc", "--out", str(run)]) == 0
    )
    record = json.loads((run / "run.json").read_text())
    assert record["de_energised"] is True
    assert (record["stale"], record["overruns"]) == (0, 0)
    log = read_run(run / "recording.mcap")
    assert json.loads(log.attachments["devices.json"])["servo"]["serial_number"] == SERIAL_NUMBER
    identifiers = {
        frame.identifier
        for message in log.messages["/frames"]
        for frame in decode_frames(message.data)
    }
    assert {0x010, 0x080, 0x110, 0x120, 0x190, 0x191, 0x1A0, 0x1B1, 0x182} <= identifiers
    truth = truth_of(run)
    assert truth["Mc"] == 6.825


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "kind: dbc",
            "kind: dbx",
            "servo: kind is unknown; known are canopen (the default) and dbc",
        ),
        (
            "scale: 6.283185307179586}\n  orders",
            "scle: 2}\n  orders",
            "unknown key; did you mean 'scale'?",
        ),
        ("DRV_Motion.Position", "DRV_Motion.Postion", "has no signal 'Postion'; did you mean 'Pos"),
        ("message: DRV_Stop", "message: DRV_Halt", "the DBC has no message 'DRV_Halt'"),
        ("fault: [FAULT]", "fault: [FALT]", "no value 'FALT'; did you mean 'FAULT'?"),
        ("algorithm: crc8_j1850", "algorithm: crc9", "servo.messages.DRV_Command.algorithm: "),
    ],
)
def test_one_mistake_is_one_line_at_its_place(written, old, new, words):
    path = written((old, new))
    with pytest.raises(InputError) as caught:
        load_bench(path)
    mistaken = new.split("\n")[0]
    assert any(
        words in problem and problem.startswith(f"{path}:{line_of(path, mistaken)}:")
        for problem in caught.value.problems
    ), caught.value.problems


def test_a_real_drive_needs_its_own_dbc(written: Callable[..., Path], tmp_path: Path) -> None:
    real = ("interface: mock", "interface: virtual")
    with pytest.raises(
        InputError, match=r"servo\.file: missing; state the DBC file of the real drive"
    ):
        load_bench(written(real))
    own = ("file: null", "file: own.dbc")
    with pytest.raises(InputError, match=r"own\.dbc: the file cannot be read: No such file"):
        load_bench(written(real, own))
    text = DRIVE_DBC.read_text()
    (tmp_path / "own.dbc").write_text(text.replace("SG_ Code :", "SG_ Code"))
    with pytest.raises(InputError, match=r"own\.dbc:10:11: Invalid syntax"):
        load_bench(written(real, own))
    (tmp_path / "own.dbc").write_text(text)
    assert isinstance(load_bench(written(real, own)).value.servo, DbcServoSection)


def test_a_bus_too_slow_for_its_frames_is_refused(written: Callable[..., Path]) -> None:
    with pytest.raises(
        InputError, match=r"bus\.bitrate: too slow: a cycle of 1 ms takes up to \d+ bits"
    ):
        load_bench(written(("bitrate: 1000000", "bitrate: 500000")))


LIMITS = TEXT[TEXT.index("  limits:   ") : TEXT.index("  messages:  ")]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    return lambda *lines: monkeypatch.setattr(
        sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines))
    )


def test_a_fault_code_beside_a_state_that_is_off_is_a_fault(monkeypatch, capsys):
    class Faulty(DbcDrive):
        def boot(self) -> None:
            self.fault_code = 7
            super().boot()

    monkeypatch.setattr(drivers.mock.bench, "DbcDrive", Faulty)
    assert status(["check", "practical_dbc"]) == 1
    shown = capsys.readouterr().out
    assert "state of the drive: fault" in shown


def test_a_drive_that_takes_no_limits_is_jogged_after_a_question(written, capsys, answers):
    bench = written((LIMITS, ""))
    answers("yes")
    assert status(["jog", str(bench), "--to", "1", "--json", "jog.json"]) == 0
    shown = capsys.readouterr()
    words = shown.out + shown.err
    assert (
        "does not accept these limits over its bus: joint speed (servo.held.speed_deg_s)" in words
    )
    assert "607Fh" not in words
    assert json.loads(Path("jog.json").read_text())["de_energised"] is True


@pytest.mark.parametrize("given", [("no",), ()])
def test_a_jog_that_is_not_confirmed_moves_nothing(written, answers, given):
    bench = written((LIMITS, ""))
    answers(*given)
    assert status(["jog", str(bench), "--to", "1", "--json", "jog.json"]) == 3
    record = json.loads(Path("jog.json").read_text())
    assert (record["state"], record["de_energised"]) == ("stopped", True)
    assert record["message"] == "not confirmed; nothing was moved"


def test_a_pipe_agrees_to_nothing_on_a_real_bench(answers, capsys):
    answers("yes")
    screen = Screen()
    with StopButton() as stop:
        assert not _agreed(Prompt(screen), stop, screen, simulated=False)
        assert _agreed(Prompt(screen), stop, screen, simulated=True)
    assert "there is no terminal to ask at" in capsys.readouterr().err


SENSORS = (
    ("    supply_voltage: {signal: DRV_Status.Supply}\n", ""),
    ("    temperature: {signal: DRV_Status.Temperature}\n", ""),
)
STATED = (("  temperature_C: 80\n", ""), ("  supply_min_V: 48\n", ""), ("  supply_max_V: 72\n", ""))


def test_a_limit_for_what_is_not_reported_is_refused(written: Callable[..., Path]) -> None:
    bench = written(*SENSORS)
    with pytest.raises(InputError) as caught:
        load_bench(bench)
    found = [problem.partition(": limits.")[2] for problem in caught.value.problems]
    assert [text.partition(":")[0] for text in found] == [
        "supply_max_V",
        "supply_min_V",
        "temperature_C",
    ]
    written(*SENSORS, *STATED)
    Path("short.yaml").write_text(SHORT.replace("torque_N_m", "temperature_C"))
    with pytest.raises(InputError, match=r"temperature_C: servo.inputs has no signal"):
        make_plan(load_sequence("short.yaml"), load_bench(bench))
