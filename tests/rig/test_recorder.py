"""The recording: exact round trip, read by the MCAP library, robust to being cut off anywhere."""

import itertools
import os
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.interfaces import RawFrame
from rig.common.errors import StorageError
from rig.common.sample import Sample
from rig.runs.mcap.layout import (
    SAMPLE_TOPIC,
    decode_frames,
    decode_samples,
    encode_frames,
    encode_sample,
)
from rig.runs.mcap.reader import read_run
from rig.runs.recorder import Recorder, open_recorder

numbers = st.floats(allow_nan=True)
samples = st.builds(
    Sample,
    **dict.fromkeys(Sample._fields[:13], numbers),
    statusword=st.integers(0, 0xFFFF),
    segment=st.integers(0, 1000),
    fresh=st.booleans(),
    pressure=numbers,
)
frames = st.lists(
    st.builds(
        RawFrame,
        time_ns=st.integers(0, 1 << 62),
        identifier=st.integers(0, 0x7FF),
        data=st.binary(max_size=8),
        sent=st.booleans(),
    ),
    max_size=12,
)


def row(k: int) -> Sample:
    values = (k * 0.001 + n for n in range(13))
    return Sample(*values, statusword=0x27, segment=1, fresh=True, pressure=4e6 + k)  # type: ignore[misc]


def write(path: Path, count: int) -> Path:
    recorder = open_recorder(path)
    recorder.metadata("run", {"seed": "0"})
    recorder.attach("bench.yaml", "application/yaml", b"bench: 1")
    for k in range(count):
        recorder.sample(
            k * 1_000_000,
            row(k),
            [RawFrame(k, 0x80, b"", True), RawFrame(k, 0x181, b"1234", False)],
        )
    recorder.event(count * 1_000_000, "done", stage="x")
    recorder.close()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("whole") / "a.mcap", 700)


@given(st.lists(samples, max_size=5))
def test_samples_round_trip(rows: list[Sample]) -> None:
    columns = decode_samples(b"".join(map(encode_sample, rows)))
    for name, column in columns.items():
        np.testing.assert_array_equal(column, [float(getattr(r, name)) for r in rows])


@given(frames)
def test_frames_round_trip(seen: list[RawFrame]) -> None:
    assert decode_frames(encode_frames(seen)) == seen


def test_the_library_reads_every_field_by_the_schema_in_the_file(tmp_path: Path) -> None:
    with open(write(tmp_path / "a.mcap", 250), "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        seen = list(reader.iter_decoded_messages(topics=[SAMPLE_TOPIC]))
        assert [a.name for a in reader.iter_attachments()] == ["bench.yaml"]
    assert [message.log_time for _, _, message, _ in seen] == [k * 1_000_000 for k in range(250)]
    for k, (*_, decoded) in enumerate(seen):
        fields = {field.name for field in decoded.DESCRIPTOR.fields}
        assert fields == set(Sample._fields)
        assert all(getattr(decoded, name) == getattr(row(k), name) for name in fields)


def test_reading_back(whole: Path) -> None:
    log = read_run(whole)
    assert log.damage is None
    np.testing.assert_array_equal(log.samples["time"], [row(k).time for k in range(700)])
    assert log.events == ({"time": 0.7, "event": "done", "stage": "x"},)
    assert log.attachments == {"bench.yaml": b"bench: 1"}
    assert log.metadata == {"run": {"seed": "0"}}
    assert decode_frames(log.messages["/frames"][5].data)[1] == RawFrame(5, 0x181, b"1234", False)


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(share=st.floats(0, 1), zeros=st.sampled_from([0, 4096]))
def test_cut_off_anywhere(whole: Path, tmp_path: Path, share: float, zeros: int) -> None:
    """After a power cut, zeros may follow."""
    path = tmp_path / "cut.mcap"
    content = whole.read_bytes()
    path.write_bytes(content[: 8 + int(share * (len(content) - 9))] + bytes(zeros))
    log = read_run(path)
    n = len(log.samples["time"])
    np.testing.assert_array_equal(log.samples["time"], [row(k).time for k in range(n)])
    assert log.damage is not None
    assert f"{n} samples recovered" in log.damage


def chunks(content: bytes) -> list[tuple[int, int]]:
    """Return offset and end of every chunk, walking the records by hand."""
    found, offset = [], 8
    while content[offset] != 0x0F:
        end = offset + 9 + struct.unpack_from("<Q", content, offset + 1)[0]
        found += [(offset, end)] if content[offset] == 0x06 else []
        offset = end
    return found


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("long") / "a.mcap", 2000)


