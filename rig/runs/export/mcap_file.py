"""Exports a run or campaign as one MCAP file, which ROS 2, Foxglove and PlotJuggler read without
extensions.

The topic ``/recording/NAME`` has one message per sample, which contains the canonical channels. The
export of a run also has the topics ``/event`` (JSON), ``/can`` (can_msgs/msg/Frame) and
``/serial``. Log times are UTC: the time ``created`` of the recording plus the time since its start;
the stamp of a frame is its log time.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from identification.recording import CHANNELS, Dataset, Recording
from rig.runs.export.tables import KEY, Read, describe, misfit, parse
from rig.runs.export.traffic import FrameClock, messages, utc_ns
from rig.runs.mcap import ros
from rig.runs.mcap.layout import (
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAMES_TOPIC,
    decode_frames,
)
from rig.runs.mcap.writer import McapWriter
from rig.runs.run_record import RunRecord

RECORDING_TYPE = "loadrig/msg/Recording"
_CDR_HEAD = 4
"""Number of bytes before the first field of a message."""


def write_mcap(dataset: Dataset, path: Path, run: tuple[Path, RunRecord] | None) -> None:
    """Write the recordings and, for a run, its events and raw frames.

    Args:
        dataset: The recordings.
        path: The file.
        run: Folder and record of the run that the recordings are from, or None for a campaign.

    Raises:
        InputError: A recording of the run is damaged.
        OSError: The file cannot be written.
    """
    created = {} if run is None else {part.file: utc_ns(part.created) for part in run[1].parts}
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


def topics(names: Sequence[str]) -> list[str]:
    """Return the topic of each recording: letters, digits and underscores; equal topics are
    numbered.
    """
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "recording"
        topic = f"/recording/{plain}"
        found.append(f"{topic}_{len(found) + 1}" if topic in found else topic)
    return found


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
        clock = FrameClock(folder, part)
        for topic, message in messages(folder, part):
            if topic == EVENT_TOPIC:
                writer.message(event, clock.created_ns + message.time_ns, message.data)
            elif topic == FRAMES_TOPIC:
                for frame in map(clock.at, decode_frames(message.data)):
                    if ros.is_serial(frame):
                        writer.message(serial, frame.time_ns, ros.serial_bytes(frame))
                    else:
                        writer.message(can, frame.time_ns, ros.can_frame(frame))


def read_mcap(path: Path) -> list[Read] | None:
    """Read the recordings back. The result is None if the file contains no description.

    Raises:
        InputError: The numbers in the file do not fit the description.
        OSError: The file cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            texts = [item.metadata for item in reader.iter_metadata() if item.name == KEY]
            if not texts or "description" not in texts[0]:
                return None
            described = parse(texts[0]["description"], path)
            rows: dict[str, list[bytes]] = {
                topic: [] for topic in topics([one.name for one in described])
            }
            for _, channel, message in reader.iter_messages(rows, log_time_order=False):
                rows[channel.topic].append(message.data[_CDR_HEAD:])
    except (McapError, ValueError, EOFError, RuntimeError):
        return None  # the reader of other MCAP files reports the error
    found: list[Read] = []
    for one, data in zip(described, rows.values(), strict=True):
        width = len(one.channels)
        values = np.frombuffer(b"".join(data), "<f8")
        if len(data) != one.samples or values.size != one.samples * width:
            raise misfit(
                path,
                f"{one.name}: the file contains {len(data)} samples, its description states "
                f"{one.samples}",
            )
        columns = values.reshape(one.samples, width).T
        found.append(
            (one, {n: np.array(c, float) for n, c in zip(one.channels, columns, strict=True)})
        )
    return found
