"""CAN traffic written by python-can, its signals encoded by cantools: back to the last bit."""

import gzip
from collections.abc import Iterable
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from asammdf import MDF, Signal

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources import served
from rig.sources.can_traffic import CanTable
from rig.sources.formats import open_table
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file, same

DBC = """\
VERSION ""
BU_: Drive
BO_ 291 Motion: 8 Drive
 SG_ Position : 0|32@1- (1,0) [0|0] "rad" Host
 SG_ Current : 39|16@0- (0.001,0) [-30|30] "A" Host
 SG_ Turns : 48|12@1+ (0.5,-100) [0|0] "" Host
BO_ 2566848514 Wide: 8 Drive
 SG_ Mode M : 0|2@1+ (1,0) [0|0] "" Host
 SG_ Volts m0 : 8|16@1+ (0.01,0) [0|0] "V" Host
 SG_ Kind m1M : 8|4@1+ (1,0) [0|0] "" Host
 SG_ Heat m3 : 16|16@1- (0.1,0) [0|0] "degC" Host
BO_ 100 Real: 8 Drive
 SG_ Speed : 0|32@1- (1,0) [0|0] "rad/s" Host
 SG_ Load : 39|32@0- (1,0) [0|0] "Nm" Host
SIG_VALTYPE_ 291 Position : 1;
SIG_VALTYPE_ 100 Speed : 1;
SIG_VALTYPE_ 100 Load : 1;
SG_MUL_VAL_ 2566848514 Volts Mode 0-0;
SG_MUL_VAL_ 2566848514 Kind Mode 1-1;
SG_MUL_VAL_ 2566848514 Heat Kind 3-3;
VAL_ 291 Turns 5 "five" ;
"""
DATABASE = cantools.database.load_string(DBC, "dbc")
WRITERS = {
    "log": can.CanutilsLogWriter,
    "asc": can.ASCWriter,
    "blf": can.BLFWriter,
    "trc": can.TRCWriter,
}
CHANNELS = "{time: Motion.time, current: Current, angle: Position}"
READ = "{dbc: bus.dbc}"
START = 1_700_000_000.0
STAMPS = START + TIME


def frame(name: str, stamp: float, values: dict[str, float], **more: object) -> can.Message:
    message = DATABASE.get_message_by_name(name)
    return can.Message(
        timestamp=stamp,
        arbitration_id=message.frame_id,
        is_extended_id=message.is_extended_frame,
        data=message.encode(values, strict=False),
        channel=more.pop("channel", 0),
        **more,  # type: ignore[arg-type]
    )


def motion(k: int, **more: object) -> can.Message:
    # The current is rounded to its step in the frame.
    values = {"Position": ANGLE[k], "Current": round(CURRENT[k], 3), "Turns": 0.5 * k - 100}
    return frame("Motion", STAMPS[k], values, **more)


def write(path: Path, messages: Iterable[can.Message], dbc: str = DBC) -> Path:
    (path.parent / "bus.dbc").write_text(dbc)
    with WRITERS[path.suffix[1:]](str(path)) as writer:  # type: ignore[abstract]
        for message in messages:
            writer.on_message_received(message)
    return path


def table(path: Path, **options: object) -> CanTable:
    options.setdefault("dbc", (str(path.parent / "bus.dbc"),))
    return CanTable(path, ReadSection(**options))  # type: ignore[arg-type]


def columns(path: Path, **options: object) -> dict[str, np.ndarray]:
    found = table(path, **options)
    return {name: found.read([k])[0] for k, name in enumerate(found.names)}


@pytest.mark.parametrize("kind", ["log", "asc", "blf", "trc"])
def test_every_format_to_the_last_bit(tmp_path: Path, kind: str) -> None:
    write(tmp_path / f"log.{kind}", map(motion, range(N)))
    recording = load_file(tmp_path, f"log.{kind}", CHANNELS, READ)
    np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-6 if kind == "log" else 2e-6)
    found = columns(tmp_path / f"log.{kind}")
    truth = [DATABASE.decode_message("Motion", motion(k).data, False) for k in range(N)]
    for name in ("Position", "Current", "Turns"):
        same(found[f"Motion.{name}"], np.array([row[name] for row in truth], float))
    same(recording.channels["angle"], ANGLE.astype(np.float32).astype(float))
    same(recording.channels["current"], found["Motion.Current"])