def test_reading_goes_on_behind_a_bad_chunk(long: Path, tmp_path: Path) -> None:
    damaged = bytearray(long.read_bytes())
    starts = chunks(damaged)
    begin, end = starts[4]
    damaged[(begin + end) // 2] ^= 0xFF
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged)
    log, whole = read_run(path), read_run(long)
    times = log.samples["time"]
    lost = np.setdiff1d(whole.samples["time"], times)
    assert 0 < len(lost) < 2000 / len(starts) + 50
    assert np.ptp(lost) == pytest.approx(0.001 * (len(lost) - 1))
    assert log.events == whole.events
    assert f"whole up to byte {begin} of {len(damaged)}" in log.damage
    assert f"lost between {lost[0] - 0.001:.3f} and {lost[-1] + 0.001:.3f} s" in log.damage
    assert log.damage.endswith(f"{len(times)} samples recovered")


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(share=st.floats(0, 1), value=st.integers(1, 255))
def test_one_bad_byte_costs_one_chunk_at_most_and_is_never_silent(long, tmp_path, share, value):
    """Wherever it is: in a chunk, its length, its opcode, a record without checksum, the index."""
    damaged = bytearray(long.read_bytes())
    end = chunks(damaged)[-1][1]
    damaged[min(8 + int(share * (end - 8)), end - 1)] ^= value
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged)
    log = read_run(path)
    assert len(log.samples["time"]) >= 2000 - 130
    assert np.all(np.diff(log.samples["time"]) > 0)
    assert set(log.samples["time"].tolist()) <= {row(k).time for k in range(2000)}
    if len(log.samples["time"]) < 2000 or not log.events:
        assert log.damage is not None


def test_a_record_that_vanished_is_missed(long: Path, tmp_path: Path) -> None:
    """A chunk turned into what readers may skip: only the counts at the end tell."""
    damaged = bytearray(long.read_bytes())
    damaged[chunks(damaged)[3][0]] = 0x07
    path = tmp_path / "bad.mcap"
    path.write_bytes(damaged)
    assert "messages are missing" in (read_run(path).damage or "")


CHILD = """
import sys
from pathlib import Path
from rig.runs.recorder import open_recorder
from rig.common.sample import Sample
recorder = open_recorder(Path(sys.argv[1]))
k = 0
while True:
    recorder.sample(k * 1_000_000, Sample(*[k * 0.001] * 13, 0x27, 1, True), [])
    k += 1
    if k % 10 == 0:
        print(k, flush=True)
"""


def test_a_killed_writer_loses_less_than_a_fifth_of_a_second(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        for _ in itertools.takewhile(lambda line: int(line) < 1550, child.stdout):
            pass
        os.kill(child.pid, signal.SIGKILL)
        written = max([1550, *(int(line) for line in child.stdout if line.endswith("\n"))])
        child.wait()
    log = read_run(path)
    assert log.damage is not None
    assert len(log.samples["time"]) > written - 200
    np.testing.assert_array_equal(log.samples["time"], np.arange(len(log.samples["time"])) * 0.001)


def test_a_full_disk_is_raised_and_closing_still_works() -> None:
    """/dev/full accepts an open and refuses every write, as a full disk does."""
    with open("/dev/full", "wb") as stream:
        recorder = Recorder(stream)
        with pytest.raises(StorageError, match="No space left"):
            recorder.event(0, "x")
        recorder.close()
        recorder.close()
        assert stream.closed


def fill(recorder: Recorder) -> None:
    for k in range(99):
        recorder.sample(k * 1_000_000, row(k), [RawFrame(k, 0x80, b"", True)] * 9)


def test_a_full_disk_met_by_a_full_chunk() -> None:
    with open("/dev/full", "wb", buffering=4096) as stream:
        recorder = Recorder(stream)
        with pytest.raises(StorageError, match="No space left"):
            fill(recorder)
        recorder.close()
