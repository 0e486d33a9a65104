"""``rig identify`` as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest

from rig.cli import status

RATE = 200.0
CAMPAIGN = """\
campaign: 1
bench: {moment_arm: 0.095, lever_ratio: 10}
defaults: {channels: {time: t, angle: q, velocity: w, torque: tau}}
recordings:
  - {file: free.csv, stage: unloaded}
  - {file: heavy.csv, stage: loaded, weight_mass: 30.6}
  - {file: later.csv, stage: unloaded, role: validate}
"""


def write_csv(path: Path, moment: float, frequency: float) -> None:
    time = np.arange(int(12 * RATE)) / RATE
    w = 2.0 * np.pi * frequency
    velocity = 0.35 * w * np.cos(w * time)
    torque = np.sign(velocity) * (6.825 + 5.2 * np.exp(-((velocity / 0.0557) ** 2))) + 5.3462 * velocity
    torque += moment * (np.sign(velocity) * (0.052 + 0.034 * np.exp(-((velocity / 0.0326) ** 2))) + 0.032 * velocity)
    rows = np.column_stack([time, 0.35 * np.sin(w * time), velocity, torque])
    np.savetxt(path, rows, delimiter=",", header="t,q,w,tau", comments="", fmt="%.9g")


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    write_csv(tmp_path / "free.csv", 0.0, 0.2)
    write_csv(tmp_path / "heavy.csv", 10.0 * 30.6 * 9.80665 * 0.095, 0.2)
    write_csv(tmp_path / "later.csv", 0.0, 0.17)
    path = tmp_path / "bench.yaml"
    path.write_text(CAMPAIGN)
    return path


def test_both_methods(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, record_file = tmp_path / "out", tmp_path / "result.json"
    arguments = ["identify", str(campaign), "--method", "both", "--out", str(out), "--json", str(record_file)]
    assert status(arguments) == 0
    printed = capsys.readouterr().out
    assert "default: value" in printed
    assert "paper: value" in printed
    assert "90 % interval" in printed
    record = json.loads(record_file.read_text())
    assert record == json.loads((out / "identify.json").read_text())
    assert (record["method"], record["compared"][0]["method"]) == ("default", "paper")
    assert record["parameters"]["Mc"]["value"] == pytest.approx(6.825, rel=0.01)
    assert record["parameters"]["mu_c"]["value"] == pytest.approx(0.052, rel=0.01)
    for one in (record, record["compared"][0]):
        assert {"J", "Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2"} == set(one["parameters"])
        assert one["fit"]["validate_rms"] > 0.0
    assert {Path(entry["file"]).name for entry in record["inputs"]} == {"free.csv", "heavy.csv", "later.csv"}
    assert (out / "report.html").is_file()


def test_same_seed_same_record(campaign: Path, tmp_path: Path) -> None:
    records = []
    for name in ("one", "two"):
        arguments = ["identify", str(campaign), "--method", "paper", "--seed", "4", "--out", str(tmp_path / name)]
        assert status(arguments) == 0
        record = json.loads((tmp_path / name / "identify.json").read_text())
        records.append({k: v for k, v in record.items() if k not in ("created", "seconds")})
    assert records[0] == records[1]
    assert records[0]["seed"] == 4


def test_the_default_folder_is_named_after_the_campaign(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert status(["identify", str(campaign), "--method", "paper"]) == 0
    assert (tmp_path / "bench-identified" / "report.html").is_file()


def test_no_such_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["identify", str(tmp_path / "nothing")]) == 2
    assert "nothing" in capsys.readouterr().err


def test_a_recording_that_cannot_be_identified(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign.write_text(CAMPAIGN.replace("- {file: free.csv, stage: unloaded}", ""))
    assert status(["identify", str(campaign), "--method", "paper", "--out", str(tmp_path / "out")]) == 2
    assert "unloaded" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("a file")
    out = tmp_path / "taken" / "inside"
    assert status(["identify", str(campaign), "--method", "paper", "--out", str(out)]) == 2
    assert "--out" in capsys.readouterr().err


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["identify", "--help"]) == 0
    assert "rig identify runs/demo" in capsys.readouterr().out
