"""EDS files as people have them: missing, damaged, of another device."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.cia404 import Cia404Transmitter
from drivers.canopen.cia406 import Cia406Encoder
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink
from drivers.clock import SimulatedClock
from drivers.epos.link import EposSerialLink
from drivers.errors import ConfigurationError
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS
from drivers.mock.transmitter import TRANSMITTER_EDS
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
        ConfigurationError, match=r"EDS file .*own\.eds of node 5 .*; use the device's own EDS file"
    ) as e:
        made.add_node(5, eds)
    assert "\n" not in str(e.value)


@given(st.integers(0, len(TEXT)), st.integers(0, 40), st.text(max_size=20))
def test_a_file_damaged_anywhere_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, at: int, length: int, instead: str
) -> None:
    eds = tmp_path_factory.getbasetemp() / "damaged.eds"
    eds.write_text(TEXT[:at] + instead + TEXT[at + length :], encoding="utf-8", errors="replace")
    with suppress(ConfigurationError):
        assert len(read_eds(eds, 1)) > 0


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
    assert list(servo(DRIVE_EDS).description_refusals()) == []
    assert (
        list(Cia406Encoder(link.add_node(2, ENCODER_EDS), EncoderScales(1)).description_refusals())
        == []
    )
    assert (
        list(Cia404Transmitter(link.add_node(3, TRANSMITTER_EDS), 1.0).description_refusals()) == []
    )


@pytest.mark.parametrize("index", ["6072", "6041", "60C2", "1013", "2100", "6075", "1018", "605A"])
def test_an_object_that_a_drive_needs_is_missed(tmp_path: Path, index: str) -> None:
    found = list(servo(without(tmp_path, DRIVE_EDS, index)).description_refusals())
    assert found
    assert all(f"object {index}h" in str(error) for error in found)


@pytest.mark.parametrize("index", ["6001", "6004", "6503", "1013"])
def test_an_object_that_an_encoder_needs_is_missed(tmp_path: Path, index: str) -> None:
    node = can_link().add_node(2, without(tmp_path, ENCODER_EDS, index))
    (error,) = Cia406Encoder(node, EncoderScales(1)).description_refusals()
    assert f"object {index}h" in str(error)


@pytest.mark.parametrize("index", ["6131", "6132", "9130", "6150"])
def test_an_object_that_a_transmitter_needs_is_missed(tmp_path: Path, index: str) -> None:
    node = can_link().add_node(2, without(tmp_path, TRANSMITTER_EDS, index))
    (error,) = Cia404Transmitter(node, 1.0).description_refusals()
    assert f"object {index}h" in str(error)


def test_a_serial_line_needs_no_process_data_and_no_time_stamp(tmp_path: Path) -> None:
    link = EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    node = link.add_node(1, without(tmp_path, DRIVE_EDS, "1013"))
    assert list(Cia402Servo(node, link, SCALES).description_refusals()) == []
    missing = EposSerialLink(SimulatedClock(), never)  # type: ignore[arg-type]
    node = missing.add_node(1, without(tmp_path, DRIVE_EDS, "6079"))
    (error,) = Cia402Servo(node, missing, SCALES).description_refusals()
    assert "object 6079h" in str(error)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
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
    with pytest.raises(ConfigurationError, match="it is a pipe or a device"):
        read_eds(tmp_path / "own.eds", 1)
