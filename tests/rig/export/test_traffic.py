"""Raw frames of a run read back by the readers of python-can and ROS: bit for bit."""

import json
from datetime import datetime
from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from drivers.can.port import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from drivers.interfaces import RawFrame
from drivers.serial_port import SERIAL_FLAG
from identification.recording import Dataset
from rig.cli.entry import status
from rig.common.sample import Sample
from rig.runs.export import extension, write_mcap
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.recorder import open_recorder
from rig.runs.run_file import read_record

BUS_ERROR = 0x80
identifiers = st.one_of(
    st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda n: n | EXTENDED_FLAG)
)
data_frames = st.builds(
    RawFrame, st.integers(0, 1 << 50), identifiers, st.binary(max_size=8), st.booleans()
)
remote_frames = st.builds(
    RawFrame,
    st.integers(0, 1 << 50),
    identifiers.map(lambda n: n | REMOTE_FLAG),
    st.just(b""),
    st.booleans(),
)
error_frames = st.builds(
    RawFrame,
    st.integers(0, 1 << 50),
    st.just(ERROR_FLAG | BUS_ERROR),
    st.just(bytes(8)),
    st.just(False),
)
serial_pieces = st.builds(
    RawFrame,
    st.integers(0, 1 << 50),
    st.integers(0, 255).map(lambda n: n | SERIAL_FLAG),
    st.binary(min_size=1, max_size=8),
    st.booleans(),
)
traffic = st.lists(
    st.one_of(data_frames, remote_frames, error_frames, serial_pieces), min_size=1, max_size=30
)


def with_frames(run: Path, frames: list[RawFrame]) -> None:
    """Replace the run's recording by one that holds these frames."""
    path = run / "recording.mcap"
    path.unlink()
    recorder = open_recorder(path)
    for k, frame in enumerate(frames):
        values = [k * 1e-3, *(0.0 for _ in range(12))]
        row = Sample(*values, statusword=0, segment=0, fresh=True)  # type: ignore[misc]
        recorder.sample(k * 1_000_000, row, [frame])
    recorder.close()


def exported(run: Path, kind: str) -> Path:
    path = run.parent / f"traffic.{extension(kind)}"
    path.unlink(missing_ok=True)
    assert status(["export", str(run), "--format", kind, "--out", str(path)]) == 0
    return path


def expected(message: can.Message, frame: RawFrame) -> bool:
    flags = frame.identifier
    if flags & ERROR_FLAG:
        return message.is_error_frame
    return (
        message.arbitration_id == flags & 0x1FFFFFFF
        and message.is_extended_id == bool(flags & EXTENDED_FLAG)
        and message.is_remote_frame == bool(flags & REMOTE_FLAG)
        and not message.is_error_frame
        and message.is_rx != frame.sent
        and bytes(message.data) == frame.data
        and message.dlc == len(frame.data)
    )


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frames=traffic, more=data_frames)
def test_any_frames_come_back(run, frames, more):
    frames = sorted([*frames, more], key=lambda frame: frame.time_ns)
    with_frames(run, frames)
    with can.CanutilsLogReader(exported(run, "candump")) as messages:
        found = list(messages)
    wanted = [frame for frame in frames if not _serial(frame)]
    assert len(found) == len(wanted)
    assert all(map(expected, found, wanted))
    base = datetime.fromisoformat(read_record(run).parts[0].created).timestamp()
    for message, frame in zip(found, wanted, strict=True):
        assert abs(message.timestamp - base - frame.time_ns / 1e9) < 2e-6


def _serial(frame: RawFrame) -> bool:
    return not frame.identifier & 0xE0000000 and bool(frame.identifier & SERIAL_FLAG)


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(frames=traffic)
def test_any_frames_come_back_from_mcap_by_the_reader_of_ros(run, frames):
    frames = sorted(frames, key=lambda frame: frame.time_ns)
    path = run.parent / "direct.mcap"
    with_frames(run, frames)
    write_mcap(Dataset(()), path, (run, read_record(run)))
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = [
            (schema.name, message)
            for schema, _, _, message in reader.iter_decoded_messages(log_time_order=False)
        ]
    assert len(found) == len(frames)
    can_found = [m for name, m in found if name == "can_msgs/msg/Frame"]
    for message, frame in zip(can_found, [f for f in frames if not _serial(f)], strict=True):
        flags = frame.identifier
        assert message.id == flags & 0x1FFFFFFF
        assert message.is_extended == bool(flags & EXTENDED_FLAG)
        assert message.is_rtr == bool(flags & REMOTE_FLAG)
        assert message.is_error == bool(flags & ERROR_FLAG)
        assert bytes(message.data)[: message.dlc] == frame.data
        assert message.header.frame_id == ("sent" if frame.sent else "received")
    serial_found = [m for name, m in found if name == "loadrig/msg/SerialBytes"]
    for message, frame in zip(serial_found, [f for f in frames if _serial(f)], strict=True):
        assert message.line == frame.identifier & ~SERIAL_FLAG
        assert bytes(message.data) == frame.data


def test_a_serial_run_has_no_can_frames(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_frames(run, [RawFrame(0, SERIAL_FLAG | 1, b"abc", True)])
    path = run.parent / "a.log"
    assert status(["export", str(run), "--format", "candump", "--out", str(path)]) == 2
    assert "its bus is a serial line" in capsys.readouterr().err
    assert not path.exists()


def test_the_events_of_a_run_are_in_its_mcap(run: Path) -> None:
    path = exported(run, "mcap")
    with path.open("rb") as stream:
        events = [
            json.loads(message.data)
            for _, _, message in make_reader(stream).iter_messages(["/event"])
        ]
    assert events == list(read_run(run / "recording.mcap").events)


def test_a_damaged_recording_is_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = run / "recording.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(data)
    assert status(["export", str(run), "--format", "candump", "--out", str(run / "a.log")]) == 2
    assert "use `rig recover" in capsys.readouterr().err
    assert decode_frames(b"") == []
