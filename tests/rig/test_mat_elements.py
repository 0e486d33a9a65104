"""The guard in front of scipy's reader: good files pass, impossible headers are named."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csc_array

from rig.common.errors import InputError
from rig.sources.formats.arrays import HEADER_BYTES, DamagedElementError, MatTable, check_elements

CONTENT = {
    "t": np.arange(9.0),
    "a_longer_name": np.arange(6, dtype=np.int16).reshape(2, 3),
    "z": np.array([1.0 + 2.0j, 3.0]),
    "b": np.array([True, False]),
    "s": {"x": 1.0, "text": "words"},
    "c": np.array(["abc", "d"]),
    "none": np.empty((0, 3)),
}


def saved(content: dict[str, Any] = CONTENT, **options: Any) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, content, oned_as="column", **options)
    return stream.getvalue()


PLAIN = saved()
ONE = saved({"t": np.arange(9.0)})
FLAGS, DIMENSIONS, NAME, VALUES = (HEADER_BYTES + 8 + k for k in (0, 16, 32, 40))
"""Where the parts of the one variable of ``ONE`` start."""


@pytest.mark.parametrize(
    "raw", [PLAIN, saved(do_compression=True), saved({"t": np.arange(3.0)}, format="4"), b""]
)
def test_good_files_and_other_formats_pass(raw: bytes) -> None:
    check_elements(io.BytesIO(raw))


def test_big_endian_passes() -> None:
    header = b"MATLAB 5.0".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    parts = (
        struct.pack(">IIII", 6, 8, 6, 0)
        + struct.pack(">IIii", 5, 8, 2, 1)
        + struct.pack(">HH4s", 1, 1, b"t")
    )
    values = struct.pack(">IIdd", 9, 16, 1.0, 2.0)
    raw = header + struct.pack(">II", 14, len(parts + values)) + parts + values
    check_elements(io.BytesIO(raw))
    assert scipy.io.loadmat(io.BytesIO(raw))["t"].tolist() == [[1.0], [2.0]]


@pytest.mark.parametrize(
    ("place", "word", "expected"),
    [
        (HEADER_BYTES, 77, "no variable"),
        (HEADER_BYTES + 4, 1 << 30, "does not fit"),
        (FLAGS, 7, "flags has the impossible type 7"),
        (FLAGS + 4, 16, "flags at byte 144 have 16 bytes"),
        (FLAGS + 8, 99, "impossible class 99"),
        (DIMENSIONS, 9, "dimensions has the impossible type 9"),
        (DIMENSIONS + 8, 10, "72 bytes of values do not fit 10 x 1"),
        (DIMENSIONS + 8, 2**32 - 9, "72 bytes of values do not fit -9 x 1"),
        (NAME, 3 | 1 << 16, "name has the impossible type 3"),
        (NAME, 1 | 5 << 16, "an element of 5 bytes does not fit"),
        (VALUES, 14, "values has the impossible type 14"),
        (VALUES, 2, "72 bytes of values do not fit 9 x 1"),
        (VALUES + 4, 64, "64 bytes of values do not fit 9 x 1"),
        (FLAGS + 8, 6 | 0x0800, "has no imaginary values"),
    ],
)
def test_an_impossible_header_is_named(place: int, word: int, expected: str) -> None:
    raw = bytearray(ONE)
    raw[place : place + 4] = struct.pack("<I", word)
    with pytest.raises(DamagedElementError, match=expected):
        check_elements(io.BytesIO(raw))


def test_a_cut_header() -> None:
    with pytest.raises(DamagedElementError, match="cut off inside an element header, at byte 128"):
        check_elements(io.BytesIO(ONE[: HEADER_BYTES + 3]))


@given(st.data())
def test_any_damage_passes_or_is_named(data: st.DataObject) -> None:
    raw = bytearray(PLAIN[: data.draw(st.integers(0, len(PLAIN)))])
    for place in (
        data.draw(st.lists(st.integers(0, max(len(raw) - 1, 0)), max_size=4)) if raw else ()
    ):
        raw[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(DamagedElementError):
        check_elements(io.BytesIO(raw))


def test_a_struct_with_a_member_that_is_not_read_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    content = {
        "good": {"x": np.arange(4.0)},
        "odd": {"x": np.arange(4.0), "m": csc_array(np.eye(3))},
    }
    scipy.io.savemat(path, content)
    assert MatTable(path).names == ("good.x",)


def test_text_and_members_of_a_struct_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"s": {"x": np.arange(4.0), "word": "abcdefgh"}})
    raw = path.read_bytes()
    place = raw.rindex(b"\x10\0\0\0\x08\0\0\0abcdefgh")
    path.write_bytes(raw[:place] + b"\x0f" + raw[place + 1 :])
    with pytest.raises(InputError, match="text has the impossible type 15"):
        MatTable(path)
    names = raw.index(b"x\0\0\0")
    length = raw.rindex(b"\x05\0\x04\0", 0, names)
    path.write_bytes(raw[: length + 4] + (7).to_bytes(4, "little") + raw[length + 8 :])
    with pytest.raises(
        InputError, match=r"\d+ bytes of field names do not fit names of 7 bytes each"
    ):
        MatTable(path)
