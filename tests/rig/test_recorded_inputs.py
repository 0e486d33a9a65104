"""A run goes on from whatever folder `rig resume` is called in."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status
from rig.common.provenance import sha256
from rig.control.remote import RunProgress
from rig.runs.recorded_inputs import recorded_input, truth_of

CONTENT = b"that of the run"
DIGEST = sha256(CONTENT)


@pytest.fixture
def stopped(short_sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a run with relative paths that was stopped in its second stage."""
    bench = Path(__file__).parents[2] / "rig" / "config" / "benches" / "practical.yaml"
    place = tmp_path / "bench"
    (place / "files").mkdir(parents=True)
    shutil.copy(bench, place / "files" / "own.yaml")
    shutil.copy(short_sequence, place / "files" / "two.yaml")
    monkeypatch.chdir(place)

    def press(self: RunProgress, name: str, *rest: Any) -> None:
        if name == "heavy":
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(RunProgress, "__call__", press)
        arguments = ["files/two.yaml", "--bench", "files/own.yaml", "--yes", "--out", "runs/first"]
        assert status(["run", *arguments]) == 3
    return place / "runs" / "first"


def test_a_run_of_an_older_program_does_too(
    stopped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = stopped / "run.json"
    record = json.loads(file.read_text(encoding="utf-8"))
    record["inputs"]["bench.yaml"]["file"] = "files/own.yaml"
    record["inputs"]["sequence.yaml"]["file"] = "files/two.yaml"
    file.write_text(json.dumps(record), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert truth_of(stopped) is not None
    assert status(["resume", str(stopped), "--yes"]) == 0


@pytest.mark.parametrize("folder", [Path("run"), Path("..") / "place" / "run"])
def test_a_relative_path_is_followed_from_here_and_from_above_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    place = tmp_path / "place"
    place.mkdir()
    entry = {"file": "files/bench.yaml", "sha256": DIGEST}
    monkeypatch.chdir(place)
    assert recorded_input(folder, entry) == Path("files/bench.yaml"), "missing everywhere"
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "bench.yaml").write_bytes(CONTENT)
    assert recorded_input(folder, entry).samefile(tmp_path / "files" / "bench.yaml")
    (place / "files").mkdir()
    (place / "files" / "bench.yaml").write_bytes(b"another")
    assert recorded_input(folder, entry).samefile(tmp_path / "files" / "bench.yaml"), (
        "another file of that name"
    )
    (place / "files" / "bench.yaml").write_bytes(CONTENT)
    assert recorded_input(folder, entry) == Path("files/bench.yaml")


def test_what_is_no_file_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bench.yaml").mkdir()
    for name in ("bench.yaml", "x" * 5000):
        assert recorded_input(tmp_path / "run", {"file": name, "sha256": DIGEST}) == Path(name)
