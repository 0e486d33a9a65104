"""``rig identify --plan`` as a user runs it, and what a plan takes from a result."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from identification.design.simulated import NAMES
from identification.model.parameters import NOMINAL
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.provenance import IDENTIFY_SCHEMA
from rig.results.identify.plan import nominal_values

from .benches import sine, stages

SEQUENCE = stages(sine("free", 15, 0.4, 8))


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SEQUENCE)
    return path


def planned(path: Path, out: Path, text: str) -> dict[str, Any]:
    path.write_text(text)
    assert status(["identify", "--plan", str(path), "--out", str(out)]) == 0
    record: dict[str, Any] = json.loads((out / "plan.json").read_text())
    assert record["schema"] == "loadrig.plan/2"
    assert set(record["relative_half_widths"]) == set(NAMES[:5])
    assert record["weakest"] in NAMES
    return record


def test_a_plan_states_what_the_sequence_determines(tmp_path, capsys):
    record = planned(tmp_path / "short.yaml", tmp_path / "planned", SEQUENCE)
    assert "the least accurate is" in capsys.readouterr().out
    assert record["current_noise_A"] == pytest.approx(0.025)
    assert all(0.0 < width < 1.0 for width in record["relative_half_widths"].values())


def test_ramps_that_do_not_determine_everything_say_so(tmp_path, capsys):
    ramp = "ramp: {travel_deg: 8, speed_deg_s: 8, rest_s: 0.1, times: 3}"
    ramps = re.sub(r"tones: .*\]", ramp, SEQUENCE)
    widths = planned(tmp_path / "ramps.yaml", tmp_path / "out", ramps)["relative_half_widths"]
    assert f"does not determine {next(n for n, w in widths.items() if w is None)}" in (
        capsys.readouterr().out
    )


def test_a_hot_firing_cannot_be_planned(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["identify", "--plan", "hotfire", "--bench", "practical_hot"]) == 2
    assert "not with hot firings" in capsys.readouterr().err


def test_source_or_plan(sequence: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["identify"]) == 2
    assert status(["identify", "somewhere", "--plan", str(sequence)]) == 2
    assert "give either SOURCE" in capsys.readouterr().err


def result(folder: Path) -> Path:
    """Write a result in which J is 3 % wide, of recordings that are gone or changed."""
    recording = folder / "recording.mcap"
    recording.write_bytes(b"changed since")
    parameters = {n: {"value": 1.0, "low": 0.99, "high": 1.01} for n in NAMES}
    parameters["J"] = {"value": 2.0, "low": 1.94, "high": 2.06}
    inputs = [
        {"file": str(recording), "sha256": "0" * 64},
        {"file": str(folder / "gone" / "x"), "sha256": "0"},
    ]
    record = {"schema": IDENTIFY_SCHEMA, "motion": "rotary", "parameters": parameters}
    path = folder / "identify.json"
    path.write_text(json.dumps({**record, "inputs": inputs}))
    return path


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("--plan", "figure10", "--ladder", "--seed", "1"), "--ladder, --seed"),
        (("--plan", "figure10", "--method", "paper"), "--method"),
        ((".", "--nominal", "r.json", "--bench", "b.yaml"), "--bench, --nominal"),
    ],
)
def test_an_option_without_effect_is_refused(words, option, capsys) -> None:
    assert status(["identify", *words]) == 2
    assert f"{option}:" in capsys.readouterr().err


def test_an_undetermined_parameter_has_its_default_value(tmp_path: Path) -> None:
    path = result(tmp_path)
    record = json.loads(path.read_text())
    record["parameters"]["mu_2"] = {"value": None, "low": None, "high": None}
    path.write_text(json.dumps(record))
    known = nominal_values(path)
    assert known.values["mu_2"] == pytest.approx(NOMINAL["mu_2"])
    assert "mu_2, not determined by the result" in known.source


@pytest.mark.parametrize(
    ("value", "possible"),
    [(1.1e-12, True), (0.9e12, True), (0, False), (-1.0, False), (0.9e-12, False), (1.1e12, False)],
)
def test_a_parameter_that_no_machine_can_have_is_refused(tmp_path, value, possible):
    path = result(tmp_path)
    record = json.loads(path.read_text())
    record["parameters"]["mu_2"]["value"] = value
    path.write_text(json.dumps(record))
    if possible:
        assert nominal_values(path).values["mu_2"] == value
        return
    with pytest.raises(InputError, match=r"parameters\.mu_2: .* 1e-12 to 1e\+12"):
        nominal_values(path)


def test_recordings_that_have_changed_or_gone_say_nothing_of_the_drive(tmp_path: Path) -> None:
    assert nominal_values(result(tmp_path)).recordings == ()
    assert nominal_values(None).recordings == ()


def test_the_torque_s_noise_is_what_the_identification_found_of_both_parts(tmp_path: Path) -> None:
    path = result(tmp_path)
    assert nominal_values(path).torque_noise is None
    record = json.loads(path.read_text())
    for noise, expected in (
        ({"torque": 0.03, "correlated": 0.04, "unit": "N m"}, pytest.approx(0.05)),
        ({"torque": 0.03, "correlated": 0.04, "unit": "A"}, None),
        (None, None),
    ):
        path.write_text(json.dumps({**record, "noise": noise}))
        assert nominal_values(path).torque_noise == expected
