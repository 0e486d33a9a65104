"""What a campaign says is known, through the commands: results, report, warnings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig.cli.entry import status

G, GEAR = 9.80665, 3.0
CAMPAIGN = """\
campaign: 1
bench: {torque_constant: {value: 0.03, std: 0.001}, gear_ratio: 100}
model: {fixed: {J: {value: 0.22, std: 0.02}}}
defaults: {channels: {time: t, current: i, angle: a}}
recordings: {table: files.csv}
"""
TABLE = """\
file,start,hoisted.mass,hoisted.radius,window.from,role
bare.csv,0,,,,
light.csv,100,3,0.3,2.0,
heavy.csv,300,6,0.3,,validate
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Sines of a joint with J = 0.2 kg m^2 and 7 N m of Coulomb friction that lifts a mass."""
    rng = np.random.default_rng(0)
    time = np.arange(15_000) / 1000.0 + 2e-4
    for name, hertz, mass in (("bare", 0.2, 0.0), ("light", 0.5, 3.0), ("heavy", 0.4, 6.0)):
        w = 2.0 * np.pi * hertz
        speed, acceleration = 0.3 * w * np.cos(w * time), -0.3 * w * w * np.sin(w * time)
        torque = (0.2 + mass * 0.09) * acceleration + 7.0 * np.sign(speed) + 5.0 * speed
        torque += mass * G * 0.3 + rng.normal(0.0, 0.1, len(time))
        columns = np.column_stack([time, 0.3 * np.sin(w * time), torque / GEAR])
        np.savetxt(
            tmp_path / f"{name}.csv", columns, "%.8g", delimiter=",", header="t,a,i", comments=""
        )
    (tmp_path / "files.csv").write_text(TABLE)
    (tmp_path / "c.yaml").write_text(CAMPAIGN)
    return tmp_path / "c.yaml"


@pytest.mark.usefixtures("undrawn")
def test_identify_uses_and_shows_all_of_it(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert status(["identify", str(source), "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "begins 0 s into the session" in said
    assert "hoisted 3 kg: -8.826 N m on the joint" in said
    assert "window 2 s to the end" in said
    assert "recordings alone" in said
    assert "bench.torque_constant 0.03 +- 0.001" in said
    found = json.loads((out / "identify.json").read_text())
    mc, prior = found["parameters"]["Mc"], found["priors"]["J"]
    assert mc["value"] == pytest.approx(7.0, rel=0.05)
    assert mc["high"] - mc["low"] > 2.0 * 1.6 * mc["value"] * 0.001 / 0.03 * 0.8
    assert prior["alone"] == pytest.approx(0.2, abs=0.01)
    assert prior["alone"] <= prior["posterior"] <= prior["value"] == 0.22
    assert found["known_constants"][0]["shifts"]["Mc"] == pytest.approx(7.0 / 30.0, rel=0.05)
    assert found["fit"]["validate_rms"] < 0.2
    assert inputs_of(out / "identify.json") >= {"c.yaml", "files.csv", "bare.csv"}
    report = (out / "report.html").read_text()
    assert "recordings alone" in report
    assert "hoisted 6 kg" in report


def inputs_of(file: Path) -> set[str]:
    """Return the names of a result's input files."""
    return {Path(one["file"]).name for one in json.loads(file.read_text())["inputs"]}
