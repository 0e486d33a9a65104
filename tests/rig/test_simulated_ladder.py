"""``rig identify --ladder`` on a voltage bench: the fits to the simulated angle."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.ladder import climb
from identification.estimate.simulated_ladder import climb_simulated
from identification.model.parameters import DIRECTIONAL, SIMULATED, TRANSMITTED
from rig.cli.entry import status
from rig.sources import load_source

from ..identification.voltage_lever import GAIN, LIMIT, TRUE_KM, TRUE_R, lever

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"
HEAD = f"""\
campaign: 1
bench:
  torque_constant: {{value: 0.5, std: 0.1}}
  back_emf_constant: 0.5
  resistance: 4.0
defaults:
  controller: {{output: duty, position_gain: {GAIN}, limit: {LIMIT}}}
  channels: {{time: t, angle: q, command: c, supply_voltage: s, voltage: u}}
recordings:
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lever")
    text = HEAD
    for k, (mass, length) in enumerate(((0.4, 0.05), (0.4, 0.08), (0.4, 0.11), (0.8, 0.08))):
        made = lever(mass, length, seed=k, duration=2.5)
        columns = ("time", "angle", "command", "supply_voltage", "voltage")
        rows = np.column_stack([made.channels[c] for c in columns])
        name = f"{k}.csv"
        np.savetxt(folder / name, rows, delimiter=",", header="t,q,c,s,u", comments="", fmt="%.9g")
        role = "validate" if mass > 0.5 else "fit"
        hung = f"{{mass: {mass}, length: {length}, zero: 0.1}}"
        text += f"  - {{file: {name}, role: {role}, gravity: {hung}}}\n"
    path = folder / "lever.yaml"
    path.write_text(text)
    return path


@pytest.mark.usefixtures("undrawn")
def test_the_fits_to_the_simulated_angle_are_printed_and_recorded(
    campaign: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for climbing in (climb, climb_simulated):
        few = partial(climbing, replicates=4)
        monkeypatch.setattr(f"rig.results.identify.identify.{climbing.__name__}", few)
    out = tmp_path / "out"
    assert status(["identify", str(campaign), "--ladder", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    table = printed.split("Friction models fitted to the simulated angle")[1].splitlines()
    record = json.loads((out / "identify.json").read_text())
    rungs = record["simulated_ladder"]
    assert [r["friction"] for r in rungs] == [name for name in SIMULATED for _ in range(2)]
    assert {r["motor_constants"] for r in rungs} == {"free", "declared"}
    free = {r["friction"]: r for r in rungs if r["motor_constants"] == "free"}[TRANSMITTED]
    drive = free["constants"]["torque_per_volt"]
    assert drive["declared"] == 0.125
    assert drive["value"] == pytest.approx(TRUE_KM / TRUE_R, rel=0.04)
    assert drive["moved"]
    assert drive["relative_change"] == pytest.approx(drive["value"] / drive["declared"] - 1.0)
    assert free["constants"]["torque_constant"]["prior_relative_std"] == pytest.approx(0.2)
    assert free["constants"]["resistance"]["prior_relative_std"] == pytest.approx(0.3)
    row = next(line for line in table if line.startswith(TRANSMITTED) and " free " in line)
    assert f"{100.0 * drive['relative_change']:+.1f} % changed" in row
    assert f"{1e3 * free['validate_mae']['value']:.3g}" in row
    for rung in record["ladder"]:
        assert 0.0 < rung["angle_mae"]["value"] <= rung["angle_rms"]["value"]
    best = next(r for r in rungs if r["chosen"] and r["motor_constants"] == "free")
    assert f"{best['friction']}: torque per volt at rest 0.125 declared" in printed
    assert best["tied"]
    assert (out / "report.html").is_file()


@pytest.mark.proof
@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "declared_mrad", "free_mrad"),
    [("sts3032_to_light.yaml", 12.0, 7.7), ("sts3032_to_heavy.yaml", 22.8, 17.5)],
)
def test_sts3032_predicts_the_angle_of_the_other_mass(
    recordings: Path, name: str, declared_mrad: float, free_mrad: float
) -> None:
    """Mean absolute errors of the loop simulated from its command, supply and first sample."""
    rungs = {
        (r.friction, r.free): r
        for r in climb_simulated(
            load_source(CAMPAIGNS / name),
            bandwidth_Hz=None,
            rng=np.random.default_rng(0),
            replicates=2,
        )
    }
    for friction in (TRANSMITTED, DIRECTIONAL):
        declared, free = (rungs[friction, way].scored for way in (False, True))
        assert declared is not None
        assert free is not None
        assert 1e3 * declared.value < declared_mrad
        assert 1e3 * free.value < free_mrad
        drive = next(c for c in rungs[friction, True].constants if c.name == "torque_per_volt")
        assert 0.15 < drive.change < 0.45
        assert drive.moved
