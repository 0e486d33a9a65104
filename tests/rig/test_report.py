"""The report, its record as JSON, and documents on the terminal, as a page and on the disk."""

from __future__ import annotations

import dataclasses
import errno
import json
import re
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.paper_method import identify_paper
from identification.recording import Bench, Dataset, Recording
from identification.result import Convergence, Fit, Identification, Parameter
from rig.common.errors import InputError
from rig.common.places import write_json
from rig.common.provenance import Provenance
from rig.results import document as files
from rig.results.document import (
    Block,
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    SideBySide,
    Table,
    Verdict,
    page,
    text,
    write_page,
    write_record,
    write_texts,
)
from rig.results.identify.document import identify_document
from rig.results.identify.identify import Outcome, identification_record

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


def test_the_page_stands_alone_and_is_escaped_and_each_figure_is_a_file_too(tmp_path: Path) -> None:
    dataset = Dataset((recording("a[1]"), recording("b/c"), recording("late", "validate")))
    rng = np.random.default_rng(0)
    result = identify_paper(dataset, bandwidth_Hz=0.5 * RATE, rng=rng, generations=20)
    other = dataclasses.replace(result, method="default", warnings=("mind <the> gap",))
    outcome = Outcome(dataset, (other, result), Provenance.of(3, dataset.recordings, 0.5))
    document = identify_document("bench & test", outcome, {"Mc": 7.0, "Ms": 12.0})
    write_page(document, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script|<link|@import|url\(", page)
    sources = re.findall(r'<img[^>]*src="([^"]{0,30})', page)
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert len(sources) == len(names) >= 8
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert {"stribeck_default.png", "convergence_paper_unloaded.png"} <= names
    assert {"response_a_1.png", "response_b_c.png", "residual_late.png"} <= names
    assert all((tmp_path / "figures" / name).read_bytes().startswith(b"\x89PNG") for name in names)
    assert "<b>" not in page
    assert "mind &lt;the&gt; gap" in page
    assert "<h1>Identification of bench &amp; test</h1>" in page


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
    missing = dict.fromkeys(("value", "low", "high", "floor"))
    said = {"unit": "kg m^2", "identifiable": False, "at_bound": False, "reason": "too slow"}
    assert read["parameters"]["J"] == missing | said
    assert read["parameters"]["Ms"]["at_bound"] is True
    assert read["fit"]["validate_rms"] is None
    assert read["stages"][0]["evaluations"] == 80
    assert read["convergence"]["unloaded"] == {
        "cost": [None, 1.5],
        "parameters": {"Mc": [6.0, 6.9]},
    }
    assert read["warnings"] == ["slow"]


LONG = "word " * 40
EVERY: dict[str, Block] = {
    "table": Table(("name", "value"), (("x", "1 <unit>"),), (1,)),
    "note": Note("a line & more", "warning"),
    "paragraph": Paragraph(LONG.strip(), "At first:"),
    "items": Items((("model.py", "the model"), ("", "a line of its own"))),
    "verdict": Verdict("All is well", "Nothing is left.", "good"),
    "picture": Picture("drawn", "What is drawn", b"\x89PNG"),
    "section": Section("Inside", (Note("within"),)),
    "beside": SideBySide(Section("Left", (Note("here"),)), Section("Right", (Note("there"),))),
}


def shown(*blocks: Block) -> str:
    return text(Document("t", "", (Section("", blocks),)))


def drawn(*blocks: Block) -> str:
    return page(Document("A & B", "below", (), (Section("Heading", blocks, "here"),)))


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("table", "name     value\n----  --------\nx     1 <unit>"),
        ("note", "warning: a line & more"),
        ("items", "  model.py: the model\n  a line of its own"),
        ("verdict", "All is well\nNothing is left."),
        ("picture", ""),
        ("section", "Inside\nwithin"),
        ("beside", "Left\nhere\nRight\nthere"),
    ],
)
def test_blocks_on_the_terminal(kind: str, expected: str) -> None:
    assert shown(EVERY[kind]) == expected


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("table", '<td>x</td><td class="number">1 &lt;unit&gt;</td>'),
        ("note", '<p class="warning">a line &amp; more</p>'),
        ("paragraph", "<p><strong>At first:</strong> word word"),
        ("items", "<li><code>model.py</code>: the model</li><li>a line of its own</li>"),
        ("verdict", '<section class="verdict good"><p class="headline">All is well</p>'),
        ("picture", 'src="data:image/png;base64,iVBORw=="><figcaption>What is drawn'),
        ("section", "<h3>Inside</h3>\n<p>within</p>"),
        ("beside", "<h3>Right</h3>\n<p>there</p>"),
    ],
)
def test_blocks_on_the_page(kind: str, expected: str) -> None:
    made = drawn(EVERY[kind])
    assert expected in made
    assert '<h2 id="here">Heading</h2>' in made
    assert "<h1>A &amp; B</h1>" in made


def test_a_full_disk_is_said_with_the_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "write_text", full)
    monkeypatch.setattr(files, "write_json", full)
    with pytest.raises(InputError, match=f"^{tmp_path} or x.json: cannot be written: No space"):
        write_record({}, tmp_path / "r.json", Path("x.json"))
    with pytest.raises(InputError, match=f"^{tmp_path}: cannot be written: No space"):
        write_texts({"a.txt": ""}, tmp_path)
    with pytest.raises(InputError, match=f"^{tmp_path}: cannot be written: No space"):
        write_page(Document("t", "", ()), tmp_path / "p.html")
