"""``run.json`` as people edit it, and the inputs that it names."""

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.control.remote import RunProgress
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run, read_record


@pytest.fixture
def run(finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(finished_run, tmp_path / "run"))


def edit(run: Path, change: Callable[[Any], object]) -> None:
    raw = json.loads((run / "run.json").read_text())
    change(raw)
    (run / "run.json").write_text(json.dumps(raw, indent=1))


GONE = object()
EDITS = [
    ("seed", "0", r"seed: input should be a valid integer \(got \"0\"\)"),
    ("stages.1.weight_kg", True, r"stages\[1\].weight_kg: "),
    ("segments.0.start", float("nan"), r"run.json"),
    ("stages.0.wieght_kg", 3, r"stages\[0\].wieght_kg: unknown key; did you mean"),
    ("segments.2.stage", "laoded", r"segments\[2\].stage: .*'loaded'"),
    ("segments.2.stage", "unloaded", r"differs from the load condition of its stage"),
    ("segments.2.weight_kg", 11.0, r"differs from the confirmed mass of its stage"),
    ("bench.gear_ratio", GONE, r"bench.gear_ratio: missing; state every constant"),
    ("segments.0.part", 2, r"part: there are 1 recordings"),
    ("segments.0.stage_index", -1, r"there are 2 stages"),
    ("parts.0.file", "../x.mcap", r"parts\[0\].file: must be a file of the run"),
    ("inputs", {}, r"inputs.bench.yaml.file: missing"),
    ("parts.0.devices.servo.name", GONE, r"parts\[0\].devices.servo.name: missing"),
    ("stages", "two", r"stages: "),
]


@pytest.mark.parametrize(("place", "value", "words"), EDITS)
def test_an_edit_that_cannot_be_is_named_with_its_place(run, place, value, words):
    raw = json.loads((run / "run.json").read_text())
    *above, last = place.split(".")
    inside = raw
    for name in above:
        inside = inside[int(name) if name.isdecimal() else name]
    inside[last] = value
    if value is GONE:
        del inside[last]
    (run / "run.json").write_text(json.dumps(raw, indent=1))
    with pytest.raises(InputError, match=words) as caught:
        read_record(run)
    assert all(problem.startswith(f"{run / 'run.json'}:") for problem in caught.value.problems)


def test_every_error_is_told_with_line_and_column(run, capsys):
    edit(run, lambda r: (r.update(seed="0"), r["stages"][0].update(repeats=1.5)))
    with pytest.raises(InputError) as caught:
        read_record(run)
    lines = (run / "run.json").read_text().splitlines()
    assert len(caught.value.problems) == 2
    for problem in caught.value.problems:
        _, line, column, path, *_ = problem.split(":")
        key = path.strip().rpartition(".")[2]
        assert f'"{key}": ' in lines[int(line) - 1][: int(column) - 1]
    assert status(["export", str(run), "--out", "x.csv"]) == 2
    assert capsys.readouterr().err.count(f"{run / 'run.json'}:") == 2


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_whatever_is_put_anywhere_it_is_read_or_refused(run, finished_run, data):
    raw = json.loads((finished_run / "run.json").read_text())
    place = raw
    while True:
        key = data.draw(
            st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place)))
        )
        if not (isinstance(place[key], dict | list) and place[key] and data.draw(st.booleans())):
            break
        place = place[key]
    junk = (
        st.none()
        | st.booleans()
        | st.integers(-5, 5)
        | st.floats()
        | st.text(max_size=3)
        | st.just([])
        | st.just({})
    )
    if isinstance(place, dict) and data.draw(st.booleans()):
        del place[key]
    else:
        place[key] = data.draw(junk)
    (run / "run.json").write_text(json.dumps(raw))
    with suppress(InputError):
        load_run(run)


def test_recovery_rebuilds_what_was_edited_to_death_from_the_latest_recording(run, capsys):
    def stopped(raw: Any) -> None:
        raw["stages"][1]["state"] = "running"

    edit(run, stopped)
    assert status(["resume", str(run), "--yes"]) == 0
    whole = read_record(run)
    edit(run, lambda r: r["bench"].pop("gear_ratio"))
    assert status(["recover", str(run)]) == 0
    assert "the damaged file is kept as run.damaged.json" in capsys.readouterr().out
    assert (run / "run.damaged.json").exists()
    mended = read_record(run)
    assert [part.file for part in mended.parts] == [part.file for part in whole.parts]
    assert [(s.name, s.part, s.kept, s.end is None) for s in mended.segments] == [
        (s.name, s.part, s.kept, s.end is None) for s in whole.segments
    ]
    assert mended.state == "done"


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


def test_a_run_that_was_started_with_relative_paths_goes_on_from_elsewhere(
    stopped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert truth_of(stopped) is not None
    assert status(["resume", str(stopped), "--yes"]) == 0
