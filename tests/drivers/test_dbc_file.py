from __future__ import annotations

from pathlib import Path

import pytest

from drivers.dbc.file import read_dbc
from drivers.errors import ConfigurationError
from drivers.mock.dbc_drive import DRIVE_DBC


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


@pytest.mark.parametrize(
    ("comment", "encoding"),
    [
        ("电流", "utf-16"),
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
