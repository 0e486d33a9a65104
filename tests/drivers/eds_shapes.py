"""Random EDS files, refused with their name or read as they state."""

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from canopen.objectdictionary import ODVariable, datatypes

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.device_data import match
from drivers.canopen.eds_file import Described, read_eds
from drivers.canopen.link import CanopenLink, CanopenNode
from drivers.clock import SimulatedClock
from drivers.errors import ConfigurationError
from drivers.mock.traits import MAKES
from drivers.mock.wires.bus import SimulatedBus
from drivers.units import ServoScales
from tests.drivers.makes import description

NODE = 5
SCALES = ServoScales(4096, 100.0, 15.0, 0.45)
ENDS = ("\n", "\r\n")
SIGNED = {
    datatypes.INTEGER8: 8, datatypes.INTEGER16: 16, datatypes.INTEGER24: 24,
    datatypes.INTEGER32: 32, datatypes.INTEGER64: 64,
}  # fmt: skip
UNSIGNED = {
    datatypes.UNSIGNED8: 8, datatypes.UNSIGNED16: 16, datatypes.UNSIGNED24: 24,
    datatypes.UNSIGNED32: 32, datatypes.UNSIGNED48: 48, datatypes.UNSIGNED64: 64,
}  # fmt: skip
OTHER = (
    datatypes.BOOLEAN, datatypes.REAL32, datatypes.REAL64, datatypes.VISIBLE_STRING,
    datatypes.OCTET_STRING, datatypes.DOMAIN,
)  # fmt: skip
KINDS = (*SIGNED, *UNSIGNED, *OTHER)
ACCESS = ("ro", "wo", "rw", "rwr", "rww", "const")
Object = tuple[object, ...]
"""Data type, access, whether it can be mapped, limits, default, and whether this depends on the
node.
"""


def of(variable: ODVariable) -> Object:
    """Return what was read of an object."""
    return (
        variable.data_type,
        variable.access_type,
        variable.pdo_mappable,
        variable.min,
        variable.max,
        variable.default,
        variable.relative,
    )


def objects(dictionary: Described) -> dict[tuple[int, int], ODVariable]:
    """Return all objects by index and subindex."""
    return {
        (variable.index, variable.subindex): variable
        for item in dictionary.values()
        for variable in ([item] if isinstance(item, ODVariable) else item.values())
    }


def require_name(refused: ConfigurationError, path: Path) -> None:
    """Require that a refusal names the file."""
    if path.name not in str(refused):
        raise AssertionError(f"no file in: {refused}") from refused


@cache
def link() -> CanopenLink:
    """Return a bus that is never opened."""
    clock = SimulatedClock()
    return CanopenLink(clock, lambda: SimulatedBus(clock, 1_000_000), "simulated bus")


def read(path: Path) -> Described | None:
    """Read an EDS file as the program does before it sends anything; None if it is refused."""
    try:
        found = read_eds(path, NODE)
    except ConfigurationError as refused:
        require_name(refused, path)
        return None
    servo = Cia402Servo(CanopenNode(NODE, found, link()), link(), SCALES)
    list(servo.description_problems())
    match(found)
    return found


# --- the file of a make, with lines lost, moved, doubled and bytes changed


