"""Frames and samples of a run on one clock, whose origin is far, read by other projects."""

import csv
import struct
from datetime import datetime
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as Protobuf

from drivers.clock import SimulatedClock
from rig.cli.entry import status
from rig.runs.run_file import read_record

BOOT_NS = 1_254_980_000_000
ANSWER_S = 0.4e-3
"""Time from the start of a cycle of the fake bench to its frames."""
PDO = 0x181


@pytest.fixture
def run(runner: Any, fake_bench: Any) -> Path:
    folder, _ = runner(fake_bench(clock=SimulatedClock(BOOT_NS)))
    return Path(folder.path)


def created(run: Path) -> float:
    return datetime.fromisoformat(read_record(run).parts[0].created).timestamp()


def exported(run: Path, kind: str, name: str) -> Path:
    assert status(["export", str(run), "--format", kind, "--out", str(run / name)]) == 0
    return run / name


def sample_times(run: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    with (run / "recording.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[Protobuf()])
        return np.array([m.time for *_, m in reader.iter_decoded_messages(["/sample"])])


def behind(times: Any, frames: Any) -> Any:
    """Time from the start of each cycle to its frames, s."""
    frames = np.sort(frames)
    return frames[np.searchsorted(frames, np.add(times, ANSWER_S / 2))] - times


def test_recording_and_exports_have_one_clock(run: Path) -> None:
    times, found = sample_times(run), list[float]()
    with (run / "recording.mcap").open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(["/frames"]):
            found += [f[0] / 1e9 for f in struct.iter_unpack("<qIB8sB", message.data)]
    np.testing.assert_allclose(behind(times, found), ANSWER_S, atol=1e-9)
    start = created(run)
    with can.CanutilsLogReader(exported(run, "candump", "a.log")) as messages:
        stamps = [m.timestamp - start for m in messages if m.arbitration_id == PDO]
    np.testing.assert_allclose(behind(times, stamps), ANSWER_S, atol=3e-6)
    logged: dict[str, list[float]] = {}
    with exported(run, "mcap", "a.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.topic == "/can":
                head = struct.unpack_from("<iI", message.data, 4)
                assert message.log_time == head[0] * 1_000_000_000 + head[1]
            logged.setdefault(channel.topic, []).append(message.log_time / 1e9 - start)
    frames = logged.pop("/can")
    recordings = [name for name in logged if name.startswith("/recording/")]
    assert len(recordings) == 3
    for name in recordings:
        np.testing.assert_allclose(behind(logged[name], frames), ANSWER_S, atol=1e-6)
    # The times of a CSV export are those of the samples, so they fit those of the frames.
    exported(run, "csv", "a.csv")
    with (run / "a-heavy.csv").open() as stream:
        table = next(csv.DictReader(stream))
    assert np.min(np.abs(times - float(table["time"]))) < 1e-9


def test_after_a_recovery(run: Path) -> None:
    """A recording whose writer died keeps its clock when it is repaired."""
    path = run / "recording.mcap"
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    assert status(["recover", str(run)]) == 0
    with can.CanutilsLogReader(exported(run, "candump", "a.log")) as messages:
        stamps = [m.timestamp - created(run) for m in messages if m.arbitration_id == PDO]
    np.testing.assert_allclose(behind(sample_times(run), stamps), ANSWER_S, atol=3e-6)
