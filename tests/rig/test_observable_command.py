"""``rig diagnose --observable`` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from identification.diagnosis.observable import Observable
from rig.cli.entry import status
from rig.results.diagnose import document

SHOWN = Observable("cogging", 0.9, {"torque_Nm": 0.011, "per_motor_turn": 7.0}, {})
CONFUSED = Observable("torque_ripple", 0.8, {"fraction": 0.02}, {"cogging": 0.98})
HIDDEN = Observable("backlash", 0.0, {}, {})


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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


def test_the_table_has_size_share_and_what_looks_the_same(
    campaign: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    record = tmp_path / "observable.json"
    assert status(["diagnose", str(campaign), "--observable", "--json", str(record)]) == 0
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


def test_it_goes_with_no_other_kind_of_diagnosis(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["diagnose", str(campaign), "--observable", "--gas"]) == 2
    assert "--observable cannot be combined with" in capsys.readouterr().err
