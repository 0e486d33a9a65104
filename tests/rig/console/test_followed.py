"""What the console reads of a run: its growing recording, the extremes for its charts, torque
against speed; also of a run that was stopped and continued.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rig.console.followed as growing
from identification.model.parameters import NOMINAL
from rig.cli.entry import status
from rig.common.provenance import IDENTIFY_SCHEMA, RESULT_FILE
from rig.common.sample import Sample
from rig.console.followed import (
    BLOCK,
    CHANNELS,
    DEG,
    MOST,
    Followed,
    Growing,
    TorqueSpeed,
    curves,
    measured_friction,
)
from rig.control.remote import RunProgress
from rig.runs.decimation import KEPT, Decimation
from rig.runs.mcap.reader import read_run
from rig.runs.recorder import open_recorder
from tests.rig.benches import stages, swing

SEQUENCE = stages(swing("a"), swing("b", 2, weight_kg=10))
RECORDINGS = ("recording.mcap", "recording-2.mcap")


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run that was stopped in its second stage, and this run continued to its end."""
    root = tmp_path_factory.mktemp("states")
    (root / "two.yaml").write_text(SEQUENCE)

    def press(self: RunProgress, name: str, *rest: Any) -> None:
        if name == "b":
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as context:
        context.setattr(RunProgress, "__call__", press)
        run = ["run", str(root / "two.yaml"), "--yes", "--out", str(root / "stopped")]
        assert status(run) == 3
    shutil.copytree(root / "stopped", root / "done")
    assert status(["resume", str(root / "done"), "--yes"]) == 0
    return root / "stopped", root / "done"


