"""A recording is read while it grows: every sample and event once, half records not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.common.sample import Sample
from rig.console import followed
from rig.console.followed import Growing, event_words
from rig.runs.mcap.reader import DamageError
from rig.runs.recorder import open_recorder


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
def test_everything_is_read_once_however_it_grows(
    tmp_path: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(followed, "READ_BYTES", 40_000)
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


@pytest.mark.parametrize("content", [b"no recording at all", b"\x89MCAP0\r\n" + b"\xee" * 30])
def test_what_is_no_recording_is_said(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(DamageError):
        Growing(path).read()


def test_events_are_told_in_words() -> None:
    assert event_words({"time": 1.25, "event": "answer", "stage": "heavy", "weight_kg": 30.6}) == (
        "1.2 s  heavy: 30.6 kg confirmed"
    )
    assert event_words({"time": 3.0, "event": "repeat", "stage": "heavy"}) == (
        "3.0 s  heavy: the stage will be repeated"
    )
    assert event_words({"time": 4.0, "event": "abort", "stage": "heavy"}) == (
        "4.0 s  heavy: the operator aborted the run"
    )
    assert event_words({"time": 2, "event": "stopped", "message": "by the operator"}) == (
        "2.0 s  stopped: by the operator"
    )
    assert event_words({"event": "prompt"}) == "prompt"
