"""``rig simulate`` as a user runs it, on recordings whose physics is known."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.cli.entry import status

CAMPAIGN = """\
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
def campaign(tmp_path: Path) -> Path:
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
    path.write_text(CAMPAIGN)
    return path


def result(tmp_path: Path, **more: Any) -> Path:
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


def test_the_corrected_model_predicts_what_the_nominal_one_does_not(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, file = tmp_path / "out", tmp_path / "sim.json"
    arguments = ["simulate", str(campaign), "--result", str(result(tmp_path)), "--bandwidth", "10"]
    assert status([*arguments, "--out", str(out), "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    rows = {(bool(r["effects"]), r["equation"]): r for r in record["equations"]}
    for role in ("rms", "validate_rms"):
        assert rows[True, "torque"][role] < 0.02
        assert rows[False, "torque"][role] == pytest.approx(LARGER, abs=0.03)
        assert rows[True, "transmission"][role] < 0.35 * rows[False, "transmission"][role]
    assert rows[False, "transmission"]["unit"] == "rad"
    assert record["cases"] == []
    printed = " ".join(capsys.readouterr().out.split())
    assert re.search(r"found asymmetric_coulomb, backlash torque [\d.e-]+ [\d.e-]+ N m", printed)
    assert re.search(r"found none torque 0\.[56]\d* 0\.[56]\d* N m", printed)
    assert "note: no closed loop: the controller of these recordings is not declared" in printed
    assert {p.stem for p in (out / "figures").iterdir()} == {"predicted_free", "predicted_later"}
    assert "found.json" in (out / "report.html").read_text()


def test_a_curve_is_carried_where_there_is_no_name(campaign: Path, tmp_path: Path) -> None:
    grid = [-0.5, 0.5]
    curve = {
        "equation": "torque", "coordinate": "angle", "unit": "rad", "residual_unit": "N m",
         "grid": grid,
        "value": [LARGER, LARGER],
    }  # fmt: skip
    file = tmp_path / "sim.json"
    found = result(tmp_path, effects=[], curve=curve)
    arguments = ["simulate", str(campaign), "--result", str(found), "--bandwidth", "10"]
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
def test_a_file_that_is_no_result(
    more: dict[str, Any],
    named: list[str],
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = result(tmp_path, **more)
    out = tmp_path / "out"
    assert status(["simulate", str(campaign), "--result", str(found), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(str(found))
    assert all(name in error for name in named)
