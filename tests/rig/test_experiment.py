"""``rig identify --plan`` as a user runs it, and what a plan takes from a result."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.design import propose, search
from identification.design.search import Excitation, Ramps
from identification.design.simulated import NAMES
from identification.model.parameters import NOMINAL
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.provenance import IDENTIFY_SCHEMA
from rig.config.sequence import StageSection, Tone, excitation
from rig.results.identify.design import _with, excitation_words, nominal_values

from .benches import sine, stages

SEQUENCE = stages(sine("free", 15, 0.4, 8))


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    few = (
        (propose, "CANDIDATES", (8, 8)),
        (propose, "REFINEMENTS", 1),
        (propose, "TOGETHER", 2),
        (propose, "NOISES", 1),
        (search, "DESIGNS", 1),
    )
    for module, name, value in few:
        monkeypatch.setattr(module, name, value)


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SEQUENCE)
    return path


@pytest.mark.proof
def test_the_proposal_runs(sequence, tmp_path, capsys):
    out = tmp_path / "planned"
    assert status(["identify", "--plan", str(sequence), "--out", str(out)]) == 0
    assert "times tighter" in capsys.readouterr().out
    record = json.loads((out / "plan.json").read_text())
    assert record["schema"] == "loadrig.plan/1"
    assert record["current_noise_A"] == pytest.approx(0.025)
    assert set(record["present"]["relative_half_widths"]) == set(NAMES[:5])
    proposed = yaml.safe_load((out / "proposal.yaml").read_text())
    times = [stage["duration_s"] + stage.get("settle_s", 0.2) for stage in proposed["stages"]]
    assert 5.0 < sum(times) <= 8.2 + 1e-6
    assert proposed == record["proposed"]["sequence"]
    assert status(["run", str(out / "proposal.yaml"), "--dry-run"]) == 0


@settings(deadline=None)
@given(speed=st.floats(0.01, 1.5), away=st.integers(10, 125), times=st.integers(2, 6))
def test_ramps_are_written_so_that_they_read_back(speed: float, away: int, times: int) -> None:
    ramps = Excitation((), 40.0, 0.0, Ramps(speed, away / 100.0)).lasting(times * away / 50.0)
    stage = StageSection(
        name="s",
        stage="loaded",
        weight_kg=5,
        tones=(Tone(amplitude_deg=9, frequency_Hz=1),),
        duration_s=9,
        ramp_in_s=0.5,
    )
    written = _with(stage, ramps, "s-1")
    again = StageSection.model_validate(
        yaml.safe_load(yaml.safe_dump(written.model_dump(exclude_defaults=True)))
    )
    assert again == written
    assert again.duration_s == pytest.approx(ramps.seconds) == pytest.approx(times * away / 50.0)
    assert f"{times} times" in excitation_words(again)
    angles = excitation(again, 0.001)
    assert np.max(angles) == pytest.approx(speed * away / 100.0, rel=0.01, abs=2e-3 * speed + 2e-5)
    assert abs(angles[-1]) < 0.02 * speed + 2e-4
    peaks = np.sum((angles[1:-1] > angles[:-2]) & (angles[1:-1] >= angles[2:]))
    assert peaks == times


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


def test_an_undetermined_parameter_is_the_weakest_and_has_its_default_value(tmp_path: Path) -> None:
    path = result(tmp_path)
    record = json.loads(path.read_text())
    record["parameters"]["mu_2"] = {"value": None, "low": None, "high": None}
    path.write_text(json.dumps(record))
    known = nominal_values(path)
    assert known.weakest == "mu_2"
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
