"""A load that changes within a stage is noticed; a bench that merely drifts is not accused."""

import json
from pathlib import Path

import numpy as np
import pytest

from identification.recording import Bench, Dataset, Recording
from rig.cli.entry import status
from rig.results.acceptance.evidence import SAME_LOAD
from rig.results.run.go_on import ACCEPTANCE_FILE
from rig.results.run.report import REPORT_FILE
from rig.runs.run import read_record
from rig.weighing.load_change import FEWEST_HALF_CYCLES, LEAST_SHARE, changed_loads

from ..long.load_change import trials

SEQUENCE = """\
sequence: 1
name: falling
stages:
  - {name: heavy, stage: loaded, weight_kg: 40, tones: [{amplitude_deg: 10, frequency_Hz: 0.75}],
     duration_s: 8}
  - {name: light, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 10, frequency_Hz: 0.75}],
     duration_s: 8}
"""
FAULT = """\
faults: 1
rows:
  - {phase: excite, stage: heavy, after_s: 4, target: operator, fault: weight_removed, value: 20}
"""


pytestmark = pytest.mark.usefixtures("elsewhere")


def test_half_of_the_weight_taken_off_is_said_recorded_and_judged(capsys):
    Path("s.yaml").write_text(SEQUENCE)
    Path("f.yaml").write_text(FAULT)
    assert status(["run", "s.yaml", "--yes", "--out", "out", "--faults", "f.yaml"]) == 1
    record = read_record(Path("out"))
    assert record.state == "done"
    heavy, light = record.stages
    assert heavy.load_change_kg is not None
    assert -20.0 < heavy.load_change_kg < -10.0
    assert light.load_change_kg is None
    (check,) = [each for each in record.weights if each["verdict"] == "wrong"]
    assert check["stage"] == "heavy"
    told = capsys.readouterr()
    assert "warning: stage heavy: the load changed" in told.err
    page = (Path("out") / REPORT_FILE).read_text()
    assert '<p class="verdict bad">DONE, LOAD CHANGED, NOT JUDGED</p>' in page
    Path("limits.yaml").write_text("acceptance: 1\nlimits: [worst current < 100 A]\n")
    assert status(["runs", "accept", "out", "--acceptance", "limits.yaml"]) == 1
    judged = json.loads((Path("out") / ACCEPTANCE_FILE).read_text())
    assert judged["verdict"] == "rejected"
    (failed,) = [check for check in judged["checks"] if not check["passed"]]
    assert (failed["limit"], failed["value"]) == (SAME_LOAD, heavy.load_change_kg)
    assert failed["words"].startswith("run.json: stages[0].load_change_kg: ")


@pytest.mark.parametrize("count", [4, pytest.param(40, marks=pytest.mark.proof)])
def test_no_alarm_on_sound_benches(count: int) -> None:
    """The rate over 600 stages is that of `python -m tests.long.load_change`."""
    assert [trial for trial in trials(count, removed=False) if trial.found is not None] == []


@pytest.mark.parametrize("count", [4, pytest.param(40, marks=pytest.mark.proof)])
def test_what_was_taken_off_is_found(count: int) -> None:
    missed = [trial for trial in trials(count, removed=True) if trial.found is None]
    assert all(trial.soft for trial in missed)
    assert len(missed) <= 3


def friction(change_kg: float, seconds: float = 20.0, drift: float = 0.0) -> Recording:
    """Return a stage of 40 kg whose friction is that of the weight alone."""
    time = np.arange(round(seconds * 1000)) * 1e-3
    command = np.deg2rad(10.0) * np.sin(np.pi * time)
    load = 40.0 + np.where(time > 0.52 * seconds, change_kg, 0.0) + 40.0 * drift * time / seconds
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(time))
    torque = 0.5 * load * np.sign(np.cos(np.pi * time)) + noise
    return Recording(
        name="loaded",
        channels={"time": time, "angle": command, "torque": torque, "command": command},
        bench=Bench(),
        stage="loaded",
        weight_mass=40.0,
    )


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("share", "alarm"), [(0.4, False), (0.6, True)])
def test_both_sides_of_the_smallest_change(sign: float, share: float, alarm: bool) -> None:
    change = sign * share * LEAST_SHARE * 40.0
    found = changed_loads(Dataset((friction(change),)), ["loaded"])
    assert bool(found) is alarm
    if alarm:
        assert found["loaded"][0].mass_kg == pytest.approx(change, rel=0.1)
        assert found["loaded"][0].time_s == pytest.approx(10.4, abs=1.1)


@pytest.mark.parametrize("drift", [-0.4, 0.4])
def test_a_steady_drift_is_no_alarm(drift: float) -> None:
    assert changed_loads(Dataset((friction(0.0, drift=drift),)), ["loaded"]) == {}


def test_too_few_half_cycles_are_not_judged() -> None:
    seconds = FEWEST_HALF_CYCLES - 1.0
    assert changed_loads(Dataset((friction(-20.0, seconds),)), ["loaded"]) == {}
