"""The report: self-contained, escaped, and every figure in the folder too; its record as JSON that
any reader takes.
"""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.paper_method import identify_paper
from identification.numerics.arrays import finite
from identification.recording import Dataset, Recording
from identification.result import Convergence, Fit, Identification, Parameter
from rig.common.places import write_json
from rig.common.provenance import Provenance
from rig.results.document import text, write_page
from rig.results.identify.document import identify_document
from rig.results.identify.identify import Outcome, identification_record, outcome_record

RATE = 50.0


def recording(name: str, role: str = "fit") -> Recording:
    time = np.arange(500) / RATE
    velocity = 0.4 * np.cos(1.3 * time)
    torque = np.sign(velocity) * (7.0 + 5.0 * np.exp(-((velocity / 0.06) ** 2))) + 5.0 * velocity
    channels = {
        "time": time,
        "angle": 0.4 / 1.3 * np.sin(1.3 * time),
        "velocity": velocity,
        "torque": torque,
    }
    return Recording(name=name, channels=channels, role=role, notes=("one <b>correction</b>",))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset((recording("a[1]"), recording("b/c"), recording("late", "validate")))


def written(
    folder: Path,
    dataset: Dataset,
    *results: Identification,
    truth: dict[str, float] | None = None,
    name: str = "t",
) -> str:
    """Write the page of an identification and return it."""
    outcome = Outcome(dataset, results, Provenance.of(3, dataset.recordings, 0.5))
    write_page(identify_document(name, outcome, truth), folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report")
    result = identify_paper(
        dataset, bandwidth_Hz=0.5 * RATE, rng=np.random.default_rng(0), generations=5
    )
    other = dataclasses.replace(result, method="default", warnings=("mind <the> gap",))
    written(path, dataset, other, result, truth={"Mc": 7.0, "Ms": 12.0}, name="bench & test")
    return path


def test_a_report_is_one_page_and_its_figures_are_files_too(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script|<link|@import|url\(", page)
    sources = re.findall(r'<img[^>]*src="([^"]{0,30})', page)
    assert len(sources) >= 8
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    names = {path.name for path in (folder / "figures").iterdir()}
    assert {
        "intervals.png",
        "stribeck_default.png",
        "stribeck_paper.png",
        "convergence_paper_unloaded.png",
    } <= names
    assert {"response_a_1.png", "response_b_c.png", "residual_late.png"} <= names
    assert all((folder / "figures" / name).read_bytes().startswith(b"\x89PNG") for name in names)
    assert "<b>" not in page
    assert "mind &lt;the&gt; gap" in page
    assert "<h1>Identification of bench &amp; test</h1>" in page
    for words in ("not identifiable", "validate", "genetic algorithm", ">true<", "seed"):
        assert words in page


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


@pytest.mark.usefixtures("undrawn")
def test_a_model_that_does_not_fit_heads_terminal_report_and_record(dataset: Dataset) -> None:
    chance = np.random.default_rng(0)
    found = identify_paper(dataset, bandwidth_Hz=0.5 * RATE, rng=chance, generations=2)
    good = dataclasses.replace(found, fit=Fit("N m", 40.0, 1.0, 0.01, noise_floor_rms=0.9))
    fit = Fit("N m", 40.0, 8.0, 0.9, noise_floor_rms=2.0)
    bounded = Parameter("J", "kg m^2", None, identifiable=False, at_bound=True)
    parameters = {n: dataclasses.replace(p, at_bound=False) for n, p in found.parameters.items()}
    bad = dataclasses.replace(found, fit=fit, parameters={**parameters, "J": bounded})
    outcome = Outcome(dataset, (bad,), provenance())
    shown = text(identify_document("bench", outcome))
    assert shown.startswith("This model does not describe this machine\n")
    for words in ("19 %", "J is at its bound 0", "is 4 times the noise floor", "2 N m"):
        assert words in shown.replace("\n", " ")
    outcome = dataclasses.replace(outcome, results=(bad, good))
    record = outcome_record(outcome)
    assert record["misfit"] == ["explains_little", "at_bounds", "above_noise_floor"]
    assert record["fit"]["noise_floor_rms"] == 2.0
    assert record["fit"]["explained"] == pytest.approx(0.19)
    good = dataclasses.replace(good, parameters=parameters)
    silent = text(identify_document("bench", dataclasses.replace(outcome, results=(good,))))
    assert silent.startswith("parameter")


def provenance() -> Provenance:
    channels = {"time": np.arange(3.0), "torque": np.zeros(3)}
    recording = Recording(name="a", channels=channels, source="a.csv", sha256="ab" * 32)
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
    assert [finite(value) for value in (None, np.nan, np.inf, np.float64(2.0))] == [
        None,
        None,
        None,
        2.0,
    ]
