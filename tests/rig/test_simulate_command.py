"""``rig simulate``, ``rig identify --ladder`` and ``--score`` as a user runs them."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.recording import Controller, Recording
from identification.simulation.closed_loop import replay
from rig.cli.entry import status
from rig.results.identify.simulate import simulate_source

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


def write_recording(path: Path, frequency: float, noise_Nm: float = 0.0) -> None:
    """A loop's response made by the simulation itself: an exact model has to find nothing wrong."""
    time = np.arange(4001) / 500.0
    command = 0.35 * np.sin(2.0 * math.pi * frequency * time)
    loop = Controller("torque", 4000.0, 100.0)
    start = Recording(
        name="made",
        channels={"time": time, "command": command, "angle": np.zeros(4001)},
        controller=loop,
    )
    out = replay(start, FRICTION, 2.0)
    noise = noise_Nm * np.random.default_rng(round(100 * frequency)).normal(size=len(time))
    rows = np.column_stack([time, command, out.angle, out.torque + noise])
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
def test_a_simulation_with_the_right_model_errs_by_nothing(
    campaign: Path, result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record_file = tmp_path / "simulated.json"
    arguments = ["simulate", str(campaign), "--result", str(result), "--out", str(tmp_path / "out")]
    assert status([*arguments, "--json", str(record_file)]) == 0
    record = json.loads(record_file.read_text())
    assert record == json.loads((tmp_path / "out" / "simulate.json").read_text())
    assert (record["schema"], record["unit"], record["angle_unit"]) == (
        "loadrig.simulate/2",
        "N m",
        "rad",
    )
    for role in ("fit", "validate"):
        assert record["closed_loop"][role]["angle_rms"] < 1e-9
        assert record["closed_loop"][role]["torque_rms"] < 1e-6
        assert record["band"]["inside"][role] is None
    assert {Path(entry["file"]).name for entry in record["inputs"]} >= {
        "fit.csv",
        "later.csv",
        "fitted.json",
    }
    assert "angle error (mrad)" in capsys.readouterr().out
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.usefixtures("undrawn")
def test_the_band_holds_the_torque_that_was_set_aside(campaign: Path, tmp_path: Path) -> None:
    for name, frequency in (("fit", 0.3), ("later", 0.4)):
        write_recording(tmp_path / f"{name}.csv", frequency, noise_Nm=0.3)
    found, made = tmp_path / "found.json", tmp_path / "made.json"
    out = ["--out", str(tmp_path / "out"), "--json"]
    assert status(["identify", str(campaign), *out, str(found)]) == 0
    covariance = json.loads(found.read_text())["covariance"]
    assert np.array(covariance["matrix"]).shape == (len(covariance["names"]),) * 2
    assert status(["simulate", str(campaign), "--result", str(found), *out, str(made)]) == 0
    band = json.loads(made.read_text())["band"]
    assert 0.85 <= band["inside"]["fit"] <= 0.95
    assert 0.85 <= band["inside"]["validate"] <= 0.97
    # The recording set aside is faster than the one fitted.
    assert band["outside"]["fit"] == 0.0
    assert 0.1 < band["outside"]["later"] < 0.9


@pytest.mark.usefixtures("undrawn")
def test_ladder_and_score_are_printed_recorded_and_reported(campaign, tmp_path, capsys):
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
    assert second["fit"]["validate_rms"] < first["fit"]["validate_rms"]
    assert second["angle_rms"] < first["angle_rms"]
    assert record["fitted"].keys() == {"Mc", "Ms", "omega_sf", "sigma_2", "J"}
    carried = record["transfer"]
    assert carried["source"] == str(other)
    assert set(carried["parameters"]) == set(record["parameters"])
    assert "friday.csv" in {Path(entry["file"]).name for entry in record["inputs"]}


def test_score_on_what_was_fitted_is_refused(campaign, capsys):
    assert status(["identify", str(campaign), "--bandwidth", "40", "--score", str(campaign)]) == 2
    assert "was fitted to this recording" in capsys.readouterr().err


LAGGING = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100}
defaults: {channels: {time: t, angle: q, motor_angle: phi, current: i}}
recordings:
  - {file: free.csv}
  - {file: later.csv, role: validate}
