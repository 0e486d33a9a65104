"""The samples of a run in a stream, drift and gaps, and what a run says of its punctuality."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from drivers.interfaces import RawFrame
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.common.timing import EDGES_US, RESOLUTION, Histogram, Timing, summary
from rig.runs import run
from rig.runs.mcap import reader as mcap_stream
from rig.runs.mcap.reader import Damage, read_run, run_items
from rig.runs.recorder import open_recorder
from rig.runs.run import describe, drift_ppm
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


def test_segments_are_cut_out(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_stream, "BLOCK_BYTES", 10_000)
    wanted = [segment(1, 1000), segment(2, 1500, "hot_fire")]
    streamed, damage = run.by_segment(recording, wanted)
    at_once = read_run(recording).samples
    assert damage is None
    assert [len(streamed[k]["time"]) for k in (1, 2)] == [1000, 1500]
    for k in (1, 2):
        mine = at_once["segment"] == k
        for name, values in streamed[k].items():
            assert np.array_equal(values, at_once[name][mine], equal_nan=True), name
    assert "pressure" in streamed[2]
    assert "pressure" not in streamed[1]


def test_a_very_long_run_leaves_out_what_identification_does_without(recording, monkeypatch):
    monkeypatch.setattr(run, "MOST_SAMPLES", 2000)
    streamed, _ = run.by_segment(recording, [segment(1, 1000), segment(2, 1500)])
    assert not set(run.LEFT_OUT) & streamed[1].keys()
    assert {"command", "motor_angle", "angle", "current", "time"} <= streamed[1].keys()


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.999])
def test_a_file_cut_short_is_damage_and_read_to_the_cut(recording: Path, cut: float) -> None:
    data = recording.read_bytes()
    recording.write_bytes(data[: int(cut * len(data))])
    *_, last = run_items(recording, ["time"], only_samples=True)
    found, damage = run.by_segment(recording, [segment(1, 1000)])
    assert damage is not None
    assert last == Damage(damage)
    assert damage == read_run(recording).damage
    assert len(found[1]["time"]) == min(
        1000, np.count_nonzero(read_run(recording).samples["segment"] == 1)
    )


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    path.write_bytes(b"something else entirely")
    with pytest.raises(InputError, match="not an MCAP recording"):
        run.by_segment(path, [segment(1, 10)])
    with pytest.raises(InputError, match="cannot be read"):
        run.by_segment(tmp_path / "missing.mcap", [segment(1, 10)])


@pytest.mark.parametrize("said", [0, 400, 10**15])
def test_what_run_json_says_of_the_length_only_makes_room(recording: Path, said: int) -> None:
    found, damage = run.by_segment(recording, [segment(1, said)])
    assert damage is None
    assert np.array_equal(found[1]["time"], 1e-3 * np.arange(1000))


def test_a_stream_holds_little_beside_what_it_returns(recording, monkeypatch):
    monkeypatch.setattr(mcap_stream, "BLOCK_BYTES", 20_000)
    wanted = [segment(1, 1000), segment(2, 1500)]
    tracemalloc.start()
    found, _ = run.by_segment(recording, wanted)
    peak = tracemalloc.get_traced_memory()[1]
    read_run(recording)
    at_once = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = sum(values.nbytes for samples in found.values() for values in samples.values())
    assert peak < 1.6 * size
    assert at_once > 3.0 * size


TIME = 1e-3 * np.arange(20_000)


def test_clocks_that_agree_say_nothing() -> None:
    assert describe(TIME, TIME + 4e-4, TIME + 1e-4, TIME + 2e-4) == []


@pytest.mark.parametrize("ppm", [-80.0, -3.0, 5.0, 60.0])
def test_drift_is_measured_through_jitter_and_late_stamps(ppm: float) -> None:
    rng = np.random.default_rng(0)
    other = 7.0 + TIME * (1.0 + 1e-6 * ppm) + 2e-5 * rng.uniform(size=len(TIME))
    other[::1000] += 5e-4
    assert drift_ppm(TIME, other) == pytest.approx(ppm, abs=0.2)


def test_a_clock_that_stands_or_jumps_back_has_no_drift() -> None:
    assert drift_ppm(TIME, np.zeros_like(TIME)) is None
    assert drift_ppm(TIME, np.where(TIME > 10.0, TIME - 5.0, TIME)) is None
    assert drift_ppm(TIME[:3], TIME[:3]) is None


def test_what_is_found_is_told() -> None:
    kept = np.ones(len(TIME), dtype=bool)
    kept[500:503] = kept[9000] = False
    time = TIME[kept]
    host = time + np.where(np.arange(len(time)) % 100 == 0, 3e-3, 3e-4)
    notes = describe(time, host, time * (1.0 + 40e-6), time * (1.0 - 10e-6))
    assert notes == [
        "2 gaps, 4 samples lost, the longest gap 4 ms",
        "1 % of the answers came more than one period late",
        "the drive's clock runs +40.0 ppm against the host's",
        "the encoder's clock runs -50.0 ppm against the drive's",
    ]


def test_bins_hold_what_is_up_to_their_end() -> None:
    histogram = Histogram()
    for duration_ns in (0, 1, 20_000, 20_001, 50_000_000, 50_000_001):
        histogram.note(duration_ns)
    assert histogram.counts[:3] == [1, 2, 1]
    assert histogram.counts[-2:] == [1, 1]
    assert len(histogram.counts) == len(EDGES_US) + 1
    assert histogram.worst_ns == 50_000_001


@pytest.mark.parametrize("true_us", np.geomspace(1.1, 900_000.0, 12))
def test_no_quantile_is_off_by_more_than_the_resolution(true_us: float) -> None:
    """Judged by a bin's end, a true 11 ms was 20 ms."""
    histogram = Histogram()
    for k in range(1000):
        histogram.note(round(true_us * 1000 * (2.0 if k >= 990 else 1.0)))
    assert histogram.quantile_us(0.99) == pytest.approx(true_us, rel=RESOLUTION)
    assert histogram.quantile_us(0.5) == pytest.approx(true_us, rel=RESOLUTION)


def test_a_first_cycle_that_failed_is_no_cycle() -> None:
    for part in ("lateness", "answer"):
        timing = Timing()
        getattr(timing, part).note(130_000)
        assert summary(timing.record()) == "no cycle was completed"


def test_a_summary_states_every_loss() -> None:
    timing = Timing()
    timing.lateness.note(130_000)
    timing.answer.note(700_000)
    timing.missed_syncs, timing.lost_servo, timing.lost_encoder, timing.oldest_s = 3, 2, 1, 0.999
    assert summary(timing.record()) == (
        "lateness of cycles p99 130 us, worst 130 us; answer of the devices p99 700 us; "
        "3 SYNCs missed; samples lost: 2 of the drive, 1 of the encoder; oldest sample 999 ms"
    )
