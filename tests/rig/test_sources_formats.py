"""Each reader on files as tools write them, and on files that are broken."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from rig.sources.table import Table

PLAIN = ReadSection()


def delimited(
    folder: Path, text: str | bytes, options: ReadSection = PLAIN, name: str = "a.csv"
) -> Table:
    path = folder / name
    raw = text if isinstance(text, bytes) else text.encode()
    path.write_bytes(gzip.compress(raw) if name.endswith(".gz") else raw)
    return open_table(path, options)


VENDOR = (
    "Date:;2020-07-08\r\n"
    '"Trigger:;0;""Parameter values"";""Channel 1"""\r\n'
    "\r\n"
    "ms;rpm;%\r\n"
    "0.000;-10;-32.0\r\n"
    "51.200;-10;-32.6,,\r\n"
    '"102.400;-11;-33.0"\r\n'
    '"153.600";"-11";"-33.5"\r\n'
    "204.800;;-34.0;;\r\n"
    "\r\n"
    "256.000;-12;n/a\r\n"
)


def test_a_vendor_export_with_quoted_rows_commas_and_empty_cells(tmp_path: Path) -> None:
    table = delimited(tmp_path, VENDOR, ReadSection(delimiter=";", skip_rows=2))
    assert table.names == ("ms", "rpm", "%")
    time, speed, torque = table.read([0, 1, 2])
    np.testing.assert_array_equal(time, [0, 51.2, 102.4, 153.6, 204.8, 256])
    np.testing.assert_array_equal(speed, [-10, -10, -11, -11, np.nan, -12])
    np.testing.assert_array_equal(torque, [-32, -32.6, -33, -33.5, -34, np.nan])
    assert [table.place(row).rsplit(":", 1)[1] for row in (0, 4, 5)] == ["5", "9", "11"]


def test_without_header_only_indices(tmp_path: Path) -> None:
    table = delimited(tmp_path, VENDOR, ReadSection(skip_rows=4))
    assert table.names == ("", "", "")
    assert table.notes == ()
    assert table.read([0])[0][1] == 51.2
    (note,) = delimited(tmp_path, VENDOR, ReadSection(skip_rows=5)).notes
    assert "the last skipped line contains numbers" in note


@pytest.mark.parametrize(
    "raw",
    [
        b"t,\xb0C\n1,2\n3,4\n",
        b"\xef\xbb\xbft,\xc2\xb0C\n1,2\n3,4\n",
        b"# t,\xc2\xb0C\r\n1,2\r\n3,4",
    ],
)
def test_encodings_of_the_header(tmp_path: Path, raw: bytes) -> None:
    table = delimited(tmp_path, raw)
    assert table.names == ("t", "°C")
    np.testing.assert_array_equal(table.read([1])[0], [2, 4])


def test_a_units_line_below_the_header_is_told_from_a_broken_row(tmp_path: Path) -> None:
    table = delimited(tmp_path, "t,x\ns,m\n0,1\n2,3\n")
    np.testing.assert_array_equal(table.read([1])[0], [1, 3])
    assert table.units == ("s", "m")
    assert table.notes == ("line 2 below the names read as units: s, m",)
    with pytest.raises(InputError, match=r"a\.csv:2: column 't' is not a number \(got 's'\)"):
        delimited(tmp_path, "t,x\ns,1\n0,1\n").read([0])


CUT = gzip.compress(b"".join(b"%r\n" % v for v in np.random.default_rng(1).random(5000)))[:-5000]