def damaged(whole: bytes, rng: Random, longest: int = 120) -> bytes:
    """Return a file with lines lost, moved or doubled, and bytes changed."""
    rows = whole.splitlines(keepends=True)
    begin = rng.randrange(len(rows))
    rows = rows[begin : begin + rng.randrange(1, longest)] if rng.randrange(8) else rows
    for _ in range(rng.randrange(4)):
        at, to = rng.randrange(len(rows)), rng.randrange(len(rows))
        row = rows[at]
        if rng.randrange(2):
            del rows[at]
        rows.insert(to, row)
    data = bytearray(b"".join(rows))
    for _ in range(rng.randrange(4)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def damaged_file(rng: Random, path: Path) -> bool:
    """Read a make's damaged file; whether it was read."""
    path.write_bytes(damaged(description(rng.choice(list(MAKES))).encode(), rng))
    return read(path) is not None


# --- files of which every object is known


def number(rng: Random, value: int, bits: int = 0) -> str:
    """Write a number in a way that files have; a negative one also as its unsigned bits."""
    if value < 0:
        return rng.choice((str(value), f"0x{value & (1 << bits) - 1:X}")) if bits else str(value)
    return rng.choice(
        (str(value), f"0x{value:X}", f"0x{value:08x}", f"{value:03d}", f"0X{value:x}")
    )


def drawn(rng: Random) -> tuple[dict[str, str], Object]:
    """Draw an object: the keys of its section, and what must be read."""
    kind = rng.choice(KINDS)
    access, mappable = rng.choice(ACCESS), rng.random() < 0.5
    keys = {
        "DataType": number(rng, kind),
        "AccessType": access.upper() if rng.random() < 0.3 else access,
    }
    if mappable or rng.random() < 0.7:
        keys["PDOMapping"] = number(rng, int(mappable))
    low = high = default = None
    relative = False
    bits = SIGNED.get(kind) or UNSIGNED.get(kind) or 0
    ends = (-(1 << bits - 1), (1 << bits - 1) - 1) if kind in SIGNED else (0, (1 << bits) - 1)
    if bits and rng.random() < 0.5:
        low, high = sorted(rng.choice((*ends, rng.randint(*ends))) for _ in range(2))
        keys["LowLimit"], keys["HighLimit"] = (number(rng, value, bits) for value in (low, high))
    if bits and rng.random() < 0.6:
        default = rng.randint(*ends)
        keys["DefaultValue"] = number(rng, default)
        if kind in UNSIGNED and rng.random() < 0.2:
            form = rng.choice(("$NODEID+{}", "{}+$NODEID", "$NodeID + {}"))
            keys["DefaultValue"] = form.format(number(rng, default))
            default, relative = default + NODE, True
    elif kind in (datatypes.REAL32, datatypes.REAL64) and rng.random() < 0.6:
        default = rng.choice((0.5, -1e-3, 3e38, rng.uniform(-1e6, 1e6)))
        keys["DefaultValue"] = repr(default)
    elif kind == datatypes.VISIBLE_STRING:
        default = rng.choice(("", "1.2", "EPOS", "a=b", "[x]"))
        keys["DefaultValue"] = default
    elif kind == datatypes.OCTET_STRING and rng.random() < 0.5:
        default = rng.randbytes(rng.randrange(1, 5))
        keys["DefaultValue"] = default.hex(" ") if rng.random() < 0.5 else default.hex()
    return keys, (kind, access, mappable, low, high, default, relative)


def section(rng: Random, head: str, keys: Mapping[str, str]) -> list[str]:
    """Write a section: its keys in any order and case, with comments, and keys that occur twice."""
    lines = [rng.choice(("[{}]", "[{}]", "[ {} ]", "[{}] ; x")).format(head)]
    for key, value in sorted(keys.items(), key=lambda _: rng.random()):
        name = rng.choice((key, key, key.lower(), key.upper()))
        gap = rng.choice(("=", "=", " = ", "=\t"))
        note = rng.choice(("", "", "", " ; note = 7", "\t;x"))
        lines.append(f"{name}{gap}{value}{note}")
        if rng.random() < 0.1:
            lines.append(rng.choice(("", "; DataType=0x99", "#", "  ", f"{key}=0x1")))
    return lines


def drawn_object(rng: Random, index: int) -> tuple[list[list[str]], dict[tuple[int, int], Object]]:
    """Draw an object with its members: its sections, and what must be read."""
    head = rng.choice((f"{index:04X}", f"{index:04x}"))
    kind = rng.choice(("variable", "variable", "variable", "record", "array", "compact"))
    names = {"ParameterName": rng.choice(("Statusword", "a b", "Größe", "x=1"))}
    if kind == "variable":
        keys, truth = drawn(rng)
        if rng.random() < 0.7:
            keys["ObjectType"] = number(rng, 7)
        return [section(rng, head, names | keys)], {(index, 0): truth}
    if kind == "compact":
        count = rng.randint(1, 6)
        keys, truth = drawn(rng)
        keys |= {"ObjectType": number(rng, 8), "CompactSubObj": number(rng, count)}
        counter = (datatypes.UNSIGNED8, "ro", False, None, None, None, False)
        known = {(index, 0): counter} | {(index, sub): truth for sub in range(1, count + 1)}
        return [section(rng, head, names | keys)], known
    code = 9 if kind == "record" else 8
    found = [section(rng, head, names | {"ObjectType": number(rng, code), "SubNumber": "3"})]
    known: dict[tuple[int, int], Object] = {}
    for sub in sorted({1, *(rng.choice((0, 2, 3, 9, 0x1F, 0xFE)) for _ in range(3))}):
        keys, known[index, sub] = drawn(rng)
        label = rng.choice((f"{head}sub{sub:X}", f"{head}Sub{sub:x}", f"{head}SUB{sub:02X}"))
        found.append(section(rng, label, names | keys))
    return found, known


def sound_file(rng: Random, path: Path) -> bool:
    """Read a file of known objects: all must be read as they are."""
    parts: list[list[str]] = []
    truth: dict[tuple[int, int], Object] = {}
    for index in {rng.randrange(0x1000, 0x10000) for _ in range(rng.randint(1, 6))}:
        found, known = drawn_object(rng, index)
        parts += found
        truth |= known
    if rng.random() < 0.5:
        parts.append(["[DeviceInfo]", "VendorNumber=0xFB", "ProductNumber=17"])
    rng.shuffle(parts)
    if rng.random() < 0.3:
        parts.insert(0, ["; a tool wrote this", "DataType=9"])
    end = rng.choice(ENDS)
    text = end.join(line for lines in parts for line in [*lines, *[""] * rng.randrange(2)]) + end
    path.write_bytes(text.encode(rng.choice(("utf-8", "utf-8-sig", "utf-16", "latin-1"))))
    dictionary = read(path)
    assert dictionary is not None, "a sound file is refused"
    assert not dictionary.faults, dictionary.faults
    have = {address: of(variable) for address, variable in objects(dictionary).items()}
    assert have == truth, _differences(have, truth)
    return True


def _differences(have: Mapping[Any, Any], truth: Mapping[Any, Any]) -> str:
    keys: Iterable[Any] = {*have, *truth}
    return "; ".join(
        f"{key}: {have.get(key)} is not {truth.get(key)}"
        for key in keys
        if have.get(key) != truth.get(key)
    )


TEXTS: Mapping[str, Callable[[Random, Path], bool]] = {
    "EDS damaged": damaged_file,
    "EDS sound": sound_file,
}
"""Kind of text to its property: draws a text, writes it to a path and reads it; whether it was
read.
"""
