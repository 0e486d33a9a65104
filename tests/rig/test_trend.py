"""Constants of several runs: which moved between two, and which drift over a history."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.results.catalogue.compare import (
    FALSE_ALARMS,
    Compared,
    _short,
    alarms,
    compare_document,
    compare_record,
    courses,
    differences,
    histories,
    require_comparable,
    trend_document,
    trend_record,
)
from rig.results.catalogue.listing import courses as drawn
from rig.results.document import Table, page, text
from rig.runs.catalogue.entry import Constant, Details, Entry, Head

TRUE = {"Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3, "J": 0.2}
TRUE |= {"mu_c": 0.052, "mu_s": 0.086, "omega_sL": 0.033, "mu_2": 0.032}
NONE = np.zeros(len(TRUE))
SHARE = 0.01
"""Half width of the intervals over the value."""


def details(shares: np.ndarray, serial: int = 1) -> Details:
    """Return an identification whose values are off the truth by these shares."""
    constants = {
        name: Constant(*(true * (1.0 + share + off) for off in (0.0, -SHARE, SHARE)), "N m")
        for (name, true), share in zip(TRUE.items(), shares.tolist(), strict=True)
    }
    return Details(constants, 0.02, "N m", "rotary", {"servo": f"drive, serial {serial}"})


def history(runs: int = 10, drift: float = 0.0, step: float = 0.0) -> list[Entry]:
    """Return runs in which Mc drifts or steps by so many widths of its interval, with another drive
    from the step on.
    """
    rng = np.random.default_rng(4)
    made = []
    for number in range(runs):
        shares = rng.normal(0.0, SHARE / 1.645, len(TRUE))
        second = number >= runs // 2
        shares[0] += 2.0 * SHARE * (drift * number / (runs - 1) + step * second)
        found = details(shares, 2 if second and step else 1)
        head = Head(
            sequence="short",
            created=f"2026-11-{number + 1:02d}T08:00:00+00:00",
            bench="practical",
            simulated=True,
            state="done",
            identified="default",
            digest=f"{number:064d}",
        )
        made.append(Entry(f"run-{number}", head, json.dumps(dataclasses.asdict(found))))
    return made


ROOT = Path("runs")


def test_a_drift_is_named_and_a_history_without_change_is_quiet() -> None:
    (quiet,) = histories(ROOT, history())
    assert alarms(quiet) == {}
    assert "DRIFT" not in text(trend_document([quiet]))
    (found,) = histories(ROOT, history(drift=3.0))
    assert alarms(found) == {"Mc": None}
    document = trend_document([found])
    assert "DRIFT" in text(document)
    assert "trend_practical.png" in [Path(p.file).name for p in document.pictures()]
    record = trend_record([found])["histories"][0]["constants"]
    assert record["Mc"]["kind"] == "drift"
    assert record["Mc"]["change"] == pytest.approx(6.8 * 0.06, rel=0.3)
    assert [name for name, each in record.items() if each["alarm"]] == ["Mc"]


def test_a_step_is_placed_and_held_against_the_devices() -> None:
    (found,) = histories(ROOT, history(step=3.0))
    assert alarms(found) == {"Mc": 5}
    shown = text(trend_document([found]))
    assert "STEP at run 6" in shown
    assert "runs/run-5, with another device (servo: drive, serial 1, then drive, serial 2)" in shown


@pytest.mark.proof
def test_the_rate_is_of_all_constants_together() -> None:
    rng = np.random.default_rng(5)
    count = 0
    known = [details(NONE) for _ in range(10)]
    for _ in range(12):
        runs = [details(rng.normal(0.0, SHARE / 1.645, len(TRUE))) for _ in known]
        count += any(course.alarm for course in courses(runs))
    assert count <= 1
    assert FALSE_ALARMS == 0.01


def test_one_constant_alone_is_judged_as_among_all() -> None:
    entries = history(step=3.0)
    (whole,) = histories(ROOT, entries)
    (alone,) = histories(ROOT, entries, only="Mc")
    assert alone.courses == tuple(course for course in whole.courses if course.name == "Mc")
    assert histories(ROOT, entries, only="Mx") == []
    document = trend_document([alone])
    assert document.title == "Trend of Mc"
    shown = page(document)
    assert "Mc, run by run" in shown
    assert "2026-11-06 08:00" in shown
    (quiet,) = histories(ROOT, entries, only="J")
    assert "J did not change by more than" in text(trend_document([quiet]))


def test_the_figure_has_the_number_that_a_run_has_in_the_history() -> None:
    known = Constant(1.0, 0.9, 1.1, "N m")
    made = drawn({"Mc": dict.fromkeys((0, 1, 4, 5), known)}, {"Mc": 2})
    bars, line = made.axes[0].containers[0], made.axes[0].lines[-1]
    assert list(bars.lines[0].get_xdata()) == [1, 2, 5, 6]
    assert list(line.get_xdata()) == [4.5, 4.5]


def test_copies_and_runs_without_constants_do_not_count() -> None:
    entries = history(runs=6)
    bare = dataclasses.replace(entries[0].head, identified="", digest="b")
    entries += [Entry("copy", entries[1].head, entries[1].details), Entry("bare", bare, "{}")]
    (found,) = histories(ROOT, entries)
    assert len(found.runs) == 6
    # Fewer runs are not tested.
    (few,) = histories(ROOT, history(runs=4))
    assert all(course.p_value is None for course in few.courses)
    # A value at a bound is no part of a course.
    stuck = dataclasses.replace(details(NONE).constants["Mc"], at_bound=True)
    first = dataclasses.replace(details(NONE), constants={"Mc": stuck})
    (course,) = (each for each in courses([first] + [details(NONE)] * 6) if each.name == "Mc")
    assert course.runs == (1, 2, 3, 4, 5, 6)
    assert [words.partition(":")[0] for words in found.left_out] == ["runs/copy", "runs/bare"]


def compared(*found: Details) -> list[Compared]:
    return [
        Compared(Path(f"runs/{n}"), Entry(".", Head(bench="practical", digest=str(n)), ""), each)
        for n, each in enumerate(found)
    ]


def test_constants_are_those_of_the_identified_runs() -> None:
    runs = compared(Details(motion="rotary"), details(NONE), details(NONE))
    record = compare_record(runs)
    assert (record["first"], record["not_identified"]) == ("runs/1", ["runs/0"])
    assert [each["run"] for each in record["compared"]] == ["runs/2"]
    shown = text(compare_document(runs))
    assert "runs/2 against runs/1" in shown
    assert "identify it with `rig identify runs/0`" in shown
    assert compare_record(runs[:2])["compared"] == []
    # Runs of one name are told apart in the figure.
    one, two, other = (
        dataclasses.replace(runs[1], run=Path(name)) for name in ("a/b", "a/b", "c/b")
    )
    assert all(picture.data for picture in compare_document([one, two]).pictures())
    assert _short([one, two]) == ["1: b", "2: b"]
    assert _short([one, other]) == ["a/b", "c/b"]
    # A run that cannot be read is refused with its remedy.
    bad = dataclasses.replace(runs[0].entry, head=Head("half written", "use `rig recover`"))
    with pytest.raises(InputError, match="runs/0: use `rig recover`"):
        require_comparable([dataclasses.replace(runs[0], entry=bad)])


def test_what_changed_by_more_than_its_uncertainty_is_marked() -> None:
    shares = np.zeros(len(TRUE))
    shares[:2] = 1.3 * SHARE, 1.5 * SHARE
    runs = compared(details(NONE), details(shares, 2))
    found = {each.name: each for each in differences(runs[0].details, runs[1].details)}
    # The interval of a difference of two is wider by the root of two.
    assert [name for name, each in found.items() if each.moved] == ["Ms"]
    document = compare_document(runs)
    shown = text(document)
    tables = (b for s in document.sections for b in s.blocks if isinstance(b, Table))
    findings = {row[0]: row[-1] for t in tables if t.header[-1] == "finding" for row in t.rows}
    assert findings.pop("Ms") == "changed"
    assert set(findings.values()) == {"no change"}
    assert "the servo was replaced: drive, serial 1 before, drive, serial 2 now" in shown
    assert "Figures" in page(document)
    assert compare_record(runs)["compared"][0]["constants"]["Ms"]["moved"] is True


def test_a_constant_that_is_not_determined_is_not_judged() -> None:
    other = details(NONE)
    constants = dict(other.constants)
    constants["Mc"] = Constant(None, None, None, "N m")
    del constants["Ms"]
    runs = compared(details(NONE), dataclasses.replace(other, constants=constants))
    found = {each.name: each.moved for each in differences(runs[0].details, runs[1].details)}
    assert (found["Mc"], found["Ms"], found["J"]) == (None, None, False)
    assert "not known" in text(compare_document(runs))


def test_runs_without_constants_are_compared_by_what_was_measured(short_sequence, tmp_path, capsys):
    runs = [str(tmp_path / name) for name in ("one", "two")]
    for seed, run in enumerate(runs):
        assert status(["run", str(short_sequence), "--yes", "--seed", str(seed), "--out", run]) == 0
    capsys.readouterr()
    result = tmp_path / "compared.json"
    page_folder = str(tmp_path / "page")
    assert status(["runs", "compare", *runs, "--json", str(result), "--out", page_folder]) == 0
    shown = capsys.readouterr().out
    for run in runs:
        assert f"identify it with `rig identify {run}`" in shown
    record = json.loads(result.read_text())
    assert (record["not_identified"], record["compared"]) == (runs, [])
    for each in record["measured"]:
        values = {figure["name"]: figure for figure in each["figures"]}
        assert 0.0 < values["tracking error rms"]["value"] < values["tracking error worst"]["value"]
        assert values["lateness p99"]["remark"] == "in simulated time"
        assert values["lost samples"]["value"] == 0.0
        assert (each["stages_done"], each["problem"]) == ("2 of 2", "")
    assert "<td>tracking error rms</td>" in (tmp_path / "page" / "report.html").read_text()
