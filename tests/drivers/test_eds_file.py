"""EDS files as people have them: missing, damaged, of another device."""

from __future__ import annotations

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

from .host import SCALES

TEXT = DRIVE_EDS.read_text()


def never() -> None:
    raise AssertionError("nothing is opened")


def can_link() -> CanopenLink:
    return CanopenLink(SimulatedClock(), never)  # type: ignore[arg-type]


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
def test_a_damaged_file_is_said_in_words(tmp_path: Path, content: str, link: str) -> None:
    eds = tmp_path / "own.eds"
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


def without(tmp_path: Path, source: Path, index: str) -> Path:
    """Return a copy of an EDS without one object and its members."""
    kept, keep = [], True
    for line in source.read_text().splitlines():
        if line.startswith("["):
            keep = not line.upper().startswith((f"[{index}]", f"[{index}SUB"))
        if keep:
            kept.append(line)
    path = tmp_path / "without.eds"
    path.write_text("\n".join(kept))
    return path


def test_the_files_of_the_simulated_devices_are_whole() -> None:
    link = can_link()
    assert list(servo(DRIVE_EDS).description_problems()) == []
    assert (
        list(Cia406Encoder(link.add_node(2, ENCODER_EDS), EncoderScales(1)).description_problems())
        == []
    )
    assert (
        list(Cia404Transmitter(link.add_node(3, TRANSMITTER_EDS), 1.0).description_problems()) == []
    )


@pytest.mark.parametrize("index", ["6040", "6041", "6060", "6061", "6064", "607A", "1018", "1400"])
def test_an_object_that_every_drive_needs_is_missed(tmp_path: Path, index: str) -> None:
    found = list(servo(without(tmp_path, DRIVE_EDS, index)).description_problems())
    assert found
    assert all(f"{index}h" in str(error) for error in found)
    assert index in ("1018", "1400") or "every run needs this object" in str(found[0])


OPTIONAL = {
    "6072": "no such limit in the drive: joint torque (6072h)",
    "6073": "no such limit in the drive: motor current (6073h)",
    "607D": "no such limit in the drive: lower end of the joint angle (607Dh:01h)",
    "607F": "no such limit in the drive: joint speed (607Fh)",
    "6065": "no such limit in the drive: following error (6065h)",
    "605A": "no such limit in the drive: quick stop option (605Ah)",
    "6085": "no such limit in the drive: quick stop deceleration (6085h)",
    "6079": "not monitored: supply voltage (6079h)",
    "2101": "not monitored: temperature (2101h)",
    "2100": "not recorded: motor voltage",
    "606C": "no motor speed (606Ch)",
    "6075": "not checked: rated current (6075h)",
    "6076": "not checked: rated torque (6076h)",
    "6078": "no motor current (6078h): the current is computed from the torque (6077h)",
    "1013": "no time stamp (1013h)",
    "60C2": "no interpolation period (60C2h): set the period to 1 ms",
    "6007": "no object for the reaction to a lost master (6007h)",
}


@pytest.mark.parametrize("index", OPTIONAL)
def test_an_object_that_a_drive_may_lack_is_told(tmp_path: Path, index: str) -> None:
    assert servo(DRIVE_EDS).lacks(0.001).words == ()
    lean = servo(without(tmp_path, DRIVE_EDS, index))
    assert list(lean.description_problems()) == []
    assert any(words.startswith(OPTIONAL[index]) for words in lean.lacks(0.001).words)


@pytest.mark.parametrize("index", ["603F", "608F", "1009", "1003"])
def test_an_object_that_only_confirms_may_be_absent(tmp_path: Path, index: str) -> None:
    lean = servo(without(tmp_path, DRIVE_EDS, index))
    assert list(lean.description_problems()) == []
    assert lean.lacks(0.001).words == ()


def test_a_drive_without_current_and_torque_needs_one_named(tmp_path: Path) -> None:
    eds = without(tmp_path, without(tmp_path, DRIVE_EDS, "6077"), "6078")
    (error,) = servo(eds).description_problems()
    assert "neither the current 6078h nor the torque 6077h" in str(error)
    assert "servo.current_object" in str(error)
    link = can_link()
    named = dataclasses.replace(SCALES, current_object=(0x60F4, 0))
    assert list(Cia402Servo(link.add_node(1, eds), link, named).description_problems()) == []


def test_an_encoder_needs_its_position(tmp_path: Path) -> None:
    node = can_link().add_node(2, without(tmp_path, ENCODER_EDS, "6004"))
    (error,) = Cia406Encoder(node, EncoderScales(1)).description_problems()
    assert "object 6004h" in str(error)


@pytest.mark.parametrize("index", ["6001", "6002", "6503", "1013"])
def test_what_an_encoder_of_class_1_lacks_is_not_needed(tmp_path: Path, index: str) -> None:
    node = can_link().add_node(2, without(tmp_path, ENCODER_EDS, index))
    assert list(Cia406Encoder(node, EncoderScales(1)).description_problems()) == []


@pytest.mark.parametrize("index", ["6131", "6132", "9130", "6150"])
def test_an_object_that_a_transmitter_needs_is_missed(tmp_path: Path, index: str) -> None:
    node = can_link().add_node(2, without(tmp_path, TRANSMITTER_EDS, index))
    (error,) = Cia404Transmitter(node, 1.0).description_problems()
    assert f"object {index}h" in str(error)