def test_stamps_since_1970_keep_their_microseconds(tmp_path: Path) -> None:
    lines = [
        f"({1_700_000_000 + k // 1000}.{k % 1000:03}123) can0 123#{'00' * 8}" for k in range(N)
    ]
    (tmp_path / "log.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "bus.dbc").write_text(DBC)
    stamps = columns(tmp_path / "log.log")["Motion.time"]
    np.testing.assert_allclose(stamps, TIME, rtol=0, atol=1e-15)


def test_error_remote_and_unknown_frames_are_counted(tmp_path: Path) -> None:
    messages = [*map(motion, range(N))]
    messages[100:100] = [
        can.Message(timestamp=STAMPS[99], is_error_frame=True, channel=0),
        can.Message(
            timestamp=STAMPS[99],
            arbitration_id=0x123,
            is_extended_id=False,
            is_remote_frame=True,
            dlc=8,
            channel=0,
        ),
        can.Message(timestamp=STAMPS[99], arbitration_id=0x7, is_extended_id=False, channel=0),
    ]
    for kind in ("log", "asc", "blf"):
        found = table(write(tmp_path / f"log.{kind}", messages))
        assert len(found.read([0])[0]) == N, kind
        assert "1 error frames left out" in found.notes, kind
        assert "1 remote frames left out" in found.notes, kind
        assert any("1 frames of unknown messages left out" in n for n in found.notes), kind


def test_several_buses_in_one_file(tmp_path: Path) -> None:
    messages = []
    for k in range(N):
        messages += [motion(k, channel=0), motion(N - 1 - k, channel=1)]
        messages[-1].timestamp = STAMPS[k]
    path = write(tmp_path / "log.blf", messages)
    found = columns(path)
    same(found["1.Motion.Position"], found["2.Motion.Position"][::-1])
    single = columns(path, bus=2)
    same(single["Motion.Position"], found["2.Motion.Position"])
    with pytest.raises(InputError, match=r"the file has no bus 3; set read\.bus to one of 1, 2"):
        table(path, bus=3)


def test_values_beyond_the_range_of_the_dbc_are_doubted(tmp_path: Path) -> None:
    values = [{"Position": 0.0, "Current": 32.767, "Turns": 0.0}] * 2
    messages = [*map(motion, range(N)), *(frame("Motion", START + 1, v) for v in values)]
    found = table(write(tmp_path / "log.blf", messages))
    found.read([found.names.index("Motion.Current")])
    assert any("2 of 302 values are outside of -30 to 30" in note for note in found.notes)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (' SG_ Extra : 50|12@1+ (1,0) [0|0] "" Host\n', "are overlapping in message Motion"),
        (' SG_ Extra : 60|12@1+ (1,0) [0|0] "" Host\n', "Extra does not fit in message Motion"),
    ],
)
def test_a_dbc_with_wrong_bits_is_read_with_a_word(tmp_path: Path, bad: str, words: str) -> None:
    path = write(tmp_path / "log.blf", map(motion, range(N)))
    right = columns(path)
    (tmp_path / "bus.dbc").write_text(DBC.replace("BO_ 2566848514", f"{bad}BO_ 2566848514"))
    found = columns(path)
    for name, values in right.items():
        np.testing.assert_array_equal(found[name], values)
    notes = load_file(tmp_path, "log.blf", CHANNELS, READ).notes
    assert [words in note for note in notes].count(True) == 1
    # A message of which no frame is in the file is of no interest.
    (tmp_path / "bus.dbc").write_text(DBC.replace("SIG_VALTYPE_ 291", f"{bad}SIG_VALTYPE_ 291", 1))
    notes = load_file(tmp_path, "log.blf", CHANNELS, READ).notes
    assert not any("Extra" in note for note in notes)


def test_j1939_messages_of_other_sources(tmp_path: Path) -> None:
    dbc = DBC + 'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved",'
    dbc += (
        '"J1939PG";\nBA_DEF_DEF_ "VFrameFormat" "J1939PG";\nBA_ "VFrameFormat" BO_ 2566848514 3;\n'
    )
    sent = [
        can.Message(timestamp=START + k, arbitration_id=0x18FF0005, data=bytes([0, k, 0]))
        for k in range(5)
    ]
    dbc = dbc.replace("2566848514", str(0x98FF00FE))
    found = table(write(tmp_path / "log.blf", sent, dbc))
    same(found.read([found.names.index("Wide.Volts")])[0], np.arange(5) * 0.01)
    assert "Wide: matched by its J1939 parameter group, source address 05h" in found.notes


