"""Result records: the contract's fields, and JSON that any reader takes."""

import json
from pathlib import Path

import numpy as np
import pytest

from identification.recording import Bench, Recording
from identification.result import Convergence, Fit, Identification, Parameter
from rig.common.places import write_json
from rig.common.provenance import Provenance, finite
from rig.results.identify.identify import identification_record


def result() -> Identification:
    stage = Convergence(
        "unloaded",
        "search",
        80,
        2,
        1.5,
        "N m",
        target=0.01,
        reached=False,
        cost_history=np.array([np.inf, 1.5]),
        parameter_history={"Mc": np.array([6.0, 6.9])},
    )
    parameters = {
        "Mc": Parameter("Mc", "N m", 6.9, 6.8, 7.0),
        "J": Parameter("J", "kg m^2", None, identifiable=False, reason="too slow"),
        "Ms": Parameter("Ms", "N m", np.float64(12.0), at_bound=True),
    }
    fit = Fit("N m", 40.0, 0.1, 0.01)
    return Identification(
        "default", "rotary", 2.0, parameters, fit, (stage,), ("slow",), (), {"a": fit}, 80, 0.5
    )


def provenance() -> Provenance:
    channels = {"time": np.arange(3.0), "torque": np.zeros(3)}
    recording = Recording("a", channels, Bench(), source="a.csv", sha256="ab" * 32)
    return Provenance.of(7, [recording, recording], 1.25)


def test_round_trip_through_json(tmp_path: Path) -> None:
    record = identification_record(result(), provenance())
    write_json(tmp_path / "identify.json", record)
    read = json.loads((tmp_path / "identify.json").read_text(), parse_constant=pytest.fail)
    assert read == record
    assert read["schema"] == "loadrig.identify/1"
    assert read["seed"] == 7
    assert read["seconds"] == 1.25
    assert read["version"] == read["versions"]["loadrig"]
    assert read["inputs"] == [{"file": "a.csv", "sha256": "ab" * 32}]
    assert read["parameters"]["J"] == {
        "value": None,
        "low": None,
        "high": None,
        "unit": "kg m^2",
        "identifiable": False,
        "at_bound": False,
        "reason": "too slow",
        "floor": None,
    }
    assert read["parameters"]["Ms"]["at_bound"] is True
    assert read["fit"]["validate_rms"] is None
    assert read["stages"][0]["evaluations"] == 80
    assert read["convergence"]["unloaded"] == {
        "cost": [None, 1.5],
        "parameters": {"Mc": [6.0, 6.9]},
    }
    assert read["warnings"] == ["slow"]


@pytest.mark.parametrize(
    ("value", "expected"), [(None, None), (np.nan, None), (np.inf, None), (np.float64(2.0), 2.0)]
)
def test_finite(value: float | None, expected: float | None) -> None:
    assert finite(value) == expected
