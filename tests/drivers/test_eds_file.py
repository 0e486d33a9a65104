"""EDS files as people have them: missing, damaged, of another device."""

import dataclasses
import os
import re
from pathlib import Path

import pytest

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.eds_file import addresses, read_eds
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia404Transmitter, Cia406Encoder
from drivers.clock import SimulatedClock
from drivers.epos.link import EposSerialLink
from drivers.errors import ConfigurationError
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS, TRANSMITTER_EDS
from drivers.units import EncoderScales

from .host import SCALES, drive_eds

TEXT = DRIVE_EDS.read_text()


def never() -> None:
    raise AssertionError("nothing is opened")


def can_link() -> CanopenLink:
    return CanopenLink(SimulatedClock(), never)  # type: ignore[arg-type]


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    return tmp_path / "own.eds"


@pytest.mark.parametrize(
    "content",
    [
        "",
        "no section",
        "[1000]\n",
        "[1000]\nParameterName=a\nDataType=x\n",
        "[1000sub1]\nParameterName=a\n",
        "\x00\xff",
    ],
    ids=["empty", "no header", "no name", "no type", "orphan", "binary"],
)
@pytest.mark.parametrize("link", ["can", "serial"])
def test_a_damaged_file_is_said_in_words(eds: Path, content: str, link: str) -> None:
    eds.write_text(content)
    made = can_link() if link == "can" else EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    with pytest.raises(
        ConfigurationError,
        match=r"EDS file .*own\.eds of node 5 .*; use the EDS file of this device",
    ) as e:
        made.add_node(5, eds)
    assert "\n" not in str(e.value)


def servo(eds: Path) -> Cia402Servo:
    link = can_link()
    return Cia402Servo(link.add_node(1, eds), link, SCALES)


SENSORS = {
    ENCODER_EDS: lambda node: Cia406Encoder(node, EncoderScales(1)),
    TRANSMITTER_EDS: lambda node: Cia404Transmitter(node, 1.0),
}


def test_the_files_of_the_simulated_devices_are_whole() -> None:
    assert list(servo(DRIVE_EDS).description_problems()) == []
    for eds, make in SENSORS.items():
        assert list(make(can_link().add_node(2, eds)).description_problems()) == []


@pytest.mark.parametrize("index", [0x6040, 0x6041, 0x6060, 0x6064, 0x607A, 0x1018, 0x1400])
def test_an_object_that_every_drive_needs_is_missed(tmp_path: Path, index: int) -> None:
    found = list(servo(drive_eds(tmp_path, (index,))).description_problems())
    assert found
    assert all(f"{index:04X}h" in str(error) for error in found)


@pytest.mark.parametrize(
    "index",
    [
        *(0x6072, 0x6073, 0x607D, 0x607F, 0x6065, 0x605A, 0x6085, 0x6079, 0x2101),
        *(0x2100, 0x606C, 0x6075, 0x6076, 0x6078, 0x1013, 0x60C2, 0x6007),
    ],
)
def test_an_object_that_a_drive_may_lack_is_told(tmp_path: Path, index: int) -> None:
    assert servo(DRIVE_EDS).lacks(0.001).words == ()
    lean = servo(drive_eds(tmp_path, (index,)))
    assert list(lean.description_problems()) == []
    shown = "motor voltage" if index == 0x2100 else f"{index:04X}h"
    assert any(shown in words for words in lean.lacks(0.001).words)


def test_objects_that_only_confirm_and_faults_in_those_not_used_do_no_harm(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path, (0x603F, 0x608F, 0x1009))
    text = eds.read_text()
    at = text.index("[1003]")
    eds.write_text(text[:at] + text[at:].replace("DataType", "Datatyp", 1))
    lean = servo(eds)
    assert list(lean.description_problems()) == []
    assert lean.lacks(0.001).words == ()
    assert read_eds(eds, 1).faults


def test_a_drive_without_current_and_torque_needs_one_named(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path, (0x6077, 0x6078))
    (error,) = servo(eds).description_problems()
    assert "servo.current_object" in str(error)
    link = can_link()
    named = dataclasses.replace(SCALES, current_object=(0x60F4, 0))
    assert list(Cia402Servo(link.add_node(1, eds), link, named).description_problems()) == []


