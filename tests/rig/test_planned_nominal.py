"""What a plan takes from the result of an identification."""

import json
from pathlib import Path

import pytest

from identification.design.simulated import NAMES
from identification.model.parameters import NOMINAL
from rig.common.errors import InputError
from rig.common.provenance import IDENTIFY_SCHEMA
from rig.results.identify.design import nominal_values


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
def test_a_parameter_that_no_machine_can_have_is_refused(
    tmp_path: Path, value: float, possible: bool
) -> None:
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