def test_a_serial_line_needs_no_process_data_and_no_time_stamp(tmp_path: Path) -> None:
    link = EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    node = link.add_node(1, without(tmp_path, DRIVE_EDS, "1013"))
    assert list(Cia402Servo(node, link, SCALES).description_problems()) == []
    missing = EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    node = missing.add_node(1, without(tmp_path, DRIVE_EDS, "6041"))
    (error,) = Cia402Servo(node, missing, SCALES).description_problems()
    assert "object 6041h" in str(error)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "cp850", "utf-16"])
def test_a_maker_s_encoding_does_no_harm_in_any_locale(
    tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    "text before the first section": f"Made by a tool\n{TEXT}",
    "key twice": TEXT.replace("[6041]\n", "[6041]\nParameterName=a\n"),
    "section twice": f"{TEXT}\n[6041]\nParameterName=b\nDataType=0x0002\n",
    "no name": TEXT.replace("ParameterName=Statusword\n", ""),
    "names in capitals": TEXT.replace("DataType", "DATATYPE").replace("[6041]", "[6041 ]"),
    "Windows lines": TEXT.replace("\n", "\r\n"),
    "line without a value": TEXT.replace("[6041]\n", "[6041]\nnonsense\n"),
}


@pytest.mark.parametrize("text", HARMLESS.values(), ids=HARMLESS)
def test_what_makers_write_beside_the_objects_does_no_harm(tmp_path: Path, text: str) -> None:
    eds = tmp_path / "own.eds"
    eds.write_bytes(text.encode())
    whole = read_eds(DRIVE_EDS, 1)
    read = read_eds(eds, 1)
    assert addresses(read) == addresses(whole)
    assert read[0x6041].data_type == whole[0x6041].data_type == 6
    assert read.faults == {}


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("DataType=0x0006", "", r"section \[6040\] has no DataType"),
        ("DataType=0x0006", "DataType=", "DataType of section .* is ''; it must be a number"),
        ("DataType=0x0006", "DataType=word", "DataType of section .* is 'word'; it must be a"),
        ("PDOMapping=1", "PDOMapping=yes", "PDOMapping of section .* is 'yes'; it must be a"),
    ],
)
def test_a_fault_is_told_with_file_and_line_where_its_object_is_needed(
    tmp_path: Path, line: str, instead: str, words: str
) -> None:
    eds = tmp_path / "own.eds"
    at = TEXT.index("[6040]")
    eds.write_text(TEXT[:at] + TEXT[at:].replace(line, instead, 1))
    number = 1 + eds.read_text()[: eds.read_text().index("[6040]")].count("\n")
    (error,) = (e for e in servo(eds).description_problems() if "cannot be used" in str(e))
    assert re.search(rf"6040h:00h cannot be used: {re.escape(str(eds))}:(\d+): {words}", str(error))
    shown = int(str(error).split(f"{eds}:")[1].split(":")[0])
    assert number <= shown <= number + 6


def test_a_fault_in_an_object_that_is_not_used_does_no_harm(tmp_path: Path) -> None:
    eds = tmp_path / "own.eds"
    at = TEXT.index("[1003]")
    eds.write_text(TEXT[:at] + TEXT[at:].replace("DataType", "Datatyp", 1))
    assert list(servo(eds).description_problems()) == []
    assert read_eds(eds, 1).faults


def test_members_that_one_section_describes(tmp_path: Path) -> None:
    eds = tmp_path / "own.eds"
    eds.write_text(
        "[2000]\nParameterName=a\nObjectType=0x8\nDataType=0x0003\nCompactSubObj=3\n"
        "[2001]\nDataType=0xA0\n[A0]\n[A0sub1]\nDefaultValue=0x0006\n"
        "[2002]\nDataType=7\nLowLimit=0xFFFFFFFF\nDefaultValue=$NODEID+0x180\n"
        "[2003]\nDataType=2\nLowLimit=0xFF\nHighLimit=0x7F\n"
        "[2004]\nDataType=7\nDefaultValue=$NodeID + 0x280\n"
    )
    read = read_eds(eds, 5)
    assert addresses(read) >= {(0x2000, 0), (0x2000, 1), (0x2000, 3)}
    assert read[0x2000][3].data_type == 3
    assert read[0x2001].data_type == 6
    assert (read[0x2002].default, read[0x2002].min) == (0x185, 0xFFFFFFFF)
    assert read[0x2004].default == 0x285
    assert (read[0x2003].min, read[0x2003].max) == (-1, 127)


def test_members_of_an_object_that_is_a_single_value_are_told(tmp_path: Path) -> None:
    eds = tmp_path / "own.eds"
    eds.write_text("[2000]\nObjectType=7\nDataType=5\n[2000sub1]\nDataType=6\n")
    link = can_link()
    node = link.add_node(1, eds)
    assert not node.describes(0x2000, 1, mappable=True)
    with pytest.raises(ConfigurationError) as e:
        node.read(0x2000, 1)
    assert f"{eds}:4: section [2000sub1] is not used, since [2000] describes a single value" in str(
        e.value
    )