def test_bus_logging_inside_mf4(tmp_path: Path) -> None:
    names = ("BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes")
    kind = np.dtype(
        [(f"CAN_DataFrame.{n}", "u4" if n == "ID" else "u1") for n in names[:-1]]
        + [("CAN_DataFrame.DataBytes", "(8,)u1")]
    )
    rows = np.zeros(N, kind)
    for k in range(N):
        data = tuple(motion(k).data)
        rows[k] = (1, 0x123, 0, 8, 8, data)
    from asammdf.blocks import v4_constants
    from asammdf.blocks.source_utils import Source

    source = Source("CAN", "CAN", "", v4_constants.SOURCE_BUS, v4_constants.BUS_TYPE_CAN)
    with MDF(version="4.10") as mdf:
        mdf.append([Signal(rows, TIME, name="CAN_DataFrame", source=source)])
        group = mdf.groups[-1].channel_group
        group.flags |= v4_constants.FLAG_CG_BUS_EVENT
        mdf.save(tmp_path / "log.mf4", overwrite=True)
    (tmp_path / "bus.dbc").write_text(DBC)
    served.READER.close()
    assert open_table(tmp_path / "log.mf4", ReadSection()).names
    recording = load_file(tmp_path, "log.mf4", CHANNELS, READ)
    same(recording.time, TIME)
    same(recording.channels["angle"], ANGLE.astype(np.float32).astype(float))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.log", "t,i\n1,2\n", r"a\.log:1: not a frame of candump -L .*name it \.csv"),
        ("a.log", "  can0  123   [2]  11 22\n", "output for the screen; record with candump -L"),
        ("a.log", "(1.0) can0 20000004#0000000000000000\n", "no data frames; 1 error frames"),
        ("a.trc", ";$FILEVERSION=1.2\n", "versions that can be read are 1.0, 1.1"),
        ("a.blf", "LOGG" + "x" * 200, "no data frames; the file is cut off"),
    ],
)
def test_what_is_no_traffic_is_refused(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / "bus.dbc").write_text(DBC)
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        table(tmp_path / name)


def test_an_asc_file_without_its_usual_head_loses_no_frame(tmp_path: Path) -> None:
    body = "".join(
        f"   {0.001:.6f} 1  123             Rx   d 8 00 00 00 00 00 00 {k:02x} 00\n"
        for k in range(100)
    )
    head = "date Mon Jan 1 00:00:00 2024\nbase hex  timestamps relative\n"
    (tmp_path / "a.asc").write_text(head + body + "   0.001 1  123             Rx   d 8 00 0")
    (tmp_path / "bus.dbc").write_text(DBC)
    found = table(tmp_path / "a.asc")
    np.testing.assert_allclose(found.read([0])[0], np.arange(100) * 1e-3, atol=1e-9)
    same(found.read([found.names.index("Motion.Turns")])[0], np.arange(100) * 0.5 - 100)
    words = "the time stamps count from the previous event: summed to times since the start"
    assert words in found.notes
    assert "line 103 has no line end and may be cut off: line dropped" in found.notes


def test_a_blf_file_that_was_cut_off_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "log.blf", map(motion, range(N)))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    found = table(path)
    rows = len(found.read([0])[0])
    assert 0 < rows < N
    same(found.read([1])[0], ANGLE.astype(np.float32).astype(float)[:rows])
    assert any("the file is cut off" in note for note in found.notes)


def test_a_map_is_asked_for_by_name(tmp_path: Path) -> None:
    path = write(tmp_path / "log.log", map(motion, range(N)))
    with pytest.raises(InputError, match=r"CAN traffic, identifiers 123h; .*read\.dbc, or --dbc"):
        CanTable(path, ReadSection())
    # The identifier without its 29 bits is another message.
    other = can.Message(arbitration_id=0x123, is_extended_id=True, data=bytes(8), timestamp=0.0)
    with pytest.raises(InputError, match="none of the 3 messages of the map is in the file"):
        table(write(tmp_path / "other.blf", [other] * 3))
    (tmp_path / "log.log.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert len(columns(tmp_path / "log.log.gz")["Motion.time"]) == N
    (tmp_path / "bus.dbc").write_text(DBC.replace("BO_ 100", "BO_ 291"))
    with pytest.raises(InputError, match="both have the identifier 123h"):
        table(path)
