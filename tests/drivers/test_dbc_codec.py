"""The codec against ``cantools``, which it replaces where time matters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cantools.database
import pytest
from hypothesis import given
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


@dataclass
class Drawn:
    """A signal at a random place of a random frame, in the DBC's own numbering."""

    size: int
    start: int
    width: int
    motorola: bool
    signed: bool

    def text(self) -> str:
        order, sign = int(not self.motorola), "-" if self.signed else "+"
        return f' SG_ S : {self.start}|{self.width}@{order}{sign} (1,0) [0|0] "" B\n'


@st.composite
def drawn(draw: st.DrawFn) -> Drawn:
    size = draw(st.integers(1, 8))
    width = draw(st.integers(1, 8 * size))
    motorola = draw(st.booleans())
    first = draw(st.integers(0, 8 * size - width))
    # Motorola numbers its most significant bit, counted down within each byte.
    start = first // 8 * 8 + 7 - first % 8 if motorola else first
    return Drawn(size, start, width, motorola, draw(st.booleans()))


def load(tmp_path_factory: pytest.TempPathFactory, text: str) -> dict[str, Layout]:
    path = tmp_path_factory.mktemp("dbc") / "x.dbc"
    path.write_text(text)
    return read_dbc(path)


@given(signal=drawn(), content=st.binary(min_size=8, max_size=8), share=st.floats(0, 1))
def test_every_layout_reads_and_writes_as_cantools_does(
    tmp_path_factory, signal, content, share
) -> None:
    text = f"{HEAD}BO_ 5 M: {signal.size} A\n{signal.text()}\n"
    ours = load(tmp_path_factory, text)["M"].signals["S"]
    theirs = cantools.database.load_string(text, "dbc").get_message_by_name("M")
    data = content[: signal.size]
    assert ours.raw(data) == theirs.decode(data)["S"]
    assert ours.reader(2.0, 1.0)(data) == 2.0 * ours.raw(data) + 1.0
    low, high = ours.range
    value = low + round(share * (high - low))
    value = min(max(value, low), high)
    assert ours.insert(bytes(signal.size), ours.pack(value)) == theirs.encode({"S": value})
    # Every other bit stays.
    other = bytes(
        a & ~b & 0xFF for a, b in zip(data, ours.insert(bytes(signal.size), ours.mask), strict=True)
    )
    changed = ours.insert(data, ours.pack(value))
    assert ours.raw(changed) == value
    assert ours.insert(changed, 0) == other


@given(value=st.floats(allow_nan=False, allow_infinity=False, width=32), motorola=st.booleans())
def test_floating_point_signals(tmp_path_factory, value: float, motorola: bool) -> None:
    start = 7 if motorola else 0
    text = (
        f'{HEAD}BO_ 5 M: 8 A\n SG_ S : {start}|32@{int(not motorola)}- (1,0) [0|0] "" '
        f"B\n\nSIG_VALTYPE_ 5 S : 1;\n"
    )
    ours = load(tmp_path_factory, text)["M"].signals["S"]
    data = cantools.database.load_string(text, "dbc").get_message_by_name("M").encode({"S": value})
    assert ours.real
    assert ours.raw(data) == value
    assert ours.reader(2.0, 0.5)(data) == 2.0 * value + 0.5
    assert ours.insert(bytes(8), ours.pack(value)) == data
    with pytest.raises(ValueError, match="does not fit into a floating-point number of 32 bits"):
        ours.pack(1e300)


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
@given(data=st.binary(min_size=1, max_size=8), bit=st.integers(0, 63))
def test_a_checksum_sees_every_single_bit(kind: str, data: bytes, bit: int) -> None:
    flipped = (int.from_bytes(data, "big") ^ 1 << bit % (8 * len(data))).to_bytes(len(data), "big")
    assert CHECKSUMS[kind](data) != CHECKSUMS[kind](flipped)


@pytest.mark.parametrize("motorola", [False, True])
@pytest.mark.parametrize("byte", range(4))
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
