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


def test_signals_that_overlap_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_text(DRIVE_DBC.read_text().replace("Life : 4|4@1+", "Life : 3|4@1+"))
    with pytest.raises(
        ConfigurationError, match=r"bad\.dbc: The signals .* overlapping in message DRV_Command"
    ):
        read_dbc(path)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"none\.dbc: cannot be read: No such file"):
        read_dbc(tmp_path / "none.dbc")


def test_bytes_that_are_no_text_are_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_bytes(b"VERSION \x81")
    with pytest.raises(ConfigurationError, match="byte 8 is not cp1252"):
        read_dbc(path)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("BO_ 2147483653 M: 8 A", "29-bit identifier"),
        ("BO_ 5 M: 16 A", "16 bytes; classical CAN carries at most 8"),
        (
            'BO_ 5 M: 8 A\n SG_ K M : 0|8@1+ (1,0) [0|0] "" B\n SG_ X m0 : 8|8@1+ (1,0) [0|0] "" B',
            "is multiplexed",
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
