"""A fault that the drive is in before a run: cleared only where that was asked for."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DriveFault
from drivers.interfaces import ServoState
from rig.cli.entry import status
from rig.runs.mcap.reader import read_run
from rig.runs.recover import prepare
from rig.runs.run_record import Ending


@pytest.fixture
def faulty(fake_bench: Any) -> Any:
    """A bench whose drive is in fault, and can be cleared."""
    bench = fake_bench()
    bench.drive_state = ServoState.FAULT
    states: list[ServoState] = []

    def cleared() -> None:
        bench.drive_state = ServoState.SWITCH_ON_DISABLED
        states.append(bench.drive_state)

    def refused() -> None:
        if bench.drive_state is ServoState.FAULT:
            raise DriveFault(0x8130, "heartbeat lost")

    bench.faults["reset_fault", 1] = cleared
    bench.faults["enable", 1] = refused
    return bench


def test_without_being_asked_a_fault_stays(runner: Any, faulty: Any) -> None:
    _, outcome = runner(faulty)
    assert outcome.ending is Ending.FAILED
    assert "drive fault 8130h" in outcome.message
    assert "clear the fault with --reset-fault" in outcome.message
    assert faulty.calls["reset_fault"] == 0
    assert faulty.drive_state is not ServoState.OPERATION_ENABLED


def test_when_asked_it_is_cleared_after_the_prompt_and_noted(runner: Any, faulty: Any) -> None:
    runner.inputs = dataclasses.replace(runner.inputs, reset_fault=True)
    folder, outcome = runner(faulty)
    assert outcome.ending is Ending.DONE, outcome.message
    events = [event["event"] for event in read_run(folder.recording).events]
    assert events[:4] == ["prompt", "answer", "fault reset", "stage start"]
    assert faulty.calls["reset_fault"] == 1
    assert faulty.order.index("reset_fault") < faulty.order.index("enable")


def test_a_run_whose_writer_died_is_known_as_such(short_sequence: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert status(["run", str(short_sequence), "--yes", "--out", str(out)]) == 0
    content = (out / "recording.mcap").read_bytes()
    (out / "recording.mcap").write_bytes(content[: len(content) // 2])
    record = json.loads((out / "run.json").read_text())
    record["state"] = record["parts"][0]["state"] = "running"
    (out / "run.json").write_text(json.dumps(record))
    assert status(["recover", str(out)]) == 0
    assert prepare(out).died
