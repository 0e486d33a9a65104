"""What was recorded of a run that stopped, exported and identified when asked for."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.runs.mcap.reader import read_run
from rig.runs.run import LEAST_SAMPLES, RunFolder, discard, load_run
from rig.runs.run_file import partial_names, partial_warnings, without_partial

from .benches import sine, stages

FIRST, SECOND = 600, 1200
"""A cycle well inside the first excitation of the short sequence, and one inside the second."""


def tripped(runner: Any, fake_bench: Any, cycle: int, *, stale: int = 0) -> RunFolder:
    """Run until a cycle with too high a current, or with stale answers before it."""
    bench = fake_bench()
    if stale:
        bench.faults["exchange", cycle - stale] = lambda: setattr(bench, "fresh", False)
    bench.faults["exchange", cycle] = lambda: bench.overrides.update(current_A=1000.0)
    folder, _ = runner(bench)
    assert folder.record.trip is not None
    assert isinstance(folder, RunFolder)
    return folder


def test_partial_takes_an_excitation_up_to_its_last_fresh_sample(runner, fake_bench):
    folder = tripped(runner, fake_bench, FIRST, stale=4)
    samples = read_run(folder.recording).samples
    inside = samples["segment"] == 1
    fresh = int(np.sum(samples["fresh"][inside]))
    assert 0 < fresh == int(np.sum(inside)) - 5
    with pytest.raises(InputError, match=r"no stage was finished .*--partial uses the recorded"):
        load_run(folder.path)
    (found,) = load_run(folder.path, partial=True).recordings
    assert (found.name, found.partial, found.role) == ("empty[1] (partial)", True, "fit")
    assert len(found.time) == fresh
    np.testing.assert_array_equal(found.channels["command"], samples["command"][inside][:fresh])
    assert found.notes[0].startswith(f"partial: the run stopped after {fresh} of 500 samples")
    # What came while the drive braked is in the recording, and belongs to no excitation.
    assert np.sum(samples["segment"] == 0) > 50


def test_finished_excitations_alone_are_the_default(runner: Any, fake_bench: Any) -> None:
    folder = tripped(runner, fake_bench, SECOND)
    alone, both = load_run(folder.path), load_run(folder.path, partial=True)
    assert [r.name for r in alone.recordings] == ["empty[1]"]
    assert [(r.name, r.partial) for r in both.recordings] == [
        ("empty[1]", False),
        ("empty[2] (partial)", True),
    ]
    for channel, values in alone.recordings[0].channels.items():
        np.testing.assert_array_equal(both.recordings[0].channels[channel], values)
    assert partial_names(alone) == []
    assert partial_names(both) == ["empty[2] (partial)"]
    assert partial_warnings(alone) == ()
    assert "before empty[2] (partial) was finished" in partial_warnings(both)[0]
    assert without_partial(alone) == ""
    assert "without --partial" in without_partial(both)


def test_excitations_that_never_began_or_were_begun_again_are_none(runner, fake_bench):
    folder = tripped(runner, fake_bench, FIRST)
    discard(folder.record, 0)
    folder.save()
    with pytest.raises(InputError, match="no excitation was recorded"):
        load_run(folder.path, partial=True)
    with pytest.raises(InputError, match="no excitation has begun"):
        load_run(folder.path)


def first_cycle(runner: Any, fake_bench: Any) -> int:
    """Return the exchange in which the first sample of the first excitation is collected."""
    samples = read_run(tripped(runner, fake_bench, FIRST).recording).samples
    inside = int(np.argmax(samples["segment"] == 1))
    return inside + 1


@pytest.mark.parametrize("count", [LEAST_SAMPLES - 1, LEAST_SAMPLES])
def test_few_samples_make_a_recording_one_makes_none(runner, fake_bench, tmp_path, count):
    begin = first_cycle(runner, fake_bench)
    runner.folder = tmp_path / "again"
    folder = tripped(runner, fake_bench, begin + count - 1)
    if count < LEAST_SAMPLES:
        with pytest.raises(InputError, match="no excitation was recorded"):
            load_run(folder.path, partial=True)
    else:
        (found,) = load_run(folder.path, partial=True).recordings
        assert len(found.time) == count


def test_a_run_whose_writer_died_is_taken_as_it_is(runner: Any, fake_bench: Any) -> None:
    folder = tripped(runner, fake_bench, SECOND)
    content = folder.recording.read_bytes()
    folder.recording.write_bytes(content[: int(0.9 * len(content))])
    folder.record.state = folder.record.parts[0].state = "running"
    folder.save()
    found = load_run(folder.path, partial=True).recordings
    assert [r.name for r in found] == ["empty[1]", "empty[2] (partial)"]
    assert 2 <= len(found[1].time) < 500


def test_a_campaign_has_nothing_partial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "c.yaml").write_text("campaign: 1\n")
    assert status(["export", str(tmp_path / "c.yaml"), "--partial"]) == 2
    assert "--partial is allowed for a run folder only" in capsys.readouterr().err


def test_an_export_names_what_is_partial(runner, fake_bench, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tripped(runner, fake_bench, SECOND)
    assert status(["export", str(folder.path), "--out", "a.csv"]) == 0
    assert status(["export", str(folder.path), "--partial", "--out", "b.csv"]) == 0
    names = {path.name for path in tmp_path.glob("*.csv")}
    assert names == {"a.csv", "b-empty-1.csv", "b-empty-2-partial.csv"}
    assert (
        status(["export", str(folder.path), "--partial", "--format", "mat", "--out", "b.mat"]) == 0
    )
    assert [str(name) for name in loadmat("b.mat", squeeze_me=True)["recordings"]["name"]] == [
        "empty[1]",
        "empty[2] (partial)",
    ]


SLOW = stages(sine("empty", 15, 0.5, 8, more=", ramp_in_s: 0.5, ramp_out_s: 0.5, settle_s: 0.05"))


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was stopped half way through its only excitation, not to be changed."""
    folder = tmp_path_factory.mktemp("stopped")
    (folder / "slow.yaml").write_text(SLOW)
    (folder / "stop.yaml").write_text(
        "faults: 1\nrows:\n  - {phase: excite, after_s: 4, target: operator, fault: stop}\n"
    )
    arguments = [str(folder / "slow.yaml"), "--yes", "--out", str(folder / "run")]
    assert status(["run", *arguments, "--faults", str(folder / "stop.yaml")]) == 3
    return folder / "run"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("method", ["paper", pytest.param("default", marks=pytest.mark.proof)])
def test_an_identification_of_what_was_recorded_says_so(stopped, tmp_path, capsys, method):
    assert status(["identify", str(stopped), "--out", str(tmp_path)]) == 2
    assert "--partial uses the recorded part" in capsys.readouterr().err
    arguments = ["identify", str(stopped), "--method", method, "--partial", "--out", str(tmp_path)]
    assert status(arguments) == 0
    assert (
        f"warning: {method}: partial result: the run stopped before empty (partial)"
        in capsys.readouterr().out
    )
    record = json.loads((tmp_path / "identify.json").read_text())
    assert record["partial"] == ["empty (partial)"]
    assert any("partial result" in warning for warning in record["warnings"])
    assert record["corrections"]["empty (partial)"][0].startswith("partial: the run stopped after ")
    if method == "default":
        assert record["parameters"]["Mc"]["value"] == pytest.approx(6.825, rel=0.02)
    assert (
        "partial result: the run stopped before empty (partial)"
        in (tmp_path / "report.html").read_text()
    )
