"""Checksums, and the range of a signal."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dbc.codec import (
    CHECKSUMS,
    Signal,
    checksum_of,
    crc8_autosar,
    crc8_j1850,
    sum8,
    xor8,
)
from drivers.dbc.file import Layout, read_dbc

HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n'


def load(tmp_path_factory: pytest.TempPathFactory, text: str) -> dict[str, Layout]:
    path = tmp_path_factory.mktemp("dbc") / "x.dbc"
    path.write_text(text)
    return read_dbc(path)


def test_factor_and_offset_name_the_range(tmp_path_factory) -> None:
    text = f'{HEAD}BO_ 5 M: 1 A\n SG_ T : 0|8@1+ (0.5,-40) [0|0] "degC" B\n'
    signal = load(tmp_path_factory, text)["M"].signals["T"]
    assert (signal.factor, signal.offset) == (0.5, -40.0)
    with pytest.raises(ValueError, match=r"T = 88 is outside -40 to 87\.5"):
        signal.pack((88.0 + 40.0) / 0.5)
    for nothing in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=r"outside -40 to 87\.5"):
            signal.pack(nothing)


def test_checksums_have_their_published_check_values() -> None:
    text = b"123456789"
    assert (crc8_j1850(text), crc8_autosar(text)) == (0x4B, 0xDF)
    assert (sum8(text), xor8(text)) == (0xDD, 0x31)


@pytest.mark.parametrize("kind", sorted(CHECKSUMS))
@settings(max_examples=40)
@given(data=st.binary(min_size=1, max_size=8), bit=st.integers(0, 63))
def test_a_checksum_sees_every_single_bit(kind: str, data: bytes, bit: int) -> None:
    flipped = (int.from_bytes(data, "big") ^ 1 << bit % (8 * len(data))).to_bytes(len(data), "big")
    assert CHECKSUMS[kind](data) != CHECKSUMS[kind](flipped)


@pytest.mark.parametrize("motorola", [False, True])
@pytest.mark.parametrize("byte", [0, 3])
@settings(max_examples=20, deadline=None)
@given(data=st.binary(min_size=4, max_size=4), prefix=st.binary(max_size=3))
def test_a_checksum_covers_its_prefix_and_all_other_bytes(
    motorola: bool, byte: int, data: bytes, prefix: bytes
) -> None:
    shift = 8 * (3 - byte if motorola else byte)
    signal = Signal("C", 4, shift, 8, motorola)
    rest = data[:byte] + data[byte + 1 :]
    zeroed = data[:byte] + b"\0" + data[byte + 1 :]
    for kind, algorithm in CHECKSUMS.items():
        assert checksum_of(kind, signal, prefix)(data) == algorithm(prefix + zeroed)
        assert checksum_of(kind, signal, prefix, left_out=True)(data) == algorithm(prefix + rest)


def test_crc8_j1850_beside_its_byte() -> None:
    """The check value of the catalogue of CRCs, over the digits 1 to 9."""
    signal = Signal("C", 8, 56, 8)
    crc = checksum_of("crc8_j1850", signal, b"12", left_out=True)
    assert crc(b"3456789\xee") == crc8_j1850(b"123456789") == 0x4B
