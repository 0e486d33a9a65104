"""Benches with drives that use their own frames in other ways than the simulated house servo."""

from __future__ import annotations

import io
import json
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

import drivers.mock.bench
from drivers.mock.dbc_drive import DbcDrive
from rig.cli.commands.bench import _agreed
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.planning.plan import make_plan
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.terminal.prompt import Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton

SHORT = """\
sequence: 1
name: short
limits: {torque_N_m: 60, angle_max_deg: 25}
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.4,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
"""
TEXT = resolve("practical_dbc", "benches").read_text(encoding="utf-8")
LIMITS = TEXT[TEXT.index("  limits:   ") : TEXT.index("  messages:  ")]
CLEAR = 0x130


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Write the packaged bench with pieces of text replaced, and a short sequence."""
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(SHORT)

    def write(*changes: tuple[str, str]) -> str:
        text = TEXT
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        Path("bench.yaml").write_text(text, encoding="utf-8")
        return "bench.yaml"

    return write


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Type lines on standard input, which then ends."""
    return lambda *lines: monkeypatch.setattr(
        sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines))
    )


def run(bench: str, *options: str) -> int:
    return status(["run", "short.yaml", "--yes", "--bench", bench, "--out", "run", *options])


def sent() -> Counter[int]:
    frames = (
        frame
        for message in read_run(Path("run/recording.mcap")).messages["/frames"]
        for frame in decode_frames(message.data)
    )
    return Counter(frame.identifier for frame in frames if frame.sent)


def faulty(monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    """Let the simulated drive start with a fault code beside its state OFF."""

    class Faulty(DbcDrive):
        def boot(self) -> None:
            self.fault_code = code
            super().boot()

    monkeypatch.setattr(drivers.mock.bench, "DbcDrive", Faulty)


def test_a_fault_code_beside_a_state_that_is_off_is_a_fault(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    faulty(monkeypatch, 7)
    assert status(["check", "practical_dbc"]) == 1
    shown = capsys.readouterr().out
    assert "state of the drive: fault" in shown
    assert "drive fault 0007h" in shown


def test_a_drive_that_takes_no_limits_is_jogged_after_a_question(
    written: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    answers: Callable[..., None],
) -> None:
    bench = written((LIMITS, ""))
    answers("yes")
    assert status(["jog", bench, "--to", "1", "--json", "jog.json"]) == 0
    shown = capsys.readouterr()
    words = shown.out + shown.err
    assert (
        "does not accept these limits over its bus: joint speed (servo.held.speed_deg_s)" in words
    )
    assert "607Fh" not in words
    assert json.loads(Path("jog.json").read_text())["de_energised"] is True


@pytest.mark.parametrize("given", [("no",), ("",), ()])
def test_a_jog_that_is_not_confirmed_moves_nothing(
    written: Callable[..., str],
    capsys: pytest.CaptureFixture[str],
    answers: Callable[..., None],
    given: tuple[str, ...],
) -> None:
    bench = written((LIMITS, ""))
    answers(*given)
    assert status(["jog", bench, "--to", "1", "--json", "jog.json"]) == 3
    record = json.loads(Path("jog.json").read_text())
    assert (record["state"], record["de_energised"]) == ("stopped", True)
    assert record["message"] == "not confirmed; nothing was moved"


def test_a_pipe_agrees_to_nothing_on_a_real_bench(
    answers: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    answers("yes")
    screen = Screen()
    with StopButton() as stop:
        assert not _agreed(Prompt(screen), stop, screen, simulated=False)
        assert _agreed(Prompt(screen), stop, screen, simulated=True)
    assert "there is no terminal to ask at" in capsys.readouterr().err


def test_a_run_of_such_a_drive_says_what_it_alone_holds(
    written: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(written((LIMITS, ""))) == 0
    assert (
        "does not accept these limits over its bus: joint angle, upper end"
        in capsys.readouterr().err
    )
    record = json.loads(Path("run/run.json").read_text())
    assert any("joint torque (servo.held.torque_N_m)" in words for words in record["warnings"])


SENSORS = (
    ("    supply_voltage: {signal: DRV_Status.Supply}\n", ""),
    ("    temperature: {signal: DRV_Status.Temperature}\n", ""),
)
STATED = (
    ("  temperature_C: 80\n", ""),
    ("  supply_min_V: 48\n", ""),
    ("  supply_max_V: 72\n", ""),
)


def test_a_limit_for_what_is_not_reported_is_refused(written: Callable[..., str]) -> None:
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
