"""What an operator is told to do after a run that is not done, and that the command does go on."""

import dataclasses
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import ServoState
from rig.cli.entry import status
from rig.control.safety import Check, foreseen, remedy
from rig.results.run.go_on import NEW_RUN, NOT_READ_BACK, go_on_words
from rig.runs.run_record import RunRecord

from .benches import stages, swing

ONE = stages(swing(duration_s=1))


@pytest.fixture
def stopped(runner: Any, fake_bench: Any) -> RunRecord:
    bench = fake_bench()
    bench.faults["exchange", 400] = lambda: bench.overrides.update(current_A=1000.0)
    folder, _ = runner(bench)
    record: RunRecord = folder.record
    return record


def changed(record: RunRecord, **fields: Any) -> RunRecord:
    return dataclasses.replace(record, **fields)


def test_a_trip_says_once_what_to_do_and_then_how_to_go_on(stopped: RunRecord) -> None:
    words = go_on_words(stopped, Path("runs/x"))
    assert f"{stopped.message}\n{words}".count(remedy(Check.CURRENT)) == 1
    assert words.splitlines() == [
        f"first: {remedy(Check.CURRENT)}",
        "go on with: rig resume runs/x",
    ]


@pytest.mark.parametrize("folder", ["my runs/it's", "-x", "läufe/x"])
def test_the_folder_is_quoted_for_the_shell(stopped: RunRecord, folder: str) -> None:
    command = go_on_words(stopped, Path(folder)).rpartition("go on with: ")[2]
    assert shlex.split(command) == ["rig", "resume", "./-x" if folder == "-x" else folder]


@pytest.mark.parametrize("state", list(ServoState))
def test_a_fault_is_cleared_only_once_its_cause_is_removed(stopped, state):
    record = changed(stopped, state="failed", trip=None, drive_state=state.value)
    first, _, command = go_on_words(record, Path("x")).rpartition("\n")
    in_fault = state in (ServoState.FAULT, ServoState.FAULT_REACTION)
    assert command == f"go on with: rig resume x{' --reset-fault' if in_fault else ''}"
    assert first == ("first: remove the cause of the drive's fault" if in_fault else "")


@pytest.mark.parametrize("verified", [True, False, None])
def test_a_drive_that_was_not_read_back_comes_before_everything(stopped, verified):
    lines = go_on_words(changed(stopped, de_energised=verified), Path("x")).splitlines()
    assert (lines[0] == f"first: {NOT_READ_BACK}") is (verified is not True)
    assert lines[-1] == "go on with: rig resume x"


@pytest.mark.parametrize("check", list(Check))
def test_every_trip_has_a_remedy_without_a_second_command(stopped: RunRecord, check: Check) -> None:
    assert remedy(check)
    assert "run again" not in remedy(check)
    record = changed(stopped, message="", trip={**(stopped.trip or {}), "check": check.value})
    lines = go_on_words(record, Path("x")).splitlines()
    assert lines[0] == f"first: {remedy(check)}"
    by_file = re.search("file|reduce|lower|raise", remedy(check)) is not None
    assert (f"note: {NEW_RUN}" in lines) is by_file


@pytest.mark.parametrize(
    ("predicted", "limit", "above"),
    [(26.0, 25.0, True), (26.0, -25.0, True), (24.0, -25.0, False), (None, -0.5, False)],
)
def test_a_predicted_peak_is_held_against_the_limit_in_either_direction(predicted, limit, above):
    trip = {"predicted": predicted, "limit": limit, "unit": "A"}
    assert foreseen(trip) is above
    assert ("the plan predicts" in remedy(Check.CURRENT, trip)) is above


def test_the_words_end_the_message_and_the_command_goes_on(tmp_path, capsys):
    sequence, out = tmp_path / "one.yaml", tmp_path / "two words"
    sequence.write_text(ONE)
    faults = tmp_path / "faults.yaml"
    faults.write_text(
        "faults: 1\nrows:\n  - {phase: excite, after_s: 0.3, target: drive, fault: fault, value: "
        "0x7320}\n"
    )
    assert status(["run", str(sequence), "--yes", "--out", str(out), "--faults", str(faults)]) == 4
    told = capsys.readouterr()
    *_, first, last = told.err.splitlines()
    assert first == "first: remove the cause of the drive's fault"
    command = shlex.split(last.removeprefix("go on with: "))
    assert command == ["rig", "resume", str(out), "--reset-fault"]
    assert status([*command[1:], "--yes"]) == 0
    told = capsys.readouterr()
    assert "go on with" not in told.err + told.out
