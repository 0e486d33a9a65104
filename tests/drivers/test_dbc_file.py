from __future__ import annotations

from pathlib import Path

import pytest

from drivers.dbc.file import read_dbc
from drivers.errors import ConfigurationError
from drivers.mock.dbc_drive import DRIVE_DBC


def test_periods_and_labels_come_from_the_file() -> None:
    layouts = read_dbc(DRIVE_DBC)
    assert layouts["DRV_Status"].period_s == 0.1
    assert layouts["DRV_Motion"].period_s is None
    assert layouts["DRV_Motion"].signals["State"].labels[2] == "RUN"
    assert not any(layout.obstacle for layout in layouts.values())


def test_a_syntax_error_names_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_text(DRIVE_DBC.read_text().replace("SG_ Code :", "SG_ Code"))
    with pytest.raises(ConfigurationError, match=r"bad\.dbc:10:11: Invalid syntax"):
        read_dbc(path)


@pytest.mark.parametrize(
    ("good", "bad", "words"),
    [
        ("Life : 4|4@1+", "Life : 3|4@1+", "overlapping in message DRV_Command"),
        ("Life : 4|4@1+", "Life : 62|4@1+", "does not fit in message DRV_Command"),
    ],
)
def test_a_message_whose_bits_are_wrong_is_not_used_and_others_are(
    tmp_path: Path, good: str, bad: str, words: str
) -> None:
    path = tmp_path / "bad.dbc"
    text = DRIVE_DBC.read_text()
    assert good in text
    path.write_text(text.replace(good, bad))
    layouts, right = read_dbc(path), read_dbc(DRIVE_DBC)
    assert words in layouts["DRV_Command"].obstacle
    assert {name: one for name, one in layouts.items() if name != "DRV_Command"} == {
        name: one for name, one in right.items() if name != "DRV_Command"
    }


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"none\.dbc: the file cannot be read: No such file"
    ):
        read_dbc(tmp_path / "none.dbc")


def test_bytes_that_are_no_text_are_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_bytes(b"VERSION \0")
    with pytest.raises(ConfigurationError, match=r"bad\.dbc: is not a text file: byte 8 is zero"):
        read_dbc(path)


@pytest.mark.parametrize(
    ("comment", "encoding"),
    [
        ("Größe", "utf-8"),
        ("Größe", "cp1252"),
        ("电流", "utf-8"),
        ("电流", "utf-8-sig"),
        ("电流", "utf-16"),
        ("\u30e2\u30fc\u30bf\u96fb\u6d41", "shift-jis"),
        # The second byte of each is a backslash, before the quote that ends the comment.
        ("\u8868", "shift-jis"),
        ("\u4fd3", "gb18030"),
        ("\u529f", "big5"),
    ],
)
def test_comments_are_read_in_any_encoding(tmp_path: Path, comment: str, encoding: str) -> None:
    path = tmp_path / "x.dbc"
    text = DRIVE_DBC.read_text().replace("Mean since the last command.", comment)
    path.write_bytes(text.encode(encoding))
    assert read_dbc(path) == read_dbc(DRIVE_DBC)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_labels_outside_ascii_are_those_of_the_file(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "x.dbc"
    text = DRIVE_DBC.read_text().replace('2 "RUN" 3 "STOPPING"', '2 "L\u00c4UFT" 3 "STOPPING"')
    path.write_bytes(text.encode(encoding))
    assert read_dbc(path)["DRV_Motion"].signals["State"].labels[2] == "L\u00c4UFT"


def test_bytes_of_no_encoding_end_no_reading(tmp_path: Path) -> None:
    path = tmp_path / "x.dbc"
    text = DRIVE_DBC.read_bytes().replace(b"Mean since", b"\x81\x8d\xff\xfe")
    path.write_bytes(text)
    assert read_dbc(path) == read_dbc(DRIVE_DBC)


def test_a_message_that_is_defined_twice_is_not_used(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.dbc"
    text = DRIVE_DBC.read_text()
    path.write_text(text.replace("BO_ 288 DRV", "BO_ 16 DRV_Stop: 2 HOST\n\nBO_ 288 DRV"))
    layouts = read_dbc(path)
    assert "is defined twice" in layouts["DRV_Stop"].obstacle
    assert not layouts["DRV_Limits"].obstacle
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("period", ["-5", '"soon"', "0"])
def test_a_cycle_time_that_is_none_counts_as_none(tmp_path: Path, period: str) -> None:
    path = tmp_path / "x.dbc"
    text = DRIVE_DBC.read_text().replace("INT 0 65535", "STRING")
    path.write_text(text.replace("BO_ 416 100;", f"BO_ 416 {period};"))
    assert read_dbc(path)["DRV_Status"].period_s is None


def test_a_long_identifier_has_its_flag(tmp_path: Path) -> None:
    path = tmp_path / "x.dbc"
    identifier = 0x0CFE49F9 | 1 << 31
    path.write_text(f'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\nBO_ {identifier} M: 8 A\n')
    assert read_dbc(path)["M"].identifier == identifier


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("BO_ 5 M: 16 A", "16 bytes; a classical CAN frame has at most 8"),
        (
            'BO_ 5 M: 8 A\n SG_ K M : 0|8@1+ (1,0) [0|0] "" B\n'
            ' SG_ L m0M : 8|8@1+ (1,0) [0|0] "" B\n SG_ X m1 : 16|8@1+ (1,0) [0|0] "" B\n\n'
            "SG_MUL_VAL_ 5 L K 0-0;\nSG_MUL_VAL_ 5 X L 1-1;",
            "is multiplexed by more than one signal (K, L)",
        ),
        (
            'BO_ 5 M: 8 A\n SG_ H : 0|16@1- (1,0) [0|0] "" B\n\nSIG_VALTYPE_ 5 H : 1;',
            "not of 32 or 64 bits: H",
        ),
    ],
)
def test_what_cannot_be_used_says_why(tmp_path: Path, lines: str, words: str) -> None:
    path = tmp_path / "x.dbc"
    path.write_text(f'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n{lines}\n')
    assert words in read_dbc(path)["M"].obstacle