@pytest.mark.parametrize(
    ("source", "index"),
    [
        (ENCODER_EDS, 0x6004),
        *((TRANSMITTER_EDS, index) for index in (0x6131, 0x6132, 0x9130, 0x6150)),
    ],
)
def test_an_object_that_a_sensor_needs_is_missed(tmp_path: Path, source: Path, index: int) -> None:
    node = can_link().add_node(2, drive_eds(tmp_path, (index,), source=source))
    (error,) = SENSORS[source](node).description_problems()
    assert f"object {index:04X}h" in str(error)


@pytest.mark.parametrize(("index", "needed"), [(0x1013, False), (0x6041, True)])
def test_a_serial_line_needs_no_process_data_and_no_time_stamp(tmp_path, index, needed):
    link = EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    node = link.add_node(1, drive_eds(tmp_path, (index,)))
    found = list(Cia402Servo(node, link, SCALES).description_problems())
    assert [f"object {index:04X}h" in str(error) for error in found] == [True] * needed


@pytest.mark.parametrize("encoding", ["cp850", "utf-16"])
def test_a_maker_s_encoding_does_no_harm_in_any_locale(tmp_path, encoding, monkeypatch):
    # As in a C locale: what is opened without an encoding of its own is ASCII.
    monkeypatch.setattr("locale.getpreferredencoding", lambda *_: "ascii")
    monkeypatch.setattr("locale.getencoding", lambda: "ascii")
    eds = tmp_path / "own.eds"
    eds.write_text(f"; Motor für 25 °C\n{TEXT}", encoding=encoding)
    assert 0x6041 in read_eds(eds, 1)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "own.eds")
    with pytest.raises(ConfigurationError, match="the path leads to a pipe or a device"):
        read_eds(tmp_path / "own.eds", 1)


HARMLESS = {
    "blank baud rate": TEXT.replace("BaudRate_800=0", "BaudRate_800="),
    "decimal vendor with zeros": TEXT.replace("VendorNumber=0x000007FF", "VendorNumber=001"),
    "comment lines counted wrongly": f"[Comments]\nLines=x\n{TEXT}",
    "section twice": f"{TEXT}\n[6041]\nParameterName=b\nDataType=0x0002\n",
    "no name": TEXT.replace("ParameterName=Statusword\n", ""),
    "line without a value": TEXT.replace("[6041]\n", "[6041]\nnonsense\n"),
}


@pytest.mark.parametrize("text", HARMLESS.values(), ids=HARMLESS)
def test_what_makers_write_beside_the_objects_does_no_harm(eds: Path, text: str) -> None:
    eds.write_bytes(text.encode())
    whole = read_eds(DRIVE_EDS, 1)
    read = read_eds(eds, 1)
    assert addresses(read) == addresses(whole)
    assert read[0x6041].data_type == whole[0x6041].data_type == 6
    assert read.faults == {}


def test_a_type_that_another_section_defines(eds: Path) -> None:
    eds.write_text("[2001]\nDataType=0xA0\n[A0]\n[A0sub1]\nDefaultValue=0x0006\n")
    assert read_eds(eds, 5)[0x2001].data_type == 6


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("DataType=0x0006", "", r"section \[6040\] has no DataType"),
        ("DataType=0x0006", "DataType=", "DataType of section .* is ''; it must be a number"),
        ("PDOMapping=1", "PDOMapping=yes", "PDOMapping of section .* is 'yes'; it must be a"),
    ],
)
def test_a_fault_is_told_with_file_and_line_where_its_object_is_needed(eds, line, instead, words):
    at = TEXT.index("[6040]")
    eds.write_text(TEXT[:at] + TEXT[at:].replace(line, instead, 1))
    number = 1 + eds.read_text()[: eds.read_text().index("[6040]")].count("\n")
    (error,) = (e for e in servo(eds).description_problems() if "cannot be used" in str(e))
    assert re.search(rf"6040h:00h cannot be used: {re.escape(str(eds))}:(\d+): {words}", str(error))
    shown = int(str(error).split(f"{eds}:")[1].split(":")[0])
    assert number <= shown <= number + 6


def test_members_of_an_object_that_is_a_single_value_are_told(eds: Path) -> None:
    eds.write_text("[2000]\nObjectType=7\nDataType=5\n[2000sub1]\nDataType=6\n")
    link = can_link()
    node = link.add_node(1, eds)
    assert not node.describes(0x2000, 1, mappable=True)
    with pytest.raises(ConfigurationError) as e:
        node.read(0x2000, 1)
    assert f"{eds}:4: section [2000sub1] is not used, since [2000] describes a single value" in str(
        e.value
    )
