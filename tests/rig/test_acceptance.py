"""Limits of acceptance: what is refused early, what is judged, and what is written of it."""

import dataclasses
import json
import re
import shutil
from pathlib import Path

import pytest
from lxml import etree

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.config.acceptance import Limit, parse_limit
from rig.config.sequence import load_acceptance
from rig.results.acceptance.certificate import accept, junit
from rig.results.acceptance.evidence import Check, Evidence, accepted, gather, judge
from rig.runs.catalogue.entry import Constant
from rig.runs.run_file import SEAL_FILE

from .conftest import IDENTIFIED, SHORT, run_in

XSD = Path(__file__).with_name("junit.xsd")
LINES = """\
acceptance: [Mc: 6.5..7.1, p99 lateness < 1 ms, 'tracking error rms < 0.05 deg']
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the fake bench whose sequence states limits, with an identification."""
    run = run_in(tmp_path_factory.mktemp("made"), LINES, "Ada <A&B>")
    digest = gather(run.path, (), lambda what, share: None).digests["recording.mcap"]
    inputs_used = [{"file": "elsewhere/recording.mcap", "sha256": digest}]
    (run.path / "identify.json").write_text(json.dumps({**IDENTIFIED, "inputs": inputs_used}))
    return run.path


@pytest.fixture
def run(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "run"))


