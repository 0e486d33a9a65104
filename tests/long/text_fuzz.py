"""Random EDS and DBC texts: each is read, or refused in words; anything else ends the program.

python -m tests.long.text_fuzz [--cases N] [--seed N]

Of four texts two are made of lines that EDS files have, one is a make's EDS file and one the DBC
file of the simulated drive, both with lines lost, moved, doubled and bytes changed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.device_data import match
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink
from drivers.clock import SimulatedClock
from drivers.dbc.file import read_dbc
from drivers.errors import ConfigurationError
from drivers.mock.dbc_drive import DRIVE_DBC
from drivers.mock.makes import MAKES, description
from drivers.mock.wires.bus import SimulatedBus
from drivers.units import ServoScales

REPORT = 10_000
SCALES = ServoScales(4096, 100.0, 15.0, 0.45)
KEYS = (
    "ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "LowLimit",
    "HighLimit", "PDOMapping", "CompactSubObj", "SubNumber", "NrOfEntries", "Lines", "VendorNumber",
)  # fmt: skip
VALUES = ("", "0x7", "7", "8", "9", "-1", "x", "0x", "$NODEID+0x180", "1 ; note", "0xFFFFFFFFFF")
NAMES = (
    "1000", "1018", "1018sub1", "6041", "6041sub0", "6064", "607A", "1A00", "1A00sub1", "1800",
    "FileInfo", "A0", "DummyUsage", "1018Name", "Comments", "1018subFF", "DeviceInfo",
)  # fmt: skip
ODD = "[]=;\t \x00\ufeff\u00e4\u2028x1"


def lines(rng: Random) -> bytes:
    """Return a text of lines that EDS files have, and of others."""

    def line() -> str:
        kind = rng.randrange(5)
        if kind < 2:
            return f"[{rng.choice(NAMES)}]"
        if kind < 4:
            return f"{rng.choice(KEYS)}={rng.choice(VALUES)}"
        return "".join(rng.choice(ODD) for _ in range(rng.randrange(12)))

    end = rng.choice(("\n", "\r\n", "\r"))
    text = end.join(line() for _ in range(rng.randrange(40)))
    return text.encode(rng.choice(("utf-8", "utf-16", "latin-1")), "replace")


def damaged(whole: bytes, rng: Random) -> bytes:
    """Return a file with lines lost, moved or doubled, and bytes changed."""
    rows = whole.splitlines(keepends=True)
    begin = rng.randrange(len(rows))
    rows = rows[begin : begin + rng.randrange(1, 120)] if rng.randrange(8) else rows
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


def eds(path: Path) -> None:
    """Read an EDS file as the program does before it sends anything."""
    clock = SimulatedClock()
    link = CanopenLink(clock, lambda: SimulatedBus(clock, 1_000_000), "simulated bus")
    node = link.add_node(1, path)
    list(Cia402Servo(node, link, SCALES).description_refusals())
    match(read_eds(path, 1))


def main() -> int:
    """Read all texts; a traceback ends it with the number of the text."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    makes = [description(make).encode() for make in MAKES]
    bus = DRIVE_DBC.read_bytes()
    kinds: list[tuple[str, Callable[[Random], bytes], Callable[[Path], object]]] = [
        ("EDS lines", lines, eds),
        ("EDS lines", lines, eds),
        ("EDS file", lambda rng: damaged(rng.choice(makes), rng), eds),
        ("DBC file", lambda rng: damaged(bus, rng), read_dbc),
    ]
    counts: Counter[str] = Counter()
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(given.cases):
            kind, text, read = kinds[number % len(kinds)]
            path = Path(folder) / f"text.{kind[:3].lower()}"
            path.write_bytes(text(Random(given.seed << 32 | number)))
            try:
                read(path)
                counts[f"{kind} read"] += 1
            except ConfigurationError as refused:
                if path.name not in str(refused):
                    raise AssertionError(
                        f"{kind}: number {number}: no file in: {refused}"
                    ) from refused
                counts[f"{kind} refused"] += 1
            except BaseException:
                print(f"{kind}: number {number}, seed {given.seed}", file=sys.stderr, flush=True)
                raise
            if (number + 1) % REPORT == 0:
                print(dict(counts), file=sys.stderr, flush=True)
    shown = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
    print(f"{shown}, in {time.perf_counter() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
