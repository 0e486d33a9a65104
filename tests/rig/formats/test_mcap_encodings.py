"""MCAP with CDR and protobuf, written by mcap-ros2-support and mcap-protobuf-support."""

import struct
from pathlib import Path

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.struct_pb2 import Struct
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as RosWriter

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from tests.rig.formats.campaigns import ANGLE, CURRENT, N, load_file, same

PLAIN = ReadSection()
FIRST_NS = 1_700_000_000_000_000_000
STATE = """\
std_msgs/Header header
Motor[] motors
float32[2] pair
int64 big
builtin_interfaces/Duration span
string word
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: my_msgs/Motor
float64 current
float64 angle
bool on
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""
CHANNELS = (
    "{time: /state.header.stamp, current: '/state.motors[0].current', "
    "angle: '/state.motors[1].angle'}"
)


def stamp(ns: int) -> dict[str, int]:
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def write_ros(path: Path, closed: bool = True) -> None:
    with path.open("wb") as stream:
        writer = RosWriter(stream, chunk_size=4096)
        schema = writer.register_msgdef("my_msgs/State", STATE)
        temperature = writer.register_msgdef("my_msgs/T", "float64 value")
        for k in range(N):
            now = FIRST_NS + k * 1_000_001
            message = {
                "header": {"stamp": stamp(now), "frame_id": "arm"},
                "motors": [
                    {"current": CURRENT[k], "angle": 1.0, "on": True},
                    {"current": 0.0, "angle": ANGLE[k], "on": False},
                ],
                "pair": [1.5, 2.5],
                "big": 2**60 + k,
                "span": stamp(-500_000_000),
                "word": "x",
            }
            writer.write_message("/state", schema, message, now, now)
            if k % 10 == 0:
                writer.write_message("/temperature", temperature, {"value": 20.0 + k}, now, now)
        if closed:
            writer.finish()


def test_cdr_with_structs_in_lists(tmp_path: Path) -> None:
    write_ros(tmp_path / "log.mcap")
    recording = load_file(tmp_path, "log.mcap", CHANNELS)
    same(recording.time, np.arange(N) * 1_000_001 / 1e9)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    assert recording.notes == ()
    table = open_table(tmp_path / "log.mcap", PLAIN)
    by_name = {name: table.read([k])[0] for k, name in enumerate(table.names)}
    same(by_name["/state.pair[1]"], np.full(N, 2.5))
    same(by_name["/state.big"], np.arange(N))
    same(by_name["/state.span"], np.full(N, -0.5))
    same(by_name["/state.motors[0].on"], np.ones(N))
    assert "/state.word" not in by_name


def protobuf_state() -> type:
    """Return a message of nested and repeated messages, made by protobuf itself."""
    kinds = FieldDescriptorProto
    motor = DescriptorProto(name="Motor")
    for number, name in enumerate(("current", "angle"), 1):
        motor.field.add(name=name, number=number, type=kinds.TYPE_DOUBLE, label=1)
    state = DescriptorProto(name="State", nested_type=[motor])
    add = state.field.add
    add(name="stamp", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    add(name="motors", number=2, type=11, label=3, type_name=".my.State.Motor")
    add(name="count", number=3, type=kinds.TYPE_UINT64, label=1)
    add(name="span", number=4, type=11, label=1, type_name=".google.protobuf.Duration")
    add(name="word", number=5, type=kinds.TYPE_STRING, label=1)
    add(name="maybe", number=6, type=kinds.TYPE_FLOAT, label=1, oneof_index=0, proto3_optional=True)
    add(name="more", number=7, type=11, label=1, type_name=".google.protobuf.Struct")
    state.oneof_decl.add(name="_maybe")
    file = FileDescriptorProto(name="state.proto", package="my", syntax="proto3")
    file.message_type.append(state)
    pool = DescriptorPool()
    for kind in (Timestamp, Duration, Struct):
        own = FileDescriptorProto()
        kind.DESCRIPTOR.file.CopyToProto(own)
        pool.Add(own)
        file.dependency.append(own.name)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("my.State"))


def test_protobuf_with_repeated_messages(tmp_path: Path) -> None:
    kind = protobuf_state()
    with (tmp_path / "log.mcap").open("wb") as stream, ProtobufWriter(stream) as writer:
        for k in range(N):
            now = FIRST_NS + k * 1_000_001
            message = kind(count=0 if k == 0 else 2**50 + k, word="x")
            message.stamp.FromNanoseconds(now)
            message.span.FromNanoseconds(-500_000_000)
            message.motors.add(current=CURRENT[k])
            message.motors.add(angle=ANGLE[k])
            message.more.update({"current": CURRENT[k], "pair": [float(k), 2.0]})
            if k % 2:
                message.maybe = 1.5
            writer.write_message("/state", message, now, now)
    channels = CHANNELS.replace("header.stamp", "stamp")
    recording = load_file(tmp_path, "log.mcap", channels)
    same(recording.time, np.arange(N) * 1_000_001 / 1e9)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    table = open_table(tmp_path / "log.mcap", PLAIN)
    by_name = {name: table.read([k])[0] for k, name in enumerate(table.names)}
    same(by_name["/state.motors[1].current"], np.zeros(N))
    same(by_name["/state.span"], np.full(N, -0.5))
    same(by_name["/state.more.current"], CURRENT)
    same(by_name["/state.more.pair[0]"], np.arange(N))
    same(by_name["/state.count"], np.where(np.arange(N) > 0, 2.0**50 + np.arange(N), 0.0))
    same(by_name["/state.maybe"], np.where(np.arange(N) % 2, 1.5, np.nan))


def test_a_topic_that_cannot_be_decoded_is_left_out(tmp_path: Path) -> None:
    """Topics that lack a definition, have one that ROS refuses, or break off."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()

        def channel(topic: str, definition: str, encoding: str = "cdr") -> int:
            kind = "ros2msg" if encoding == "cdr" else "jsonschema"
            name = "state" if topic == "/misnamed" else "State"
            schema = writer.register_schema(f"my_msgs/msg/{name}", kind, definition.encode())
            return writer.register_channel(topic, encoding, schema)

        lacking = channel("/lacking", "std_msgs/Header header\nfloat64 value\n")
        misnamed = channel("/misnamed", "float64 value\n")
        good = channel("/good", "float64 value\n")
        broken = channel("/broken", "{}", "json")
        bare = writer.register_channel("/bare", "cdr", 0)
        for k in range(3):
            now = FIRST_NS + k * 10**7
            cdr = b"\0\1\0\0" + struct.pack("<d", k)
            text = b'{"x": 1}' if k < 2 else b'{"x": '
            rows = ((lacking, cdr), (misnamed, cdr), (good, cdr), (broken, text), (bare, cdr))
            for number, data in rows:
                writer.add_message(number, now, data, now)
        writer.finish()
    table = open_table(path, PLAIN)
    assert table.names == ("/good.value", "/good.log_time")
    same(table.read([0])[0], np.arange(3.0))
    (note,) = table.notes
    assert all(f"{topic} (" in note for topic in ("/lacking", "/misnamed", "/broken", "/bare"))
    assert "mcap recover" not in note
    with pytest.raises(InputError, match=r"no such column .*/lacking \("):
        load_file(tmp_path, "log.mcap", "{time: log_time, angle: /lacking.value, current: value}")
