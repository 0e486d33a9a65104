"""Encodes the messages of a recording as ROS 2 messages, for tools that read only ROS 2.

Foxglove and PlotJuggler decode the messages by the message definition of each channel. The encoding
is CDR, little endian (OMG DDSI-RTPS 2.5, 10.2): four bytes that identify the encoding, then the
fields, each at a multiple of its size.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from drivers.interfaces import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    IDENTIFIER_BITS,
    REMOTE_FLAG,
    SERIAL_FLAG,
    RawFrame,
)
from rig.common.sample import Sample
from rig.runs.mcap.layout import decode_samples

ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"
SAMPLE_TYPE = "loadrig/msg/Sample"
FRAME_TYPE = "can_msgs/msg/Frame"
SERIAL_TYPE = "loadrig/msg/SerialBytes"
_RULE = "=" * 80
_HEADER = f"""{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
SAMPLE_TEXT = "".join(f"float64 {name}\n" for name in Sample._fields)
"""Definition of a sample: every field is a double, in the order of the recording."""
FRAME_TEXT = f"""std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
{_HEADER}"""
"""A CAN frame (ros_canopen's can_msgs/Frame); ``frame_id`` is sent or received."""
SERIAL_TEXT = f"""std_msgs/Header header
uint32 line
uint8[] data
{_HEADER}"""
"""Definition of up to eight bytes of a serial line."""
CAN_TOPIC = "/can"
SERIAL_TOPIC = "/serial"
SENT, RECEIVED = "sent", "received"

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_NS = 1_000_000_000


def is_serial(frame: RawFrame) -> bool:
    """Return whether a raw frame contains bytes of a serial line instead of a CAN frame."""
    flags = EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG | SERIAL_FLAG
    return frame.identifier & flags == SERIAL_FLAG


def samples(messages: Sequence[bytes]) -> list[bytes]:
    """Return recorded samples as CDR."""
    fields = decode_samples(b"".join(messages))
    rows = np.stack([fields[name] for name in Sample._fields], axis=1).astype("<f8")
    return [LITTLE_ENDIAN + row.tobytes() for row in rows]


def can_frame(frame: RawFrame) -> bytes:
    """Return a CAN frame as CDR; the frame must have at most 8 data bytes (classical CAN)."""
    flags = frame.identifier
    return _header(frame) + struct.pack(
        "<I???B8s",
        flags & IDENTIFIER_BITS,
        bool(flags & REMOTE_FLAG),
        bool(flags & EXTENDED_FLAG),
        bool(flags & ERROR_FLAG),
        len(frame.data),
        frame.data,
    )


def serial_bytes(frame: RawFrame) -> bytes:
    """Return bytes of a serial line as CDR."""
    size = len(frame.data)
    line = frame.identifier & ~SERIAL_FLAG
    return _header(frame) + struct.pack(f"<II{size}s", line, size, frame.data)


def _header(frame: RawFrame) -> bytes:
    """Return encapsulation header and std_msgs/Header, padded to a multiple of four bytes."""
    word = (SENT if frame.sent else RECEIVED).encode() + b"\x00"
    seconds, nanoseconds = divmod(frame.time_ns, _NS)
    padding = -len(word) % 4
    return LITTLE_ENDIAN + struct.pack(
        f"<iII{len(word)}s{padding}x", seconds, nanoseconds, len(word), word
    )
