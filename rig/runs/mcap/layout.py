"""Message layout of a recording: one protobuf message per sample, one packed message for the raw
frames of a cycle.

The module contains the sample schema as a FileDescriptorSet, so that PlotJuggler and Foxglove can
open a recording, and neither writer nor reader needs a protobuf library. Every field is a double at
a fixed place, also if its value is zero, so that consecutive messages form an array.
"""

from __future__ import annotations

import struct
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.common.sample import Sample

if TYPE_CHECKING:
    from drivers.interfaces import RawFrame

SAMPLE_TOPIC = "/sample"
EVENT_TOPIC = "/event"
FRAMES_TOPIC = "/frames"
TOPICS = (SAMPLE_TOPIC, EVENT_TOPIC, FRAMES_TOPIC)
"""Topics of channels 1 to 3: fixed, so that damaged channel records do not matter."""
SAMPLE_SCHEMA = "loadrig.Sample"
FRAME_ENCODING = "loadrig-frames"
CLOCK_METADATA = "clock"
"""Metadata of a recording that states the start of the recording by the host's clock."""
EVENT_JSON_SCHEMA = (
    b'{"type":"object","properties":{"time":{"type":"number"},"event":{"type":"string"}},'
    b'"required":["time","event"]}'
)

_DOUBLE_WIRE_TYPE = 1
_BYTES_WIRE_TYPE = 2
_FRAME = "qI9p?"
"""One raw frame: time, ns; identifier; length; up to 8 data bytes; sent by the host."""
FRAME_BYTES = struct.calcsize("<" + _FRAME)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _integer(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _block(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | _BYTES_WIRE_TYPE) + _varint(len(content)) + content


def _double_field(name: str, number: int) -> bytes:
    """FieldDescriptorProto: name = 1, number = 3, label = 4 (optional), type = 5 (double)."""
    content = _block(1, name.encode()) + _integer(3, number) + _integer(4, 1) + _integer(5, 1)
    return _block(2, content)


def sample_descriptor() -> bytes:
    """Return the FileDescriptorSet of the sample message (google/protobuf/descriptor.proto)."""
    package, message = SAMPLE_SCHEMA.split(".")
    fields = b"".join(_double_field(name, n) for n, name in enumerate(Sample._fields, start=1))
    file = _block(1, b"loadrig/sample.proto") + _block(2, package.encode())
    file += _block(4, _block(1, message.encode()) + fields) + _block(12, b"proto3")
    return _block(1, file)


_TAGS = [_varint(number << 3 | _DOUBLE_WIRE_TYPE) for number in range(1, len(Sample._fields) + 1)]
_SAMPLE = struct.Struct("<" + "".join(f"{len(tag)}sd" for tag in _TAGS))
_TEMPLATE: list[bytes | float] = [part for tag in _TAGS for part in (tag, 0.0)]
SAMPLE_BYTES = _SAMPLE.size

_DTYPE = np.dtype(
    [
        item
        for tag, name in zip(_TAGS, Sample._fields, strict=True)
        for item in ((f"tag_{name}", f"V{len(tag)}"), (name, "<f8"))
    ]
)


def encode_sample(sample: Sample) -> bytes:
    """Pack one sample as protobuf."""
    parts = _TEMPLATE[:]
    parts[1::2] = sample
    return _SAMPLE.pack(*parts)


def decode_samples(messages: bytes) -> dict[str, NDArray[np.float64]]:
    """Unpack concatenated samples into one array per field, shape (n,)."""
    rows = np.frombuffer(messages, _DTYPE)
    return {name: np.ascontiguousarray(rows[name], dtype=np.float64) for name in Sample._fields}


_frame_structs: dict[int, struct.Struct] = {}


def encode_frames(frames: list[RawFrame], zero_ns: int = 0) -> bytes:
    """Pack the frames of a cycle; a frame must have at most 8 data bytes (classical CAN).

    Args:
        frames: The frames, with times of the host's clock, ns.
        zero_ns: Start of the recording by the same clock, ns; the packed times count from it.
    """
    count = len(frames)
    packer = _frame_structs.get(count)
    if packer is None:
        packer = _frame_structs[count] = struct.Struct("<" + _FRAME * count)
    fields: list[int | bytes] = list(chain.from_iterable(frames))
    fields[::4] = [frame.time_ns - zero_ns for frame in frames]
    return packer.pack(*fields)


def decode_frames(message: bytes) -> list[RawFrame]:
    """Unpack the frames of a cycle."""
    # Imported here, because the samples can be read without the drivers.
    from drivers.interfaces import RawFrame

    return [RawFrame(*fields) for fields in struct.iter_unpack("<" + _FRAME, message)]
