"""Exports recordings, and the raw traffic of a run, for other tools.

An MCAP file is read by ROS 2, Foxglove and PlotJuggler without extensions. Its topic
``/recording/NAME`` has one message per sample, which contains the canonical channels. The export of
a run also has the topics ``/event`` (JSON), ``/can`` (can_msgs/msg/Frame) and ``/serial``. Log
times are UTC: the time ``created`` of the recording plus the time since its start; the stamp of a
frame is its log time.

In the format of candump, identifiers, data, direction and order are exact; times are rounded to
microseconds, the resolution of the format.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TextIO

import numpy as np

from drivers.interfaces import ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG, RawFrame
from identification.recording import CHANNELS, Dataset, Recording
from rig.common.errors import InputError
from rig.common.places import replacing, write_text
from rig.common.timing import instant
from rig.runs import exported
from rig.runs.exported import KEY, describe, sidecar, topics
from rig.runs.mcap import ros
from rig.runs.mcap.layout import (
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAMES_TOPIC,
    decode_frames,
)
from rig.runs.mcap.reader import START, DamageError, Message, RecordFile
from rig.runs.mcap.writer import McapWriter
from rig.runs.run_record import PartRecord, RunRecord

Run = tuple[Path, RunRecord]  # folder and record of a run
INTERFACE = "can0"  # name of the bus in a candump log
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def messages(folder: Path, part: PartRecord) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of one recording of a run, in recorded order.

    If the recording was never closed, all messages up to its last complete chunk are yielded.
    """
    path = folder / part.file
    with _readable(path, folder), RecordFile(path) as recording:
        offset: int | None = START
        while offset is not None and (piece := recording.at(offset)) is not None:
            yield from piece.messages
            offset = piece.following


@contextmanager
def _readable(path: Path, folder: Path) -> Iterator[None]:
    """Name a recording that is damaged or cannot be read, and the remedy."""
    try:
        yield
    except DamageError as error:
        raise InputError(f"{path}: damaged ({error}); use `rig recover {folder}`") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _utc_ns(created: str) -> int:
    """Return an ISO time as ns since 1970."""
    return (instant(created) - _EPOCH) // timedelta(microseconds=1) * 1000


def _at(frame: RawFrame, created_ns: int) -> RawFrame:
    """Return a frame of a recording with its time, ns since 1970."""
    return frame._replace(time_ns=created_ns + frame.time_ns)


@dataclass
class Count:
    """Numbers of the written frames, and of data that the format cannot contain."""

    frames: int = 0
    serial: int = 0
    parts: list[str] = field(default_factory=list)


def _can_frames(folder: Path, record: RunRecord, count: Count) -> Iterator[RawFrame]:
    """Yield the CAN frames of a run, times in ns since 1970; serial bytes are only counted."""
    for part in record.parts:
        created_ns = _utc_ns(part.created)
        for topic, message in messages(folder, part):
            if topic != FRAMES_TOPIC:
                continue
            for frame in decode_frames(message.data):
                if ros.is_serial(frame):
                    count.serial += 1
                else:
                    count.frames += 1
                    yield _at(frame, created_ns)


def _write_candump(stream: TextIO, frames: Iterator[RawFrame]) -> None:
    """Write a log as ``candump -L -x`` does; T marks frames that the host sent."""
    for frame in frames:
        flags = frame.identifier
        seconds, microseconds = divmod(_microseconds(frame.time_ns), 1_000_000)
        if flags & ERROR_FLAG:
            identifier = f"{flags & (IDENTIFIER_BITS | ERROR_FLAG):08X}"
        elif flags & EXTENDED_FLAG:
            identifier = f"{flags & IDENTIFIER_BITS:08X}"
        else:
            identifier = f"{flags & IDENTIFIER_BITS:03X}"
        data = "R" if flags & REMOTE_FLAG else frame.data.hex().upper()
        direction = "T" if frame.sent else "R"
        stream.write(
            f"({seconds:010d}.{microseconds:06d}) {INTERFACE} {identifier}#{data} {direction}\n"
        )


def _microseconds(time_ns: int) -> int:
    return (time_ns + 500) // 1000


def export_traffic(folder: Path, record: RunRecord, path: Path) -> Count:
    """Write the raw CAN frames of a run."""
    count = Count(parts=[part.file for part in record.parts])
    with open(path, "w", encoding="ascii", newline="\n") as stream:
        _write_candump(stream, _can_frames(folder, record, count))
    if not count.frames:
        wire = "its bus is a serial line" if count.serial else "none was recorded"
        raise InputError(
            f"{folder}: no CAN frames to export ({wire}); --format mcap also exports serial bytes"
        )
    return count


RECORDING_TYPE = "loadrig/msg/Recording"