@pytest.fixture
def stopped(states: tuple[Path, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(states[0], tmp_path / "run"))


@pytest.fixture
def resume(states: tuple[Path, Path], stopped: Path) -> Callable[[], object]:
    """Continue the stopped run to its end."""
    return lambda: shutil.copytree(states[1], stopped, dirs_exist_ok=True)


def followed(folder: Path, gone: bool = False) -> Followed:
    """Follow a run, whose program may have ended."""
    socket = folder.parent / "run-1.sock"
    if not gone:
        socket.touch()
    about = {
        "run": "1",
        "folder": str(folder),
        "cycle_s": 0.001,
        "torque_per_ampere": 3.0,
        "gear_ratio": 100.0,
        "limits": [],
    }
    return Followed(str(socket), about)


def read_all(run: Followed) -> None:
    while run.read():
        pass


def drawn(run: Followed) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the greatest angle of each ms of the charts from 0 s on, deg."""
    found = run.decimation.since(0, 0)
    angle = found.high[[channel.name for channel in CHANNELS].index("angle")]
    return np.concatenate([np.full(found.first, np.nan), angle])


def test_a_continued_run_keeps_its_charts_and_events(stopped, resume):
    run = followed(stopped)
    read_all(run)
    before = [words for _, words in run.events]
    assert any("stopped by the operator" in words for words in before)
    assert run.continued_s == []
    resume()
    read_all(run)
    words = [words for _, words in run.events]
    assert words[: len(before)] == before
    (begun_s,) = run.continued_s
    assert words[len(before)] == f"{begun_s:.1f} s  recording 2 begins: the run is continued"
    assert any("all 2 stages done" in each for each in words[len(before) :])
    first, second = (read_run(stopped / name).samples for name in RECORDINGS)
    assert begun_s >= first["time"][-1] + 1.0
    expected = np.full(len(drawn(run)), np.nan)
    for samples, offset_s in ((first, 0.0), (second, begun_s)):
        cycles = np.floor((samples["time"] + offset_s) / 0.001 + 1e-6).astype(int)
        expected[cycles] = samples["angle"] * DEG
    np.testing.assert_allclose(drawn(run), expected)
    # A console that finds the run later shows the same.
    other = followed(stopped)
    read_all(other)
    assert [words for _, words in other.events] == words
    np.testing.assert_array_equal(drawn(other), drawn(run))
    # What cannot be read is said, and does not hide the next recording.
    (stopped / RECORDINGS[0]).write_bytes(b"something else")
    broken = followed(stopped)
    read_all(broken)
    assert broken.trouble is not None
    assert "not an MCAP recording" in broken.trouble
    assert any("all 2 stages done" in words for _, words in broken.events)


def test_a_program_that_has_ended_does_not_show_the_recording_of_the_next(stopped, resume):
    run = followed(stopped, gone=True)
    read_all(run)
    before, begun = list(run.events), run.begun
    resume()
    read_all(run)
    assert (run.events, run.begun, run.continued_s) == (before, begun, [])
    assert run.record.state == "done"


def told(run: Followed, phase: str) -> dict[str, Any]:
    """Let a run report its phase, and return what a page then shows as its latest values."""
    run.hear({"phase": phase, "ended": None})
    run.read()
    found = run.parts()["live"][1]
    assert isinstance(found, dict)
    return found


def test_a_folder_that_is_used_again_for_another_run_keeps_the_old_one_on_the_page(stopped, resume):
    before = (stopped / "run.json").read_bytes()
    resume()
    run = followed(stopped, gone=True)
    read_all(run)
    assert run.begun is not None
    (stopped / "run.json").write_bytes(before)
    read_all(run)
    assert run.begun is not None
    assert run.parts()["record"][1] is not None


def test_values_of_the_time_before_a_stop_are_never_current(stopped, resume, monkeypatch):
    run = followed(stopped)
    # The program that continues the run connects; its recording does not exist yet.
    read_all(run)
    live = told(run, "connecting")
    assert live["time_s"] > 0
    assert (live["current"], live["drive"]) == (False, "not read yet")
    resume()
    # A report that came after the last reading does not make the old values current.
    run.hear({"phase": "excite", "ended": None})
    assert not run.parts()["live"][1]["current"]
    monkeypatch.setattr(growing, "READ_BYTES", 1 << 14)
    for late, first in ((run, 1), (followed(stopped), 0)):
        shown = []
        while not (live := told(late, "excite"))["current"]:
            assert live["drive"] == "not read yet"
            shown.append(len(late.continued_s))
            assert len(shown) < 1000
        # Samples were read, of the recording of that number, and were not shown as new.
        assert shown[0] == first
        assert len(late.continued_s) == 1
        assert not late.read()
        last = read_run(stopped / RECORDINGS[1]).samples["time"][-1]
        assert live["time_s"] == pytest.approx(late.continued_s[0] + last, abs=0.06)


def recorded(path: Path, count: int) -> bytes:
    recorder = open_recorder(path)
    recorder.attach("large.bin", "application/octet-stream", bytes(700_000))
    for k in range(count):
        fields = [float(k)] * 13
        recorder.sample(k * 1_000_000, Sample(k * 1e-3, *fields[1:], 0x27, 1, True), [])
        if k % 50 == 0:
            recorder.event(k * 1_000_000, "segment", stage="empty", number=k)
    recorder.close()
    return path.read_bytes()


@pytest.mark.parametrize("step", [977, 100_000, 10_000_000])
def test_everything_is_read_once_however_it_grows(tmp_path, step, monkeypatch):
    monkeypatch.setattr(growing, "READ_BYTES", 40_000)
    data = recorded(tmp_path / "whole.mcap", 400)
    path = tmp_path / "growing.mcap"
    path.write_bytes(b"")
    reading, times, events = Growing(path), [np.empty(0)], 0
    begins = range(0, len(data), step) if step > 977 else [*range(0, 3000, step), 3000]
    with open(path, "ab") as stream:
        for begin, end in zip(begins, [*list(begins)[1:], len(data)], strict=True):
            stream.write(data[begin:end])
            stream.flush()
            more = True
            while more:
                news = reading.read()
                times.append(news.samples.get("time", np.empty(0)))
                events += len(news.events)
                more = news.more
    np.testing.assert_array_equal(np.concatenate(times), np.arange(400) * 1e-3)
    assert events == 8


def points(found: TorqueSpeed, segments: list[int], torque_per_ampere: float = 1.0) -> None:
    segment = np.array(segments, dtype=float)
    samples = {"segment": segment, "velocity": 0.1 * segment, "current": 2.0 * segment}
    found.add(samples, torque_per_ampere)


def test_points_are_means_within_one_excitation() -> None:
    found = TorqueSpeed()
    # 25 samples of the first excitation, a rest, 15 of the second: one block has both.
    for part in ([1] * 13, [1] * 12 + [0] * 30, [2] * 15):
        points(found, part, 3.0)
    np.testing.assert_allclose(
        found.points, [[0.1 * DEG, 6.0, 1], [0.1 * DEG, 6.0, 1], [0.2 * DEG, 12.0, 2]]
    )
    # Their number is bounded, and every part of the run stays.
    found = TorqueSpeed()
    for segment in range(1, 9):
        points(found, [segment] * BLOCK * (MOST // 2))
    assert MOST // 2 < len(found.points) <= MOST
    assert found.version > 0
    counts = [np.count_nonzero(found.points[:, 2] == segment) for segment in range(1, 9)]
    assert max(counts) - min(counts) <= 2


def test_the_curve_is_that_of_an_identification_of_this_bench(runner: Any, fake_bench: Any) -> None:
    folder, _ = runner(fake_bench())
    assert curves(folder.record, measured_friction(folder.record, folder.path)) is None
    result = {
        "schema": IDENTIFY_SCHEMA,
        "motion": "rotary",
        "parameters": {name: {"value": value} for name, value in NOMINAL.items()},
        "alpha": 2.0,
    }
    (folder.path / RESULT_FILE).write_text(json.dumps(result))
    found = curves(folder.record, measured_friction(folder.record, folder.path))
    assert [line["mass_kg"] for line in found["lines"]] == [0, 10]
    light, heavy = (np.array(line["torque"]) for line in found["lines"])
    assert np.all(heavy > light)
    assert light[-1] == pytest.approx(NOMINAL["Mc"] + 2.0 * NOMINAL["sigma_2"], rel=1e-3)


CYCLE_S = 1e-3


@settings(max_examples=30)
@given(
    pieces=st.lists(st.integers(1, 700), min_size=1, max_size=12),
    gap=st.integers(0, 30_000),
    seed=st.integers(0, 9),
)
def test_every_interval_has_the_extremes_of_its_samples(pieces, gap, seed):
    values = np.random.default_rng(seed).normal(size=(2, sum(pieces)))
    cycles = np.arange(sum(pieces))
    # The recording stands still while the operator hangs a weight.
    cycles[len(cycles) // 2 :] += gap
    decimation, begin = Decimation(2, CYCLE_S), 0
    for size in pieces:
        part = slice(begin, begin + size)
        decimation.add(cycles[part] * CYCLE_S, values[:, part])
        begin += size
    level = 0
    while (found := decimation.since(level, 0)).low.shape[1]:
        numbers = cycles >> level
        assert found.first + found.low.shape[1] == numbers[-1] + 1
        for k in {0, found.low.shape[1] // 2, found.low.shape[1] - 1}:
            inside = values[:, numbers == found.first + k]
            if inside.shape[1]:
                np.testing.assert_array_equal(found.low[:, k], inside.min(axis=1))
                np.testing.assert_array_equal(found.high[:, k], inside.max(axis=1))
            else:
                assert np.isnan(found.low[:, k]).all()
        level += 1
    assert level >= 1


def test_a_single_peak_is_seen_in_an_hour() -> None:
    decimation = Decimation(1, 10 * CYCLE_S)
    for begin in range(0, 360_000, 10_000):
        cycles = begin + np.arange(10_000)
        peak = np.where(cycles == 123_456, 99.0, 0.0)
        decimation.add(cycles * 10 * CYCLE_S, peak[None, :])
    level = decimation.level(3600.0, 390)
    found = decimation.since(level, 0)
    assert found.high.max() == 99.0
    assert decimation.interval_s(level) <= 3600.0 / 390 < 2 * decimation.interval_s(level)
    assert found.low.shape[1] <= KEPT
    assert decimation.level(0.1, 1000) == 0
    assert decimation.level(10.0, 10**9) == decimation.level(10.0, KEPT // 2)