"""
PARAMETERS = {"J": 0.2, "Mc": 6.0, "Ms": 6.0, "omega_sf": 0.05, "sigma_2": 5.0}
LARGER = 0.6
GAP = 0.004


@pytest.fixture
def lagging(tmp_path: Path) -> Path:
    """Recordings with asymmetric Coulomb friction and backlash."""
    time = np.arange(2400) / 200.0
    for name, w in (("free", 1.6), ("later", 1.3)):
        angle, speed = 0.4 * np.sin(w * time), 0.4 * w * np.cos(w * time)
        torque = -0.2 * w * w * angle + 6.0 * np.sign(speed) + 5.0 * speed + LARGER
        motor = 100.0 * (angle + 0.5 * GAP * np.sign(torque))
        rows = np.column_stack([time, angle, motor, torque / 3.0])
        place, head = tmp_path / f"{name}.csv", "t,q,phi,i"
        np.savetxt(place, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    path = tmp_path / "bench.yaml"
    path.write_text(LAGGING)
    return path


def diagnosed(tmp_path: Path, **more: Any) -> Path:
    def effect(name: str, **parameters: float) -> dict[str, Any]:
        given = {k: {"value": v, "low": v, "high": v, "unit": ""} for k, v in parameters.items()}
        return {"name": name, "where": {"recordings": ["free"]}, "parameters": given}

    record = {
        "schema": "loadrig.diagnose/1",
        "parameters": PARAMETERS,
        "alpha": 2.0,
        "effects": [
            effect("asymmetric_coulomb", torque_Nm=LARGER),
            effect("backlash", gap_rad=GAP),
        ],
        "curve": None,
        **more,
    }
    path = tmp_path / "found.json"
    path.write_text(json.dumps(record))
    return path


def test_the_corrected_model_predicts_what_the_nominal_one_does_not(lagging, tmp_path, capsys):
    out, file = tmp_path / "out", tmp_path / "sim.json"
    arguments = [
        "simulate",
        str(lagging),
        "--result",
        str(diagnosed(tmp_path)),
        "--bandwidth",
        "10",
    ]
    assert status([*arguments, "--out", str(out), "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    rows = {(bool(r["effects"]), r["equation"]): r for r in record["equations"]}
    for role in ("rms", "validate_rms"):
        assert rows[True, "torque"][role] < 0.02
        assert rows[False, "torque"][role] == pytest.approx(LARGER, abs=0.03)
        assert rows[True, "transmission"][role] < 0.35 * rows[False, "transmission"][role]
    assert rows[False, "transmission"]["unit"] == "rad"
    assert record["closed_loop"] is None
    printed = " ".join(capsys.readouterr().out.split())
    assert re.search(r"asymmetric_coulomb, backlash torque [\d.e-]+ [\d.e-]+ N m", printed)
    assert re.search(r"none torque 0\.[56]\d* 0\.[56]\d* N m", printed)
    assert "note: no closed loop: the controller of these recordings is not declared" in printed
    assert {p.stem for p in (out / "figures").iterdir()} == {"predicted_free", "predicted_later"}
    assert "found.json" in (out / "report.html").read_text()


def test_the_band_is_around_the_torque_of_the_recording_in_its_place(
    lagging: Path, tmp_path: Path
) -> None:
    """A drift goes on from recording to recording."""
    later = np.loadtxt(tmp_path / "later.csv", delimiter=",", skiprows=1)
    later[:, 0] += 20.0
    np.savetxt(tmp_path / "later.csv", later, delimiter=",", header="t,q,phi,i", comments="")
    drift = {"rate_Nm_s": 0.05, "time_s": 1000.0}
    given = {k: {"value": v, "low": v, "high": v, "unit": ""} for k, v in drift.items()}
    found = diagnosed(
        tmp_path,
        effects=[{"name": "coulomb_drift", "where": {"recordings": []}, "parameters": given}],
        covariance={"names": ["Mc"], "matrix": [[1e-4]], "freedom": None},
        fit={"equation": "torque", "unit": "N m", "final_rms": 0.1, "bandwidth_Hz": 10.0},
        ranges={},
    )
    made = simulate_source(lagging, found, None, lambda *_: None)
    parts = [p for p in made.predictions[0].parts if p.equation == "torque"]
    assert len(made.bands) == len(parts) == 2
    for band, part in zip(made.bands, parts, strict=True):
        np.testing.assert_allclose(band.torque, part.model, atol=1e-9)


def test_a_curve_is_carried_where_there_is_no_name(lagging: Path, tmp_path: Path) -> None:
    grid = [-0.5, 0.5]
    curve = {
        "equation": "torque", "coordinate": "angle", "unit": "rad", "residual_unit": "N m",
         "grid": grid,
        "value": [LARGER, LARGER],
    }  # fmt: skip
    file = tmp_path / "sim.json"
    found = diagnosed(tmp_path, effects=[], curve=curve)
    arguments = ["simulate", str(lagging), "--result", str(found), "--bandwidth", "10"]
    assert status([*arguments, "--out", str(tmp_path / "out"), "--json", str(file)]) == 0
    rows = {
        tuple(r["effects"]): r
        for r in json.loads(file.read_text())["equations"]
        if r["equation"] == "torque"
    }
    assert rows["curve",]["rms"] < 0.02
    assert rows[()]["rms"] == pytest.approx(LARGER, abs=0.03)


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"schema": "loadrig.paper/1"}, ["schema:", "'loadrig.paper/1'"]),
        ({"parameters": {"J": "much"}}, ["parameters.J:", "'much'"]),
        ({"effects": [{"name": "backlash", "parameters": {}}]}, ["backlash", "gap_rad"]),
        ({"parameters": {"J": {"value": 95.1, "unit": "kg"}}}, ["motion:", "linear"]),
    ],
)
def test_a_file_that_is_no_result(more, named, lagging, tmp_path, capsys):
    found = diagnosed(tmp_path, **more)
    out = tmp_path / "out"
    assert status(["simulate", str(lagging), "--result", str(found), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(str(found))
    assert all(name in error for name in named)
