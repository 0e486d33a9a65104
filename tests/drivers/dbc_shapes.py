"""Random DBC files, and frames read bit by bit by the file's bit numbers, without the codec."""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from drivers.dbc.codec import Signal
from drivers.dbc.file import read_dbc
from drivers.errors import ConfigurationError
from drivers.mock.dbc_drive import DRIVE_DBC

from .eds_shapes import ENDS, damaged, require_name

EXTENDED = 1 << 31
FACTORS = ("1", "0.5", "-2", "0.001", "1E-005", "0.000244140625", "1e3")
OFFSETS = ("0", "0", "-40", "0.25", "1E+002", "-12.5")
LABELS = ("OFF", "RUN", "a b", "Störung", "3", "x;y")
WORDS = ("A", "B", "C", "State", "Position", "Speed", "i_q", "T1", "Stop")


@dataclass(frozen=True)
class Field:
    """A signal as its DBC states it."""

    name: str
    start: int
    width: int
    motorola: bool
    signed: bool
    real: bool
    factor: str
    offset: str
    labels: Mapping[int, str]
    page: int | None = None
    selects: bool = False

    def bits(self) -> list[int]:
        """Return the bit numbers, the most significant first."""
        if not self.motorola:
            return list(range(self.start + self.width - 1, self.start - 1, -1))
        found, at = [], self.start
        for _ in range(self.width):
            found.append(at)
            at = at - 1 if at % 8 else at + 15
        return found

    def raw(self, frame: bytes) -> float:
        """Return the raw value in a frame."""
        value = 0
        for bit in self.bits():
            value = value << 1 | frame[bit // 8] >> bit % 8 & 1
        if self.real:
            code = "f" if self.width == 32 else "d"
            return float(struct.unpack(f">{code}", value.to_bytes(self.width // 8, "big"))[0])
        return value - (1 << self.width) if self.signed and value >> self.width - 1 else value

    def ends(self) -> tuple[int, int]:
        """Return the least and the greatest raw value of a whole number."""
        if self.signed:
            return -(1 << self.width - 1), (1 << self.width - 1) - 1
        return 0, (1 << self.width) - 1


@dataclass
class Frame:
    """A message as its DBC states it."""

    name: str
    identifier: int
    size: int
    period_ms: int
    fields: list[Field] = field(default_factory=list)

    def selector(self) -> Field | None:
        """Return the signal that selects the page."""
        return next((part for part in self.fields if part.selects), None)


def drawn_field(rng: Random, name: str, size: int, paged: bool) -> Field:
    """Draw a signal that fits into its message."""
    motorola = rng.random() < 0.5
    real = size >= 4 and rng.random() < 0.15
    width = 32 if real else min(rng.choice((1, 3, 4, 7, 8, 8, 12, 16, 16, 32, 63)), 8 * size)
    if real and size == 8 and rng.random() < 0.3:
        width = 64
    first = rng.randint(0, 8 * size - width)
    selects = paged and not real
    width = min(width, 6) if selects else width
    signed = not real and not selects and rng.random() < 0.4
    found = Field(
        name=name,
        start=first // 8 * 8 + 7 - first % 8 if motorola else first,
        width=width,
        motorola=motorola,
        signed=signed,
        real=real,
        factor="1" if selects else rng.choice(FACTORS),
        offset="0" if selects else rng.choice(OFFSETS),
        labels={},
        selects=selects,
    )
    if real or rng.random() < 0.6:
        return found
    low, high = found.ends()
    chosen = {rng.choice((0, 1, 2, 5, low, high)) for _ in range(rng.randint(1, 4))}
    values = [value for value in chosen if low <= value <= high]
    return replace(found, labels=dict(zip(values, rng.sample(LABELS, len(values)), strict=True)))


def drawn_frame(rng: Random, name: str, identifier: int) -> Frame:
    """Draw a message whose signals share no bit, other than on different pages."""
    size = rng.choice((1, 2, 4, 6, 8, 8, 8))
    frame = Frame(name, identifier, size, rng.choice((0, 0, 1, 10, 500)))
    paged = rng.random() < 0.25
    taken: dict[int | None, set[int]] = {None: set()}
    for word in rng.sample(WORDS, rng.randint(1, 6)):
        part = drawn_field(rng, word, size, paged and frame.selector() is None)
        if paged and frame.fields and frame.selector() and rng.random() < 0.7:
            selector = frame.selector()
            part = replace(part, page=rng.randint(0, min(3, (1 << selector.width) - 1)))
        bits = set(part.bits())
        hidden = taken[None] | taken.setdefault(part.page, set())
        beside = set().union(*taken.values()) if part.page is None else hidden
        if bits & beside:
            continue
        taken[part.page] |= bits
        frame.fields.append(part)
    return frame


def drawn_frames(rng: Random) -> list[Frame]:
    """Draw the messages of a file."""
    numbers = rng.sample(range(1, 0x7FF), 6)
    names = rng.sample(("Command", "Reply", "Limits", "Info", "Clear", "M_1"), rng.randint(1, 4))
    return [
        drawn_frame(rng, name, number if rng.random() < 0.7 else number << 12 | EXTENDED)
        for name, number in zip(names, numbers, strict=False)
    ]


def text_of(rng: Random, frames: Sequence[Frame]) -> str:
    """Write the messages as a DBC, with parts that carry no signal between."""
    tail: list[str] = []
    lines = [f'VERSION "{rng.choice(("", "1.0"))}"', "", "NS_ :", *rng.choice(([], [" CM_"])), ""]
    lines += ["BS_:", "", "BU_: A B", ""]
    for frame in frames:
        space = rng.choice((" ", " ", "  "))
        lines.append(f"BO_{space}{frame.identifier} {frame.name}:{space}{frame.size} A")
        for part in frame.fields:
            page = " M" if part.selects else f" m{part.page}" if part.page is not None else ""
            form = f"{part.start}|{part.width}@{int(not part.motorola)}"
            sign = "-" if part.signed else rng.choice("+-") if part.real else "+"
            lines.append(
                f" SG_ {part.name}{page} :{space}{form}{sign} ({part.factor},{part.offset})"
                f' [0|0] "{rng.choice(("", "rad", "N m", "°C"))}" {rng.choice(("B", "A,B"))}'
            )
            if part.real:
                kind = 1 if part.width == 32 else 2
                tail.append(f"SIG_VALTYPE_ {frame.identifier} {part.name} : {kind};")
            if part.labels:
                values = " ".join(f'{value} "{word}"' for value, word in part.labels.items())
                tail.append(f"VAL_ {frame.identifier} {part.name} {values} ;")
        if frame.period_ms:
            tail.append(f'BA_ "GenMsgCycleTime" BO_ {frame.identifier} {frame.period_ms};')
        if rng.random() < 0.3:
            note = rng.choice(("text", "für µ", "two\nlines", "SG_ X : 0|8@1+"))
            tail.append(f'CM_ BO_ {frame.identifier} "{note}";')
        lines += [""] * rng.randrange(2)
    rng.shuffle(tail)
    # The definition of an attribute is before its values.
    definition = ['BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;', 'BA_DEF_DEF_ "GenMsgCycleTime" 0;']
    return "\n".join([*lines, "", *definition, *tail, ""])


def write(rng: Random, path: Path, frames: Sequence[Frame]) -> None:
    """Write a file of these messages in one of the encodings of such files."""
    text = text_of(rng, frames).replace("\n", rng.choice(ENDS))
    path.write_bytes(text.encode(rng.choice(("utf-8", "utf-8-sig", "cp1252"))))


def require_signal(signal: Signal, part: Field, frame: bytes, selector: Field | None) -> None:
    """Hold what was read of a signal against what the file states."""
    found, true = signal.raw(frame), part.raw(frame)
    assert found == true or (found != found and true != true), f"{part}: {found} in {frame.hex()}"
    assert (signal.factor, signal.offset) == (float(part.factor), float(part.offset)), part
    assert signal.labels == part.labels, f"{signal.labels} are not {part.labels}"
    if part.page is None:
        assert signal.selector is None, part
    else:
        assert signal.selector is not None, part
        assert (signal.selector.name, signal.pages) == (selector.name, (part.page,)), part


def sound_file(rng: Random, path: Path) -> bool:
    """Read a file of known messages: all must be read as they are."""
    frames = drawn_frames(rng)
    write(rng, path, frames)
    layouts = read_dbc(path)
    assert set(layouts) == {frame.name for frame in frames}
    for frame in frames:
        layout = layouts[frame.name]
        assert not layout.obstacle, layout.obstacle
        period = frame.period_ms / 1e3 if frame.period_ms else None
        assert (layout.identifier, layout.size, layout.period_s) == (
            frame.identifier, frame.size, period
        )  # fmt: skip
        assert set(layout.signals) == {part.name for part in frame.fields}
        data = rng.randbytes(frame.size)
        for part in frame.fields:
            require_signal(layout.signals[part.name], part, data, frame.selector())
    return True


def damaged_file(rng: Random, path: Path) -> bool:
    """Read the damaged file of the simulated drive; whether it was read."""
    path.write_bytes(damaged(DRIVE_DBC.read_bytes(), rng, 90))
    try:
        read_dbc(path)
    except ConfigurationError as refused:
        require_name(refused, path)
        return False
    return True


TEXTS: Mapping[str, Callable[[Random, Path], bool]] = {
    "DBC damaged": damaged_file,
    "DBC sound": sound_file,
}
"""Kind of text to its property: draws a text, writes it to a path and reads it; whether it was
read.
"""
