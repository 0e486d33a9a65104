"""``rig diagnose`` and ``rig effects`` as a user runs them, on hand-made diagnoses."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from markupsafe import escape

import rig.results.diagnose.diagnose
from identification.diagnosis.observable import Observable
from identification.diagnosis.result import Diagnosis
from identification.effects import EFFECTS
from identification.recording import Dataset
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.results.diagnose import document
from rig.results.diagnose.diagnose import diagnose_source

from .diagnoses import AMBIGUOUS, EACH, NAMED

PLAIN = dataclasses.replace(NAMED, maps=(), traces=())
"""Without figures, for tests that look at none."""
CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095, lever_ratio: 10}
defaults: {channels: {time: t, angle: q, current: i}}
recordings:
  - {file: free.csv, stage: unloaded}
  - {file: heavy.csv, stage: loaded, weight_mass: 30.6}
  - {file: later.csv, stage: unloaded, role: validate}
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    time = np.arange(400) / 100.0
    for name in ("free", "heavy", "later"):
        rows = np.column_stack([time, 0.3 * np.sin(2.0 * time), 2.0 + np.cos(2.0 * time)])
        np.savetxt(
            tmp_path / f"{name}.csv", rows, delimiter=",", header="t,q,i", comments="", fmt="%.9g"
        )
    path = tmp_path / "bench.yaml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture
def found(
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[Diagnosis], list[tuple[float | None, float]]]:
    """Make the numerics return a given diagnosis; returns what they are called with."""

    def arrange(diagnosis: Diagnosis) -> list[tuple[float | None, float]]:
        calls: list[tuple[float | None, float]] = []

        def numerics(
            dataset: Dataset, *, bandwidth_Hz: float | None, rng: np.random.Generator, **_: object
        ) -> Diagnosis:
            assert [r.role for r in dataset.recordings] == ["fit", "fit", "validate"]
            calls.append((bandwidth_Hz, float(rng.random())))
            return diagnosis

        monkeypatch.setattr(rig.results.diagnose.diagnose, "diagnose", numerics)
        return calls

    return arrange


Arrange = Callable[[Diagnosis], list[tuple[float | None, float]]]


@pytest.mark.parametrize("verdict", list(EACH))
def test_every_verdict_is_printed_written_and_drawn(verdict, campaign, tmp_path, found, capsys):
    diagnosis = EACH[verdict]
    calls = found(diagnosis)
    out, file = tmp_path / "out", tmp_path / "result.json"
    arguments = ["diagnose", str(campaign), "--out", str(out), "--json", str(file)]
    assert status([*arguments, "--seed", "5", "--bandwidth", "12"]) == 0
    assert calls == [(12.0, np.random.default_rng(5).random())]
    printed = " ".join(capsys.readouterr().out.split())
    assert diagnosis.statement in printed
    record = json.loads(file.read_text())
    assert record == json.loads((out / "diagnose.json").read_text())
    assert record["verdict"] == verdict
    page = (out / "report.html").read_text()
    assert page.index(str(escape(diagnosis.statement))) < page.index("<h2>")
    assert not re.search(r"https?://|<script|<link|url\(", page)
    drawn = {path.stem for path in (out / "figures").iterdir()}
    assert {"maps_transmission", "maps_torque", f"mismatch_{diagnosis.fit.equation}_later"} <= drawn
    assert ("missing" in drawn) is (verdict == "outside_catalogue")
    assert page.count("<img") == len(drawn)


@pytest.mark.usefixtures("undrawn")
def test_the_record_is_the_contracts(campaign: Path, tmp_path: Path, found: Arrange) -> None:
    found(PLAIN)
    record = diagnose_source(campaign, 3).record()
    json.dumps(record, allow_nan=False)
    assert record["schema"] == "loadrig.diagnose/1"
    assert record["seed"] == 3
    assert {Path(entry["file"]).name for entry in record["inputs"]} == {
        "bench.yaml", "free.csv", "heavy.csv", "later.csv",
    }  # fmt: skip
    effect = record["effects"][0]
    assert set(effect) == {
        "name", "alias_group", "confidence", "statement", "assumption_broken", "where",
        "parameters", "rivals",
        "separating_experiment",
    }  # fmt: skip
    assert effect["where"]["ranges"] == [[0.0, 0.0073]]
    assert (
        effect["parameters"]["gap_rad"]["low"]
        < effect["parameters"]["gap_rad"]["value"]
        == pytest.approx(0.00733, rel=1e-3)
    )
    assert effect["parameters"]["gap_rad"]["unit"] == "rad"
    assert [r["name"] for r in effect["rivals"]] == ["compliance", "transport_delay"]
    assert {
        "unit", "bandwidth_Hz", "baseline_rms", "final_rms", "noise_floor_rms",
        "validate_baseline_rms",
        "validate_final_rms",
    } <= set(record["fit"])  # fmt: skip
    assert record["parameter_shift"]["J"] == {"before": None, "after": 0.204, "unit": "kg m^2"}
    assert record["p_value"] == 0.0005


@pytest.mark.usefixtures("undrawn")
def test_an_alias_group_comes_with_what_splits_it(campaign, tmp_path, found, capsys):
    found(dataclasses.replace(AMBIGUOUS, maps=(), traces=()))
    out = tmp_path / "out"
    assert status(["diagnose", str(campaign), "--out", str(out)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert AMBIGUOUS.effects[0].separating_experiment in printed
    assert "rig design" in (out / "report.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_the_corrected_model_lies_beside_the_report(campaign, tmp_path, found, capsys):
    found(PLAIN)
    out = tmp_path / "out"
    assert status(["diagnose", str(campaign), "--out", str(out)]) == 0
    assert "gap_rad: 0.0073" in (out / "model.yaml").read_text()
    assert "'backlash': {'gap_rad': 0.0073" in (out / "model.py").read_text()
    # The campaign does not say what a simulated motor needs.
    assert "note: a simulated bench needs resistance_ohm" in capsys.readouterr().out
    assert not (out / "bench.yaml").exists()
    text = campaign.read_text().replace(
        "bench: {", "bench: {resistance: 1.56, inductance: 0.001, back_emf_constant: 0.026, "
    )
    campaign.write_text(text)
    assert status(["diagnose", str(campaign), "--out", str(out)]) == 0
    hidden = load_bench(out / "bench.yaml").value.mock
    assert hidden.effects["quadratic_drag"] == {"coefficient_Nms2_rad2": 1.9}


def test_a_joint_that_never_moves_on_is_bad_input(tmp_path, capsys):
    time = np.arange(8000) / 400.0
    torque = 5.0 * np.abs((time % 4.0) - 2.0) - 5.0
    angle = 2e-4 * torque + 1e-5 * np.random.default_rng(0).standard_normal(len(time))
    table = np.column_stack([time, angle, torque])
    np.savetxt(tmp_path / "held.csv", table, "%.7f", ",", header="time,angle,torque", comments="")
    (tmp_path / "held.yaml").write_text(
        "campaign: 1\nbench: {motion: rotary}\nrecordings:\n"
        "  - file: held.csv\n    stage: unloaded\n"
        "    channels: {time: time, angle: angle, torque: torque}\n"
    )
    assert status(["diagnose", str(tmp_path / "held.yaml"), "--out", str(tmp_path / "out")]) == 2
    assert (
        "no sample of the recordings with role fit is in steady motion" in capsys.readouterr().err
    )


SHOWN = Observable("cogging", 0.9, {"torque_Nm": 0.011, "per_motor_turn": 7.0}, {})
CONFUSED = Observable("torque_ripple", 0.8, {"fraction": 0.02}, {"cogging": 0.98})
HIDDEN = Observable("backlash", 0.0, {}, {})


@pytest.fixture
def ramp_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(document, "observable_effects", lambda *_: (SHOWN, CONFUSED, HIDDEN))
    rows = [f"{0.001 * k:.3f},{0.01 * k:.2f},1" for k in range(400)]
    (tmp_path / "log.csv").write_text("\n".join(["t,q,tau", *rows]) + "\n")
    file = tmp_path / "bench.yaml"
    file.write_text(
        "campaign: 1\nbench: {motion: rotary}\n"
        "defaults: {stage: unloaded, channels: {time: t, angle: q, torque: tau}}\n"
        "recordings: [{file: log.csv}]\n"
    )
    return file


def test_the_table_has_size_share_and_what_looks_the_same(ramp_campaign, capsys, tmp_path):
    record = tmp_path / "observable.json"
    assert status(["diagnose", str(ramp_campaign), "--observable", "--json", str(record)]) == 0
    printed = capsys.readouterr().out
    assert "can show 2 of 3 effects; 1 of these effects cannot be distinguished" in printed
    assert "torque_Nm 0.011 N m" in printed
    assert "cogging 98 %" in printed
    assert "backlash." in printed
    assert "torque_ripple: One slow turn without load" in printed
    written = json.loads(record.read_text())
    assert written["schema"] == "loadrig.observable/1"
    assert [e["shown"] for e in written["effects"]] == [True, True, False]
    assert written["effects"][1]["alike"] == {"cogging": 0.98}
    assert not (tmp_path / "bench-diagnosed").exists()


def test_it_goes_with_no_other_kind_of_diagnosis(ramp_campaign, capsys):
    assert status(["diagnose", str(ramp_campaign), "--observable", "--gas"]) == 2
    assert "--observable cannot be combined with" in capsys.readouterr().err


def test_every_effect_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["effects"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [
        line.removeprefix(e.group).split()[0]
        for line, e in zip(lines[2:], EFFECTS.values(), strict=True)
    ] == list(EFFECTS)
    assert max(map(len, lines)) <= 130


def test_the_record_holds_what_is_printed(tmp_path, capsys):
    file = tmp_path / "effects.json"
    assert status(["effects", "--json", str(file)]) == 0
    record = json.loads(file.read_text())
    assert record["schema"] == "loadrig.effects/1"
    assert [e["name"] for e in record["effects"]] == list(EFFECTS)
    assert all(e["parameters"] and e["separating_experiment"] for e in record["effects"])
    assert capsys.readouterr().out


def test_a_misspelt_name_gets_a_suggestion(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["effects", "backlsh"]) == 2
    assert "did you mean 'backlash'?" in capsys.readouterr().err
