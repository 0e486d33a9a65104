"""Topics of the live stream for Foxglove and PlotJuggler: names, schemas, and the conversion of
recorded messages to the messages of the stream.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from drivers.interfaces import RawFrame
from rig.runs.mcap import ros
from rig.runs.mcap.layout import (
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAMES_TOPIC,
    SAMPLE_TOPIC,
    decode_frames,
)
from rig.runs.mcap.reader import Message


@dataclass(frozen=True)
class Topic:
    """One topic of the stream.

    Attributes:
        name: Name of the topic for the client.
        recorded: Topic of the recording from which the messages come.
        encoding: Encoding of the messages.
        schema: Name, encoding and text of the definition of the messages.
    """

    name: str
    recorded: str
    encoding: str
    schema: tuple[str, str, bytes]


def _ros(name: str, recorded: str, kind: str, text: str) -> Topic:
    return Topic(name, recorded, ros.ENCODING, (kind, ros.SCHEMA_ENCODING, text.encode()))


TOPICS = (
    _ros(SAMPLE_TOPIC, SAMPLE_TOPIC, ros.SAMPLE_TYPE, ros.SAMPLE_TEXT),
    Topic(EVENT_TOPIC, EVENT_TOPIC, "json", ("loadrig.Event", "jsonschema", EVENT_JSON_SCHEMA)),
    _ros(ros.CAN_TOPIC, FRAMES_TOPIC, ros.FRAME_TYPE, ros.FRAME_TEXT),
    _ros(ros.SERIAL_TOPIC, FRAMES_TOPIC, ros.SERIAL_TYPE, ros.SERIAL_TEXT),
)
"""PlotJuggler reads only ROS 2 messages from a live stream; samples and frames are therefore
encoded as ROS 2 messages.
"""


class Outgoing(NamedTuple):
    """One message of the stream."""

    topic: str
    time_ns: int
    data: bytes


def outgoing(messages: Iterable[tuple[str, Message]], wanted: frozenset[str]) -> Iterator[Outgoing]:
    """Yield the messages of the stream that follow from a record of the recording, in recorded
    order.

    Args:
        messages: Recorded topic and message.
        wanted: Names of the topics that the client has subscribed to.
    """
    for recorded, group in groupby(messages, lambda item: item[0]):
        rows = [message for _, message in group]
        yield from _WRITERS[recorded](rows, wanted)


def _samples(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if SAMPLE_TOPIC in wanted:
        for row, data in zip(rows, ros.samples([row.data for row in rows]), strict=True):
            yield Outgoing(SAMPLE_TOPIC, row.time_ns, data)


def _events(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if EVENT_TOPIC in wanted:
        for row in rows:
            yield Outgoing(EVENT_TOPIC, row.time_ns, json_without_nan(row.data))


def _frames(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if not wanted & {ros.CAN_TOPIC, ros.SERIAL_TOPIC}:
        return
    for row in rows:
        for frame in decode_frames(row.data):
            item = _frame(row.time_ns, frame)
            if item.topic in wanted:
                yield item


def _frame(time_ns: int, frame: RawFrame) -> Outgoing:
    if ros.is_serial(frame):
        return Outgoing(ros.SERIAL_TOPIC, time_ns, ros.serial_bytes(frame))
    return Outgoing(ros.CAN_TOPIC, time_ns, ros.can_frame(frame))


_WRITERS: dict[str, Callable[[Sequence[Message], frozenset[str]], Iterator[Outgoing]]] = {
    SAMPLE_TOPIC: _samples,
    EVENT_TOPIC: _events,
    FRAMES_TOPIC: _frames,
}


def json_without_nan(data: bytes) -> bytes:
    """Return an event as strict JSON: NaN and infinities, which JSON lacks, become text.

    An event without NaN and infinities is returned unchanged.
    """
    found: list[str] = []

    def text(word: str) -> str:
        found.append(word)
        return word

    event = json.loads(data, parse_constant=text)
    return json.dumps(event).encode() if found else data