@pytest.fixture(scope="module")
def evidence(made: Path) -> Evidence:
    return gather(made, (parse_limit("Mc: 6.5..7.1"),), lambda what, share: None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Mx: 1..2", "'Mx' is no constant"),
        ("Mc: 7..6", "is empty"),
        ("Mc: ..", "is no range"),
        ("Mc: about 7", "is no range"),
        ("p98 lateness < 1 ms", "is no quantity"),
        ("latenes p99 < 1 ms", "did you mean lateness"),
        ("tracking error p99 < 1 deg", "write tracking error rms or tracking error worst"),
        ("p99 lateness < 1 deg", "'deg' is no unit of lateness"),
        ("p99 lateness < 1", "'' is no unit"),
        ("nothing missin", "is no limit"),
    ],
)
def test_what_is_no_limit_is_refused_with_the_nearest(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        parse_limit(text)


def test_a_wrong_file_of_limits_is_refused_before_anything_moves(tmp_path: Path) -> None:
    path, out = tmp_path / "limits.yaml", tmp_path / "run"
    path.write_text("acceptance: 1\nlimits:\n  - Mx: 1..2\n  - nothing missing\n  - foo\n")
    with pytest.raises(InputError) as caught:
        load_acceptance(path)
    places = [problem.partition(": ")[0] for problem in caught.value.problems]
    assert places == [f"{path}:3:5", f"{path}:5:5"]
    assert status(["run", "figure10", "--yes", "--acceptance", str(path), "--out", str(out)]) == 2
    assert not out.exists()


def judged(evidence: Evidence, *lines: str) -> list[Check]:
    limits: list[Limit] = [parse_limit(line) for line in lines]
    return list(judge(limits, evidence))[1:]


@pytest.mark.parametrize(
    ("found", "passed"),
    [
        (Constant(6.8, 6.5, 7.1, "N m"), True),
        (Constant(6.8, 6.49, 7.0, "N m"), False),
        (Constant(7.2, 7.05, 7.3, "N m"), False),
        (Constant(None, 6.6, 7.0, "N m"), False),
        (Constant(6.8, 6.7, 6.9, "N m", at_bound=True), False),
    ],
)
def test_a_constant_passes_where_its_whole_interval_is_inside(evidence, found, passed):
    held = dataclasses.replace(evidence, constants={"Mc": found})
    (check,) = judged(held, "Mc: 6.5..7.1")
    assert check.passed is passed
    # A limit may have an open end; a constant that was not identified does not pass.
    low, missing = judged(evidence, "Mc: 6..", "J: 0..1")
    assert (low.passed, missing.passed) == (True, False)


def test_quantities_are_measured_in_the_unit_of_the_limit(evidence: Evidence) -> None:
    temperature, current, torque, lost = judged(
        evidence,
        "temperature worst < 25.1 C",
        "current rms >= 1500 mA",
        "torque error rms < 20 mN m",
        "lost samples < 1",
    )
    assert (temperature.value, temperature.passed) == (pytest.approx(25.0), True)
    assert (current.value, current.passed) == (pytest.approx(1500.0), True)
    assert (torque.value, torque.passed) == (pytest.approx(20.0), False)
    assert (lost.value, lost.passed) == (0.0, True)


@pytest.mark.parametrize(
    ("simulated", "realtime", "simulated_times"),
    [(True, False, (True, True)), (True, True, (False, True)), (False, False, (False, False))],
)
def test_a_duration_in_simulated_time_is_marked(evidence, simulated, realtime, simulated_times):
    record = dataclasses.replace(evidence.record, simulated=simulated, realtime=realtime)
    checks = judged(
        dataclasses.replace(evidence, record=record), "p99 lateness < 1 ms", "p99 answer < 1 s"
    )
    assert tuple("in simulated time" in check.words for check in checks) == simulated_times


def test_the_worst_recording_counts(evidence: Evidence) -> None:
    part = evidence.record.parts[0]
    late = {**part.timing, "lateness": {**part.timing["lateness"], "p99_us": 1500.0}}
    parts = [part, dataclasses.replace(part, timing=late)]
    record = dataclasses.replace(evidence.record, parts=parts)
    (check,) = judged(dataclasses.replace(evidence, record=record), "p99 lateness < 1 ms")
    assert (check.value, check.passed) == (1.5, False)


@pytest.mark.parametrize(
    ("line", "found", "passed"),
    [
        ("weight check passed", {"weights": {}}, False),
        ("weight check passed", {"weights": {"a": ("right", "fits")}}, True),
        ("weight check passed", {"weights": {"a": ("right", ""), "b": ("wrong", "")}}, False),
        ("weight check passed", {"weights": {"a": ("unchecked", "no reference")}}, False),
        ("nothing missing", {"diagnosis": "nothing_missing"}, True),
        ("nothing missing", {"diagnosis": "named"}, False),
        ("nothing missing", {"diagnosis": ""}, False),
    ],
)
def test_what_nothing_has_checked_does_not_pass(evidence, line, found, passed):
    (check,) = judged(dataclasses.replace(evidence, **found), line)
    assert check.passed is passed


def test_a_recording_without_timing_makes_the_times_unknown(evidence: Evidence) -> None:
    part = evidence.record.parts[0]
    quiet = {**part.timing, "lateness": {**part.timing["lateness"], "p99_us": None}}
    idle = dataclasses.replace(part, timing=quiet, cycles=0)
    unstarted = dataclasses.replace(idle, timing={})
    died = dataclasses.replace(part, timing={}, state="died")
    for other, known in ((idle, True), (unstarted, True), (died, False)):
        record = dataclasses.replace(evidence.record, parts=[part, other])
        checks = judged(
            dataclasses.replace(evidence, record=record), "p99 lateness < 1 s", "lost samples < 1"
        )
        assert [check.passed for check in checks] == [known] * 2
        assert [check.value is not None for check in checks] == [known] * 2


def test_two_masses_check_no_weight(tmp_path: Path) -> None:
    again = SHORT.partition("  - {name: heavy")[2]
    folder = run_in(tmp_path, f"  - {{name: again{again}").path
    limit = parse_limit("weight check passed")
    found = gather(folder, (limit,), lambda what, share: None)
    assert [s.weight_kg for s in found.record.stages] == [0.0, 10.0, 10.0]
    assert found.weights == {}
    assert not judge((limit,), found)[-1].passed


def test_a_recorded_wrong_weight_is_on_the_certificate_whatever_the_limits(run: Path) -> None:
    raw = json.loads((run / "run.json").read_text())
    entry = {"confirmed_kg": 10.0, "measured_kg": 12.0, "sigma_kg": 0.1, "message": "it is 12 kg"}
    raw["weights"] = [
        {**entry, "stage": "heavy", "verdict": "right"},
        {**entry, "stage": "heavy[2]", "verdict": "wrong"},
    ]
    (run / "run.json").write_text(json.dumps(raw))
    accept(run, (), "test", lambda what, share: None)
    page = etree.HTML((run / "certificate.html").read_text())
    (row,) = (r for r in page.iter("tr") if (r[0].text or "").strip() == "heavy")
    assert "wrong" in [(cell.text or "").strip() for cell in row]


def test_a_run_that_is_not_complete_is_rejected(evidence: Evidence) -> None:
    assert accepted(judge((), evidence))
    record = dataclasses.replace(evidence.record, state="tripped", message="current")
    checks = judge((), dataclasses.replace(evidence, record=record))
    assert not accepted(checks)
    assert "tripped: current" in checks[0].words


def test_junit_is_valid_and_says_what_failed(evidence: Evidence) -> None:
    schema = etree.XMLSchema(etree.parse(XSD))
    checks = [
        Check("p99 lateness < 1 ms", True, "0 ms"),
        Check("Mc: 6.5..7.1", False, 'not "inside" \x1b[0m & <outside>'),
    ]
    root = etree.fromstring(junit(evidence.record, "practical", checks))
    schema.assertValid(root)
    assert root.get("failures") == "1"
    (failure,) = root.findall(".//failure")
    assert failure.get("message") == 'not "inside" ?[0m & <outside>'
    assert [case.get("name") for case in root.iter("testcase")] == [
        "p99 lateness < 1 ms",
        "Mc: 6.5..7.1",
    ]
    # The schema refuses what a server would not read.
    del root.find(".//testcase").attrib["name"]  # type: ignore[union-attr]
    assert not schema.validate(root)


def test_a_run_is_accepted_and_certified(run, tmp_path, capsys):
    files = [str(tmp_path / name) for name in ("j.xml", "a.json")]
    code = status(["runs", "accept", str(run), "--junit", files[0], "--json", files[1]])
    shown = capsys.readouterr().out
    assert code == 0, shown
    assert "ACCEPTED" in shown
    record = json.loads(Path(files[1]).read_text())
    assert (record["verdict"], record["limits"], len(record["checks"])) == (
        "accepted",
        "sequence",
        4,
    )
    etree.XMLSchema(etree.parse(XSD)).assertValid(etree.parse(files[0]))
    page = (run / "certificate.html").read_text()
    assert not re.search(r"https?://|<script|<link|@import|url\(", page)
    recorded = {each["file"]: each["sha256"] for each in record["inputs"]}
    assert set(recorded) == {"recording.mcap", "run.json", "identify.json"}
    for words in ("practical (SIMULATED)", "Ada &lt;A&amp;B&gt;", "fake", *recorded.values()):
        assert words in page
    sealed = dict(line.split("  ")[::-1] for line in (run / SEAL_FILE).read_text().splitlines())
    assert sealed == {name: sha256_file(run / name) for name in sealed}
    assert len(sealed) == 5


def test_a_limit_that_is_not_kept_ends_with_1(run, tmp_path, capsys):
    limits = tmp_path / "limits.yaml"
    arguments = ["runs", "accept", str(run), "--acceptance", str(limits)]
    limits.write_text("acceptance: 1\nlimits: []\n")
    assert status(arguments) == 2
    limits.write_text("acceptance: 1\nlimits: [temperature worst < 20 C]\n")
    assert status(arguments) == 1
    assert "REJECTED" in capsys.readouterr().out
    assert json.loads((run / "acceptance.json").read_text())["verdict"] == "rejected"
    assert status(["runs", "list", str(tmp_path), "--verdict", "rejected"]) == 0
    assert "1 run\n" in capsys.readouterr().out


def test_what_was_out_of_date_or_of_another_recording_is_seen(run: Path) -> None:
    raw = json.loads((run / "run.json").read_text())
    raw["calibrations"] = [
        {"device": "scale", "id": "C-17", "due": "2026-01-01", "overdue": True},
        {"device": "encoder", "id": "C-18", "due": "2027-01-01", "overdue": False},
    ]
    (run / "run.json").write_text(json.dumps(raw))
    right = json.loads((run / "identify.json").read_text())
    old = json.loads(json.dumps(right))
    old["inputs"][0]["sha256"] = "0" * 64
    (run / "identify.json").write_text(json.dumps(old))
    assert gather(run, (), lambda what, share: None).constants == {}
    for change, current in (({"partial": True}, False), ({"inputs": []}, False), ({}, True)):
        (run / "identify.json").write_text(json.dumps(right | change))
        assert bool(gather(run, (), lambda what, share: None).constants) is current
    (run / "identify.json").write_text(json.dumps(old))
    accept(run, (), "test", lambda what, share: None)
    page = (run / "certificate.html").read_text()
    for words in ("C-17", "2026-01-01", "OVERDUE", "C-18", "valid"):
        assert words in page


def test_a_result_from_another_run_record_or_of_the_pressure_alone_is_made_again(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rig.results.acceptance import evidence as gathering

    def constants() -> bool:
        return bool(gather(run, (), lambda what, share: None).constants)

    record = json.loads((run / "identify.json").read_text())
    entry = {"file": str(run / "run.json"), "sha256": sha256_file(run / "run.json")}
    record["inputs"].append(entry)
    (run / "identify.json").write_text(json.dumps(record))
    assert constants()
    raw = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(raw | {"operator": "Bob"}))
    assert not constants()

    made = {"verdict": "named"}
    monkeypatch.setattr(gathering, "_diagnosed", lambda folder, progress: made)
    (run / "diagnosis").mkdir()
    for equation, verdict in (("torque", "nothing_missing"), ("pressure", "named")):
        given = {"verdict": "nothing_missing", "fit": {"equation": equation}}
        given |= {"inputs": record["inputs"][:1]}
        (run / "diagnosis" / "diagnose.json").write_text(json.dumps(given))
        limits = (parse_limit("nothing missing"),)
        assert gather(run, limits, lambda what, share: None).diagnosis == verdict


def test_a_run_is_judged_at_its_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sequence = tmp_path / "short.yaml"
    short = SHORT.partition("  - {name: heavy")[0]
    sequence.write_text(short + "acceptance: [lost samples < 1, temperature worst < 20 C]\n")
    code = status(["run", str(sequence), "--yes", "--out", str(tmp_path / "run")])
    shown = capsys.readouterr().out
    assert code == 1, shown
    assert "REJECTED" in shown
    assert (tmp_path / "run" / "certificate.html").exists()
