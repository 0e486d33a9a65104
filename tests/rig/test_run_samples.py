"""The samples of a run in a stream: what reading all at once gives, and what happens where the file
is not whole.
"""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from drivers.interfaces import RawFrame
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.runs import run
from rig.runs.mcap import reader as mcap_stream
from rig.runs.mcap.reader import Block, DamageError, read_run, run_items
from rig.runs.recorder import open_recorder
from rig.runs.run_record import Load, SegmentRecord

CYCLES = 3000


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two segments and a pause between them, with frames of changing number and an event."""
    path = tmp_path / "recording.mcap"
    recorder = open_recorder(path)
    rng = np.random.default_rng(0)
    for k in range(CYCLES):
        segment = 1 if k < 1000 else 2 if k >= 1500 else 0
        values = rng.normal(size=9)
        sample = Sample(
            k * 1e-3,
            k * 1e-3 + 4e-4,
            k * 1e-3,
            k * 1e-3,
            *values,
            0x237,
            segment,
            fresh=k % 700 != 5,
        )
        frames = [RawFrame(k, 0x80, b"", True)] * (k % 3)
        recorder.sample(k * 1_000_000, sample, frames)
        if k == 1200:
            recorder.event(k * 1_000_000, "weight")
    recorder.close()
    return path


def segment(index: int, samples: int, stage: Load = "unloaded") -> SegmentRecord:
    return SegmentRecord(index, f"s{index}", stage, 0.0, 0.0, samples, 1.0)


def test_blocks_are_the_whole(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_stream, "BLOCK_BYTES", 10_000)
    items = run_items(recording, ["time", "current", "segment"], only_samples=True)
    blocks = [item.samples for item in items if isinstance(item, Block)]
    assert len(blocks) > 20
    whole = read_run(recording).samples
    for name in ("time", "current", "segment"):
        assert np.array_equal(np.concatenate([b[name] for b in blocks]), whole[name])


def test_segments_are_cut_out(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_stream, "BLOCK_BYTES", 10_000)
    wanted = [segment(1, 1000), segment(2, 1500, "hot_fire")]
    streamed, damage = run.by_segment(recording, wanted, whole=True)
    at_once, _ = run.by_segment(recording, wanted, whole=False)
    assert damage is None
    assert [len(streamed[k]["time"]) for k in (1, 2)] == [1000, 1500]
    for k in (1, 2):
        assert list(streamed[k]) == list(at_once[k])
        for name, values in streamed[k].items():
            assert np.array_equal(values, at_once[k][name], equal_nan=True), name
    assert "pressure" in streamed[2]
    assert "pressure" not in streamed[1]


def test_a_very_long_run_leaves_out_what_identification_does_without(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "MOST_SAMPLES", 2000)
    streamed, _ = run.by_segment(recording, [segment(1, 1000), segment(2, 1500)], whole=True)
    assert not set(run.LEFT_OUT) & streamed[1].keys()
    assert {"command", "motor_angle", "angle", "current", "time"} <= streamed[1].keys()


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.999])
def test_a_file_cut_short_is_damage_and_read_at_once(recording: Path, cut: float) -> None:
    data = recording.read_bytes()
    recording.write_bytes(data[: int(cut * len(data))])
    with pytest.raises(DamageError):
        list(run_items(recording, ["time"], only_samples=True))
    found, damage = run.by_segment(recording, [segment(1, 1000)], whole=True)
    assert damage is not None
    assert len(found[1]["time"]) == min(
        1000, np.count_nonzero(read_run(recording).samples["segment"] == 1)
    )


def test_a_flipped_byte_is_damage(recording: Path) -> None:
    data = bytearray(recording.read_bytes())
    data[len(data) // 3] ^= 0xFF
    recording.write_bytes(data)
    assert run.by_segment(recording, [segment(1, 1000)], whole=True)[1] is not None


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    path.write_bytes(b"something else entirely")
    with pytest.raises(InputError, match="not an MCAP recording"):
        run.by_segment(path, [segment(1, 10)], whole=True)
    with pytest.raises(InputError, match="cannot be read"):
        run.by_segment(tmp_path / "missing.mcap", [segment(1, 10)], whole=True)


@pytest.mark.parametrize("said", [0, 400, 10**15])
def test_what_run_json_says_of_the_length_only_makes_room(recording: Path, said: int) -> None:
    found, damage = run.by_segment(recording, [segment(1, said)], whole=True)
    assert damage is None
    assert np.array_equal(found[1]["time"], 1e-3 * np.arange(1000))


def test_a_stream_holds_little_beside_what_it_returns(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_stream, "BLOCK_BYTES", 20_000)
    wanted = [segment(1, 1000), segment(2, 1500)]
    peaks = {}
    for whole in (True, False):
        tracemalloc.start()
        found, _ = run.by_segment(recording, wanted, whole=whole)
        peaks[whole] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    size = sum(values.nbytes for samples in found.values() for values in samples.values())
    assert peaks[True] < 1.6 * size
    assert peaks[False] > 3.0 * size
