"""The report: self-contained, escaped, and every figure in the folder too."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.paper_method import identify_paper
from identification.recording import Bench, Dataset, Recording
from identification.result import Identification
from rig.common.provenance import Provenance
from rig.results.document import write_page
from rig.results.identify.document import identify_document
from rig.results.identify.identify import Outcome

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
    return Recording(name, channels, Bench(), role=role, notes=("one <b>correction</b>",))  # type: ignore[arg-type]


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
        dataset, bandwidth_Hz=0.5 * RATE, rng=np.random.default_rng(0), generations=20
    )
    other = dataclasses.replace(result, method="default", warnings=("mind <the> gap",))
    written(path, dataset, other, result, truth={"Mc": 7.0, "Ms": 12.0}, name="bench & test")
    return path


def test_nothing_is_fetched_from_outside(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script|<link|@import|url\(", page)
    sources = re.findall(r'<img[^>]*src="([^"]{0,30})', page)
    assert len(sources) >= 8
    assert all(source.startswith("data:image/png;base64,") for source in sources)


def test_every_figure_is_a_file_too(folder: Path) -> None:
    names = {path.name for path in (folder / "figures").iterdir()}
    assert {
        "intervals.png",
        "stribeck_default.png",
        "stribeck_paper.png",
        "convergence_paper_unloaded.png",
    } <= names
    assert {"response_a_1.png", "response_b_c.png", "residual_late.png"} <= names
    assert all((folder / "figures" / name).read_bytes().startswith(b"\x89PNG") for name in names)


def test_text_is_escaped(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "<b>" not in page
    assert "mind &lt;the&gt; gap" in page
    assert "<h1>Identification of bench &amp; test</h1>" in page


def test_it_says_what_the_records_say(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in (
        "not identifiable",
        "validate",
        "genetic algorithm",
        "true",
        "simulated bench",
        "seed",
    ):
        assert words in page


@pytest.mark.usefixtures("undrawn")
def test_many_recordings_are_cut_short_and_there_is_no_truth_unless_known(tmp_path: Path) -> None:
    many = Dataset(tuple(recording(f"r{k}") for k in range(8)))
    result = identify_paper(
        many, bandwidth_Hz=0.5 * RATE, rng=np.random.default_rng(0), generations=2
    )
    page = written(tmp_path, many, result)
    assert "2 more recordings" in page
    assert ">true<" not in page
