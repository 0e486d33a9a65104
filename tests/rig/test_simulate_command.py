"""``rig simulate``, ``rig identify --ladder`` and ``--score`` as a user runs them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from identification.recording import Bench, Controller, Recording
from identification.simulate.closed_loop import replay
from rig.cli.entry import status

FRICTION = {"J": 0.2, "Mc": 6.0, "Ms": 11.0, "omega_sf": 0.06, "sigma_2": 5.0}
CAMPAIGN = """\
campaign: 1
bench: {}
defaults:
  channels: {time: t, command: c, angle: q, torque: tau}
  controller: {output: torque, position_gain: 4000, velocity_gain: 100}
recordings:
  - {file: fit.csv}
  - {file: later.csv, role: validate}
"""


def write_recording(path: Path, frequency: float) -> None:
    """A loop's response made by the simulation itself: an exact model has to find nothing wrong."""
    time = np.arange(4001) / 500.0
    command = 0.35 * np.sin(2.0 * math.pi * frequency * time)
    loop = Controller("torque", 4000.0, 100.0)
    start = Recording(
        "made",
        {"time": time, "command": command, "angle": np.zeros(4001)},
        Bench(),
        controller=loop,
    )
    out = replay(start, FRICTION, 2.0)
    rows = np.column_stack([time, command, out.angle, out.torque])
    np.savetxt(path, rows, delimiter=",", header="t,c,q,tau", comments="", fmt="%.12g")


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    write_recording(tmp_path / "fit.csv", 0.3)
    write_recording(tmp_path / "later.csv", 0.4)
    path = tmp_path / "bench.yaml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture
def result(tmp_path: Path) -> Path:
    path = tmp_path / "fitted.json"
    path.write_text(json.dumps({"schema": "loadrig.identify/1", "alpha": 2.0, "fitted": FRICTION}))
    return path


@pytest.mark.usefixtures("undrawn")
def test_a_simulation_with_the_right_model_errs_by_nothing_and_says_what_no_friction_would(
    campaign: Path, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record_file = tmp_path / "simulated.json"
    arguments = ["simulate", str(campaign), "--result", str(result), "--out", str(tmp_path / "out")]
    assert status([*arguments, "--json", str(record_file)]) == 0
    record = json.loads(record_file.read_text())
    assert record == json.loads((tmp_path / "out" / "simulate.json").read_text())
    assert (record["schema"], record["unit"], record["angle_unit"]) == (
        "loadrig.simulate/1",
        "N m",
        "rad",
    )
    cases = {case["friction_share"]: case for case in record["cases"]}
    assert set(cases) == {1.0, 0.5, 0.0}
    for role in ("fit", "validate"):
        assert cases[1.0][role]["angle_rms"] < 1e-9
        assert cases[1.0][role]["torque_rms"] < 1e-6
        assert cases[0.5][role]["torque_rms"] < 0.7 * cases[0.0][role]["torque_rms"]
        assert cases[0.0][role]["torque_relative"] > 0.5
    assert {Path(entry["file"]).name for entry in record["inputs"]} >= {
        "fit.csv",
        "later.csv",
        "fitted.json",
    }
    assert "angle error (mrad)" in capsys.readouterr().out
    assert (tmp_path / "out" / "report.html").is_file()


def test_recordings_without_a_controller_are_scored_by_their_torque_alone(
    campaign: Path, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [line for line in CAMPAIGN.splitlines(keepends=True) if "controller" not in line]
    campaign.write_text("".join(lines))
    out = tmp_path / "out"
    assert status(["simulate", str(campaign), "--result", str(result), "--out", str(out)]) == 0
    record = json.loads((out / "simulate.json").read_text())
    assert record["cases"] == []
    assert record["equations"]
    assert "controller" in capsys.readouterr().out


@pytest.mark.usefixtures("undrawn")
def test_ladder_and_score_are_printed_recorded_and_reported(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "friday.csv", 0.35)
    other = tmp_path / "friday.yaml"
    other.write_text("".join(CAMPAIGN.splitlines(keepends=True)[:6]) + "  - {file: friday.csv}\n")
    out = tmp_path / "out"
    options = ["--ladder", "--score", str(other), "--bandwidth", "40", "--out", str(out)]
    assert status(["identify", str(campaign), *options]) == 0
    printed, page = capsys.readouterr().out, (out / "report.html").read_text()
    for words in ("Ladder of friction models", "Transfer"):
        assert words in page
    assert "Ladder of friction models" in printed
    record = json.loads((out / "identify.json").read_text())
    first, second = record["ladder"]
    assert (first["friction"], second["friction"]) == ("coulomb_viscous", "stribeck")
    assert second["validate_rms"]["value"] < first["validate_rms"]["value"]
    assert second["angle_rms"]["value"] < first["angle_rms"]["value"]
    assert first["best_share"] + second["best_share"] == pytest.approx(1.0)
    assert record["fitted"].keys() == {"Mc", "Ms", "omega_sf", "sigma_2", "J"}
    carried = record["transfer"]
    assert carried["source"] == str(other)
    assert set(carried["parameters"]) == set(record["parameters"])
    assert "friday.csv" in {Path(entry["file"]).name for entry in record["inputs"]}


def test_score_on_what_was_fitted_is_refused(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["identify", str(campaign), "--bandwidth", "40", "--score", str(campaign)]) == 2
    assert "was fitted to this recording" in capsys.readouterr().err
