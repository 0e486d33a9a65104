"""Whole investigations on the simulated bench, minutes each."""

import json

import pytest

from rig.cli.entry import status
from rig.config.sequence import load_sequence
from rig.runs.run_file import read_record
from tests.rig.benches import variant

CONTRACT = {"verdict", "effects", "fit", "experiments", "bench_seconds", "confirmation"}


@pytest.mark.proof
def test_an_asymmetry_that_grows_with_speed_is_named(tmp_path, monkeypatch):
    hidden = "effects: {asymmetric_viscous: {coefficient_Nms_rad: 1.2}}"
    bench = variant(tmp_path, ("effects: {}", hidden))
    out, result = tmp_path / "out", tmp_path / "result.json"
    arguments = ["investigate", "figure10", "--bench", str(bench), "--yes", "--budget", "40"]
    monkeypatch.chdir(tmp_path)
    assert status([*arguments, "--out", str(out), "--json", str(result)]) == 0
    found = json.loads(result.read_text())
    assert found.keys() >= CONTRACT | {"cannot_separate"}
    assert [e["name"] for e in found["effects"]] == ["asymmetric_viscous"]
    assert found["verdict"] == "named"
    assert found["bench_seconds"] == pytest.approx(sum(e["seconds"] for e in found["experiments"]))
    assert found["bench_seconds"] <= 60.0 * 40.0
    for e in found["experiments"]:
        assert e.keys() >= {"run", "sequence", "reason", "seconds", "weight_changes", "state"}
        assert read_record(out / e["run"]).state == e["state"] == "done"
        assert load_sequence(out / e["sequence"])
    assert found["confirmation"]["band_held"] > 0.7
    assert found["confirmation"]["error_rms"] < 2.0 * found["confirmation"]["floor_rms"]
    assert (out / "investigation.html").stat().st_size > 10_000
    assert {"model.py", "model.yaml", "bench.yaml"} <= {f.name for f in out.iterdir()}
