"""Run folders as they are listed, and the index that only saves time."""

import io
import json
import shutil
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status
from rig.common.provenance import sha256_file
from rig.runs.catalogue.entry import Entry, Wanted, chosen, state_of, time_of, verdicts
from rig.runs.catalogue.index import INDEX_FILE, list_runs
from rig.runs.run_file import seal_run

from .conftest import IDENTIFIED, run_in


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the fake bench, sealed."""
    run = run_in(tmp_path_factory.mktemp("made"))
    seal_run(run.path, run.record)
    return run.path


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    """Two runs, one of them identified, and folders that are none."""
    root = tmp_path / "runs"
    shutil.copytree(made, root / "one")
    shutil.copytree(made, root / "2026" / "two")
    edit(root / "2026" / "two", lambda r: r.update(created="2027-01-02T03:04:05+00:00"))
    (root / "2026" / "two" / "identify.json").write_text(json.dumps(IDENTIFIED))
    (root / "notes").mkdir()
    (root / "notes" / "readme.txt").write_text("no run")
    return root


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "run.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def listed(root: Path) -> dict[str, Entry]:
    return {entry.folder: entry for entry in list_runs(root).entries}


def test_what_is_known_of_a_run(root: Path) -> None:
    entries = list_runs(root).entries
    assert [entry.folder for entry in entries] == ["one", "2026/two"]
    head = entries[0].head
    what = (head.kind, head.state, head.bench, head.sequence)
    assert what == ("run", "done", "practical", "short")
    assert (head.operators, head.masses_kg, head.simulated) == (("Ada",), (0.0, 10.0), True)
    details = entries[1].parsed()
    assert details.constants["Mc"].half_width == pytest.approx(0.1)
    assert details.devices["servo"] == "fake, serial 4"
    assert entries[1].head.identified == "default"


def test_a_list_reads_what_has_changed(root: Path) -> None:
    first = list_runs(root)
    again = list_runs(root)
    assert (first.read, again.read, again.note) == (2, 0, "")
    assert again.entries == first.entries
    (root / "one" / "identify.json").write_text(json.dumps(IDENTIFIED))
    # A ring of links ends, and a link to itself is no folder.
    (root / "ring").symlink_to(root, target_is_directory=True)
    (root / "itself").symlink_to(root / "itself")
    again = list_runs(root)
    assert (again.read, len(again.entries)) == (1, 2)
    assert listed(root)["one"].head.identified == "default"


def swap(path: Path) -> None:
    """Change a name inside a row, as a flipped bit would."""
    content = path.read_bytes()
    assert b"practical" in content
    path.write_bytes(content.replace(b"practical", b"practikal"))


def older(path: Path) -> None:
    """Write the rows under the checksum of another format."""
    text = path.read_bytes().partition(b"\n")[2]
    path.write_bytes(str(zlib.crc32(text, 3)).encode() + b"\n" + text)


@pytest.mark.parametrize(
    "harm",
    [
        Path.unlink,
        swap,
        older,
        lambda path: path.write_bytes(b"no database" * 1000),
        lambda path: path.write_bytes(path.read_bytes()[:5000]),
        lambda path: path.write_bytes(b""),
    ],
)
def test_a_lost_or_damaged_index_changes_no_answer(root, harm):
    before = list_runs(root).entries
    harm(root / INDEX_FILE)
    harmed = list_runs(root)
    assert (harmed.entries, harmed.note) == (before, "")
    again = list_runs(root)
    assert (again.entries, again.read) == (before, 0)


def test_where_no_index_can_be_written_the_list_is_the_same(root: Path) -> None:
    before = list_runs(root).entries
    (root / INDEX_FILE).unlink()
    (root / INDEX_FILE).mkdir()
    found = list_runs(root)
    assert found.entries == before
    assert "the index cannot be written" in found.note


def test_a_moved_folder_is_listed_where_it_is(root: Path) -> None:
    list_runs(root)
    (root / "one").rename(root / "moved")
    assert list(listed(root)) == ["moved", "2026/two"]
    root.rename(root.with_name("archive"))
    assert list_runs(root.with_name("archive")).read == 0


@pytest.mark.parametrize(
    ("harm", "kind", "problem"),
    [
        (lambda run: (run / "run.json").unlink(), "half written", "rig recover"),
        (lambda run: (run / "run.json").write_text('{"na'), "half written", "rig recover"),
        (lambda run: edit(run, lambda r: r.update(schema="loadrig.run/9")), "other version", "/1"),
        (lambda run: edit(run, lambda r: r.update(cycle_s="fast")), "unreadable", "cycle_s"),
        (lambda run: (run / "identify.json").write_text("{"), "run", ""),
    ],
)
def test_folders_are_listed_as_what_they_are(root, harm, kind, problem):
    harm(root / "one")
    head = listed(root)["one"].head
    assert (head.kind, head.identified) == (kind, "")
    assert problem in head.problem
    if (root / "one" / "identify.json").exists():
        assert "identify.json" in head.notes[0]


def test_a_commissioning_is_listed_as_such(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n0,0\nabort\n"))
    assert status(["commission", "practical", "--out", "runs/new"]) == 3
    head = listed(Path("runs"))["new"].head
    assert (head.kind, head.bench, head.problem) == ("commissioning", "practical", "")
    assert head.state == "stopped"
    capsys.readouterr()
    assert status(["runs", "list", "runs"]) == 0
    assert "half written" not in capsys.readouterr().out
    # Its recording holds no copy of a run's record, from which one could be rebuilt.
    Path("runs/new/commission.json").unlink()
    head = listed(Path("runs"))["new"].head
    assert head.kind == "half written"
    assert "rig recover" not in head.problem
    assert status(["recover", "runs/new"]) == 2


def test_runs_are_chosen_by_what_is_known(root: Path) -> None:
    for wanted, expected in [
        (Wanted(), 2),
        (Wanted(bench="prac*", sequence="short", operator="Ada", weight_kg=10.0), 2),
        (Wanted(bench="other"), 0),
        (Wanted(operator="Bob"), 0),
        (Wanted(weight_kg=11.0), 0),
        (Wanted(verdict="done"), 2),
        (Wanted(verdict="tripped"), 0),
        (Wanted(since=time_of("2027-01-02")), 1),
        (Wanted(until=time_of("2027-01-02T03:04:05")), 1),
    ]:
        assert len(chosen(root, list_runs(root).entries, wanted)) == expected, wanted


@pytest.mark.parametrize("day", ["2027-01-02", "20270102", "9999-12-31"])
def test_until_a_day_holds_the_day(root: Path, day: str, capsys) -> None:
    assert status(["runs", "list", str(root), "--until", day]) == 0
    assert "2 runs" in capsys.readouterr().out


def test_a_run_without_an_end_is_going_on_or_has_died(root: Path) -> None:
    from rig.common.locks import hold_folder

    edit(root / "one", lambda r: r.update(state="running"))
    entry = listed(root)["one"]
    assert state_of(root, entry) == "died"
    with hold_folder(root / "one", "rig run"):
        assert state_of(root, entry) == "going on"
    assert verdicts(root, entry) == {"died"}


def test_the_list_shows_copies_and_problems(root, capsys, tmp_path):
    shutil.copytree(root / "one", root / "three")
    (root / "2026" / "two" / "run.json").write_text("")
    result = tmp_path / "list.json"
    arguments = ["runs", "list", str(root), "--json", str(result), "--out", str(tmp_path / "page")]
    assert status(arguments) == 0
    shown = capsys.readouterr().out
    assert "HALF WRITTEN" in shown
    assert f"{root}/three: a copy of {root}/one" in shown
    record = json.loads(result.read_text())
    assert [run["kind"] for run in record["runs"]] == ["half written", "run", "run"]
    assert "HALF WRITTEN" in (tmp_path / "page" / "report.html").read_text()


def test_runs_that_match_and_are_not_listed_are_counted_as_earlier(root, monkeypatch):
    from rig.results.catalogue import listing

    counts, make = [], listing.listing_document

    def made(folder: Path, entries: Any, hidden: int = 0, earlier: int = 0) -> Any:
        counts.append((len(entries), hidden, earlier))
        return make(folder, entries, hidden, earlier)

    monkeypatch.setattr(listing, "listing_document", made)
    words = ["runs", "list", str(root)]
    for options in (["--last", "1"], ["--since", "2027-01-01"], []):
        assert status([*words, *options]) == 0
    assert counts == [(1, 0, 1), (1, 1, 0), (2, 0, 0)]


def test_a_trend_of_one_constant_over_the_latest_runs(root, capsys):
    assert status(["runs", "trend", str(root), "--constant", "Mc", "--last", "1"]) == 0
    shown = capsys.readouterr().out
    assert "practical (simulated), 1 runs" in shown
    assert "not identified" not in shown  # the earlier run is not among the latest
    assert status(["runs", "trend", str(root), "--constant", "Mx"]) == 2
    assert "has a constant Mx" in capsys.readouterr().err


def test_one_run_is_shown(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["runs", "show", str(root / "2026" / "two")]) == 0
    shown = capsys.readouterr().out
    for words in ("practical (simulated)", "Ada", "heavy", "6.8", "[6.7, 6.9]"):
        assert words in shown
    assert not (root / "2026" / "two" / INDEX_FILE).exists()
    for arguments in (["show", str(root / "notes")], ["list", str(root / "nowhere")]):
        assert status(["runs", *arguments]) == 2


def test_a_run_is_sealed_with_the_digests_of_its_files(root: Path) -> None:
    lines = (root / "one" / "SHA256SUMS").read_text().splitlines()
    digests = dict(reversed(line.split("  ")) for line in lines)
    assert digests.keys() == {"run.json", "recording.mcap"}
    assert all(sha256_file(root / "one" / name) == digest for name, digest in digests.items())