def write_mcap(dataset: Dataset, path: Path, run: Run | None) -> None:
    """Write the recordings and, for a run, its events and raw frames."""
    created = {} if run is None else {part.file: _utc_ns(part.created) for part in run[1].parts}
    with open(path, "wb") as stream:
        writer = McapWriter(stream)
        text: dict[tuple[str, ...], int] = {}
        places = topics([recording.name for recording in dataset.recordings])
        for topic, recording in zip(places, dataset.recordings, strict=True):
            names = _channels(recording)
            if names not in text:
                kind = RECORDING_TYPE if not text else f"{RECORDING_TYPE}{len(text) + 1}"
                body = "".join(f"float64 {name}\n" for name in names).encode()
                text[names] = writer.schema(kind, ros.SCHEMA_ENCODING, body)
            channel = writer.channel(topic, ros.ENCODING, text[names])
            begun_ns = created.get(Path(recording.source).name, 0)
            for time_ns, data in _rows(recording, names, begun_ns):
                writer.message(channel, time_ns, data)
        if run is not None:
            _write_run(writer, *run)
        writer.metadata(KEY, {"description": describe(dataset.recordings)})
        writer.finish()


def _channels(recording: Recording) -> tuple[str, ...]:
    return tuple(name for name in CHANNELS if name in recording.channels)


def _rows(
    recording: Recording, names: tuple[str, ...], begun_ns: int
) -> Iterator[tuple[int, bytes]]:
    """Yield log time and message of each sample."""
    head = ros.LITTLE_ENDIAN
    stacked = np.stack([recording.channels[name] for name in names], axis=1).astype("<f8")
    start = 0.0 if recording.start is None else recording.start - float(recording.time[0])
    earliest = min(0.0, start + float(recording.time[0]))
    for row, time in zip(stacked, recording.time.tolist(), strict=True):
        yield begun_ns + round((start + time - earliest) * 1e9), head + row.tobytes()


def _write_run(writer: McapWriter, folder: Path, record: RunRecord) -> None:
    """Write events and raw frames of all recordings of a run."""
    event = writer.channel(
        EVENT_TOPIC, "json", writer.schema("loadrig.Event", "jsonschema", EVENT_JSON_SCHEMA)
    )
    can, serial = (
        writer.channel(topic, ros.ENCODING, writer.schema(kind, ros.SCHEMA_ENCODING, body.encode()))
        for topic, kind, body in (
            (ros.CAN_TOPIC, ros.FRAME_TYPE, ros.FRAME_TEXT),
            (ros.SERIAL_TOPIC, ros.SERIAL_TYPE, ros.SERIAL_TEXT),
        )
    )
    for part in record.parts:
        created_ns = _utc_ns(part.created)
        for topic, message in messages(folder, part):
            if topic == EVENT_TOPIC:
                writer.message(event, created_ns + message.time_ns, message.data)
            elif topic == FRAMES_TOPIC:
                for each in decode_frames(message.data):
                    frame = _at(each, created_ns)
                    if ros.is_serial(frame):
                        writer.message(serial, frame.time_ns, ros.serial_bytes(frame))
                    else:
                        writer.message(can, frame.time_ns, ros.can_frame(frame))


WRITERS: Mapping[str, Callable[[Dataset, Path, Run | None], None]] = {
    "csv": lambda dataset, path, _: exported.write_csv(dataset, path),
    "mat": lambda dataset, path, _: exported.write_mat(dataset, path),
    "parquet": lambda dataset, path, _: exported.write_parquet(dataset, path),
    "mcap": write_mcap,
}
"""Writers of recordings by format."""
CANDUMP = "candump"  # format of raw CAN frames
FORMATS = (*WRITERS, CANDUMP)
"""Formats by name."""


def extension(kind: str) -> str:
    """Return the usual extension of a format's files, without a dot."""
    return "log" if kind == CANDUMP else kind


def with_ending(path: Path, kind: str) -> Path:
    """Return the path of an export with the ending of its format, by which a campaign and other
    programs recognise it; an ending that is missing is added.
    """
    ending = extension(kind)
    if not path.suffix:
        return path.with_name(f"{path.name}.{ending}")
    given = path.suffix[1:].lower()
    if given == ending:
        return path
    other = next((name for name in FORMATS if extension(name) == given), None)
    remedy = f"give --out {path}.{ending}" + (f", or --format {other}" if other else "")
    raise InputError(
        f"--out {path}: a file of format {kind} ends in .{ending}, not in {path.suffix}; {remedy}"
    )


def files(dataset: Dataset, path: Path, kind: str) -> dict[Path, Dataset]:
    """Return the files of an export, and the recordings in each file.

    A CSV file is one table with one time base, so that other tools and campaign files can use the
    file directly. Each of several recordings is written to its own file, whose name is ``path``
    plus the name of the recording.
    """
    if kind != "csv" or len(dataset.recordings) == 1:
        return {path: dataset}
    found: dict[Path, Dataset] = {}
    for recording in dataset.recordings:
        name = re.sub(r"[^\w.-]+", "-", recording.name).strip("-")
        place = path.with_name(f"{path.stem}-{name}{path.suffix}")
        if place in found:
            place = path.with_name(f"{path.stem}-{name}-{len(found) + 1}{path.suffix}")
        found[place] = Dataset((recording,))
    return found


def export(dataset: Dataset, path: Path, kind: str, run: Run | None = None) -> None:
    """Write one file of :func:`files`, and beside a CSV file its description.

    ``kind``: one of :data:`WRITERS`. ``run``: folder and record of the run of the recordings; an
    MCAP file also contains the events and frames of the run.
    """
    with replacing(path) as draft:
        WRITERS[kind](dataset, draft, run)
    if kind == "csv":
        write_text(sidecar(path), describe(dataset.recordings))