@pytest.mark.parametrize(
    ("raw", "name", "options", "words"),
    [
        (b"\n\n", "a.csv", {}, "the file is empty"),
        (b"a,b\n\n", "a.csv", {}, "no rows of numbers below line 1"),
        (
            b"\x00\x01,\x00\n1,2\n",
            "a.csv",
            {},
            "line 1 contains zero bytes, so that the file is not",
        ),
        (b"t;x\n0,5;1\n", "a.csv", {}, r"csv:2: column 't' is not a number .*read\.decimal: \",\""),
        (CUT, "a.csv.gz", {}, r"cannot be read .*; check that the file was copied"),
    ],
)
def test_a_text_without_numbers_is_refused(
    tmp_path: Path, raw: bytes, name: str, options: dict[str, Any], words: str
) -> None:
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError, match=words):
        open_table(tmp_path / name, ReadSection(**options)).read([0])


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ("0.4,oops,1", "is not a number (got 'oops'); repair or remove the line"),
        ("0.4", "1 columns, but column 'b' is needed (got '0.4')"),
        ("0.4,2020-07-08 21:24:28,1", "is not a number (got '2020-07-08 21:24:28')"),
    ],
)
def test_one_bad_line_is_named(tmp_path: Path, bad: str, expected: str) -> None:
    rows = [f"{k / 1000},{k},{-k}" for k in range(1000)]
    rows[400] = bad
    table = delimited(tmp_path, "a,b,c\n" + "\n".join(rows))
    assert len(table.read([0])[0]) == 1000
    with pytest.raises(InputError) as caught:
        table.read([0, 1])
    assert "a.csv:402: " in str(caught.value)
    assert expected in str(caught.value)


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_numbers_or_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes
) -> None:
    folder = tmp_path_factory.mktemp("raw")
    try:
        table = delimited(folder, raw)
        values = table.read(range(len(table.names)))
    except InputError as error:
        values = []
        assert str(folder) in str(error)  # noqa: PT017 - either outcome is right, this is about its words
    assert all(value.ndim == 1 for value in values)


TIME = np.arange(6) * 0.1
VALUE = np.array([1.0, -2.0, 3.5, 0.0, 7.0, 9.0])


def test_mat_in_any_orientation(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    both = np.vstack([TIME, VALUE])
    scipy.io.savemat(
        path,
        {"row": TIME[None, :], "column": VALUE[:, None], "wide": both, "tall": both.T, "one": 3.0,
        "text": "abc",
         "count": np.arange(6, dtype=np.uint8)},
    )  # fmt: skip
    table = open_table(path, PLAIN)
    columns = dict(zip(table.names, table.read(range(len(table.names))), strict=True))
    for name in ("row", "wide[0]", "tall[0]"):
        np.testing.assert_array_equal(columns[name], TIME)
    for name in ("column", "wide[1]", "tall[1]"):
        np.testing.assert_array_equal(columns[name], VALUE)
    assert columns["count"].dtype == np.float64
    compressed = tmp_path / "a.mat.gz"
    compressed.write_bytes(gzip.compress(path.read_bytes()))
    assert set(open_table(compressed, PLAIN).names) == set(table.names)


def test_npz(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, t=TIME, m=np.column_stack([VALUE, -VALUE]), scalar=1.0)
    table = open_table(path, PLAIN)
    assert table.names == ("t", "m[0]", "m[1]")
    np.testing.assert_array_equal(table.read([2])[0], -VALUE)
    np.savez(path, x=np.array([object()] * 6, dtype=object))
    with pytest.raises(InputError, match="cannot be read"):
        open_table(path, PLAIN).read([0])
    np.savez(path, t=TIME)
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1  # says that the member is encrypted
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"cannot be read \(File 't\.npy' is encrypted"):
        open_table(path, PLAIN)


def test_decimal_commas_when_told(tmp_path: Path) -> None:
    text = 't;x\n0,5;-1,25e3\n1;"2,5"\n'
    t, x = delimited(tmp_path, text, ReadSection(decimal=",")).read([0, 1])
    np.testing.assert_array_equal(t, [0.5, 1.0])
    np.testing.assert_array_equal(x, [-1250.0, 2.5])
    headless = delimited(tmp_path, "0,5;1,5\n1,0;2,5\n", ReadSection(decimal=","))
    np.testing.assert_array_equal(headless.read([1])[0], [1.5, 2.5])
