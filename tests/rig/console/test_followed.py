"""What the console reads of a run that was stopped and continued."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig.console.followed as growing
from rig.cli.entry import status
from rig.console.followed import CHANNELS, DEG, Followed
from rig.control.remote import RunProgress
from rig.runs.mcap.reader import read_run

SEQUENCE = """\
sequence: 1
name: two
stages:
  - {name: a, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
  - {name: b, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 2, frequency_Hz: 2}],
     duration_s: 0.5, ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
"""
RECORDINGS = ("recording.mcap", "recording-2.mcap")


@pytest.fixture
def stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that was stopped in its second stage."""
    sequence, folder = tmp_path / "two.yaml", tmp_path / "run"
    sequence.write_text(SEQUENCE)

    def press(self: RunProgress, name: str, *rest: Any) -> None:
        if name == "b":
            raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(RunProgress, "__call__", press)
        assert status(["run", str(sequence), "--yes", "--out", str(folder)]) == 3
    return folder


def followed(folder: Path, socket: Path) -> Followed:
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


def test_a_continued_run_keeps_its_charts_and_events(stopped: Path, tmp_path: Path) -> None:
    socket = tmp_path / "run-1.sock"
    socket.touch()
    run = followed(stopped, socket)
    read_all(run)
    before = [words for _, words in run.events]
    assert any("stopped by the operator" in words for words in before)
    assert run.continued_s == []
    assert status(["resume", str(stopped), "--yes"]) == 0
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
    other = followed(stopped, socket)
    read_all(other)
    assert [words for _, words in other.events] == words
    np.testing.assert_array_equal(drawn(other), drawn(run))


def told(run: Followed, phase: str) -> dict[str, Any]:
    """Let a run report its phase, and return what a page then shows as its latest values."""
    run.hear({"phase": phase, "ended": None})
    run.read()
    found = run.parts()["live"][1]
    assert isinstance(found, dict)
    return found


def test_values_of_the_time_before_a_stop_are_never_current(
    stopped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    socket = tmp_path / "run-1.sock"
    socket.touch()
    run = followed(stopped, socket)
    # The program that continues the run connects; its recording does not exist yet.
    read_all(run)
    live = told(run, "connecting")
    assert live["time_s"] > 0
    assert (live["current"], live["drive"]) == (False, "not read yet")
    assert status(["resume", str(stopped), "--yes"]) == 0
    # A report that came after the last reading does not make the old values current.
    run.hear({"phase": "excite", "ended": None})
    assert not run.parts()["live"][1]["current"]
    monkeypatch.setattr(growing, "READ_BYTES", 1 << 14)
    for late, first in ((run, 1), (followed(stopped, socket), 0)):
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


def test_a_program_that_has_ended_does_not_show_the_recording_of_the_next(
    stopped: Path, tmp_path: Path
) -> None:
    run = followed(stopped, tmp_path / "gone.sock")
    read_all(run)
    before, begun = list(run.events), run.begun
    assert status(["resume", str(stopped), "--yes"]) == 0
    read_all(run)
    assert (run.events, run.begun, run.continued_s) == (before, begun, [])
    assert run.record is not None
    assert run.record.state == "done"


def test_a_recording_that_cannot_be_read_does_not_hide_the_next(
    stopped: Path, tmp_path: Path
) -> None:
    assert status(["resume", str(stopped), "--yes"]) == 0
    (stopped / RECORDINGS[0]).write_bytes(b"something else")
    socket = tmp_path / "run-1.sock"
    socket.touch()
    run = followed(stopped, socket)
    read_all(run)
    assert run.trouble is not None
    assert "not an MCAP recording" in run.trouble
    assert any("all 2 stages done" in words for _, words in run.events)
