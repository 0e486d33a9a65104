"""``rig identify`` of a campaign with units, as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig.cli.entry import status

CAMPAIGN = """\
campaign: 1
bench: {}
model: {friction: coulomb_viscous, shared: [J]}
defaults:
  channels: {time: t, angle: q, torque: tau}
recordings: {table: files.csv}
"""


def record(path: Path, coulomb: float, seed: int) -> None:
    t = np.arange(2000) / 250.0
    angle = 0.8 * np.sin(1.9 * t) + 0.2 * np.sin(4.7 * t + 0.5)
    speed, rate = np.gradient(angle, t), np.gradient(np.gradient(angle, t), t)
    noise = 0.05 * np.random.default_rng(seed).normal(size=len(t))
    torque = coulomb * np.sign(speed) + 0.5 * speed + 0.3 * rate + noise
    rows = np.column_stack([t, angle, torque])
    np.savetxt(path, rows, "%.9g", ",", header="t,q,tau", comments="")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rows = tmp_path_factory.mktemp("fleet"), ["file,unit,start"]
    for k, coulomb in enumerate((1.9, 2.1, 2.0, 1.95, 2.05)):
        days = (coulomb, coulomb + 4.0) if k == 4 else (coulomb,)
        for day, value in enumerate(days, 1):
            record(folder / f"{k}_{day}.csv", value, 10 * k + day)
            rows.append(f"{k}_{day}.csv,{k},2026-03-0{day}T08:00:00")
    (folder / "files.csv").write_text("\n".join(rows) + "\n")
    (folder / "fleet.yaml").write_text(CAMPAIGN)
    return folder / "fleet.yaml"


def test_units_are_identified_apart_and_together(campaign: Path, tmp_path: Path) -> None:
    out, result = tmp_path / "out", tmp_path / "fleet.json"
    assert status(["identify", str(campaign), "--out", str(out), "--json", str(result)]) == 0
    found = json.loads(result.read_text())
    assert found["schema"] == "loadrig.fleet/1"
    assert (out / "report.html").exists()
    assert {*found["units"]} == {*"01234"}
    assert json.loads((out / "2" / "identify.json").read_text())["parameters"]["J"]["value"]
    shared = found["shared"]["J"]
    assert shared["low"] <= 0.3 <= shared["high"]
    assert found["parameter_units"]["J"] == "kg m^2"
    assert found["misfit"]["4"]
    mean = found["populations"]["Mc"]["mean"]
    assert mean["low"] <= 2.0 <= mean["high"]
    (odd,) = [o for o in found["odd"] if o["parameter"] == "Mc"]
    assert (odd["unit"], odd["since"]) == ("4", "2026-03-02 08:00")


def test_what_takes_one_unit_refuses_several(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["diagnose", str(campaign)]) == 2
    assert "5 units" in capsys.readouterr().err
    assert status(["identify", str(campaign), "--ladder"]) == 2


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("shared: [J]", "shared: [J], per_unit: [J]", "model.per_unit"),
        ("{table: files.csv}", "[{file: 0_1.csv, unit: a}, {file: 1_1.csv}]", "recordings[1].unit"),
        ("{table: files.csv}", "[{file: 0_1.csv}]", "model.shared"),
        ("{table: files.csv}", "[{file: 0_1.csv, unit: a/b}]", "recordings[0].unit"),
    ],
)
def test_wrong_units_are_errors_with_their_place(
    old: str, new: str, place: str, campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = campaign.with_name("wrong.yaml")
    path.write_text(CAMPAIGN.replace(old, new))
    assert status(["identify", str(path)]) == 2
    assert f"{place}:" in capsys.readouterr().err
