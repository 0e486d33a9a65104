"""Random logs of every format, and damaged ones: each is read to the last bit, or
something is said, or it is refused in words.

python -m tests.long.log_shapes [--cases N] [--damaged N] [--seed N] [FORMAT ...]
"""

from __future__ import annotations

import argparse
import gc
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from tests.rig.formats.shapes import PROPERTIES

REPORT = 10_000
KEPT = 50
"""Files that are kept to be damaged."""
MEMORY = Path("/dev/shm")


def shapes(kind: str, cases: int, first: int, folder: Path) -> Counter[str]:
    """Run the property of a format; any exception other than a refusal ends it."""
    logs, holds = PROPERTIES[kind]
    counts: Counter[str] = Counter()
    for number in range(first, first + cases):
        try:
            read = holds(logs(Random(number)), folder)
        except BaseException:
            print(f"{kind}: number {number}", file=sys.stderr, flush=True)
            raise
        counts["read" if read else "refused"] += 1
        if read and counts["read"] <= KEPT:
            kept = folder / f"kept{counts['read']}"
            kept.mkdir()
            for path in folder.glob("a.*"):
                shutil.copy(path, kept)
        if (number + 1) % REPORT == 0:
            print(f"{kind}: {dict(counts)}", file=sys.stderr, flush=True)
    return counts


def damaged(kind: str, cases: int, rng: np.random.Generator, folder: Path) -> Counter[str]:
    """Open files with changed, lost and added bytes; any exception other than a refusal ends it."""
    counts: Counter[str] = Counter()
    whole = [path for path in folder.glob("kept*/a.*") if path.suffix != ".dbc"]
    for n in range(cases):
        source = whole[n % len(whole)]
        data = bytearray(source.read_bytes())
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(data))) if data else 0
            match int(rng.integers(4)):
                case 0:
                    data[at : at + 1] = rng.bytes(1)
                case 1:
                    del data[at:]
                case 2:
                    del data[at : at + int(rng.integers(1, 9))]
                case _:
                    data[at:at] = rng.bytes(int(rng.integers(1, 9)))
        path = source.parent / f"damaged{source.suffix}"
        path.write_bytes(data)
        dbc = source.parent / "a.dbc"
        options = ReadSection(dbc=(str(dbc),)) if dbc.exists() else ReadSection()
        try:
            table = open_table(path, options)
            for k in range(len(table.names)):
                table.read([k])
        except InputError:
            counts["refused"] += 1
        else:
            counts["read"] += 1
        path.unlink()
    return counts


def main(argv: list[str] | None = None) -> int:
    """Print what was read and what was refused."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", default=list(PROPERTIES), metavar="FORMAT")
    parser.add_argument("--cases", type=int, default=150_000)
    parser.add_argument("--damaged", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    rng = np.random.default_rng(options.seed)
    # A refused file makes its reader collect garbage, which passes over all that is imported.
    gc.freeze()
    for kind in options.formats:
        folder = Path(tempfile.mkdtemp(prefix="shapes_", dir=MEMORY if MEMORY.is_dir() else None))
        begin = time.perf_counter()
        found = shapes(kind, options.cases, options.seed * 10**9, folder)
        spoiled = damaged(kind, options.damaged, rng, folder)
        shutil.rmtree(folder)
        print(
            f"{kind}: {found['read']} read, {found['refused']} refused; damaged: "
            f"{spoiled['read']} read, {spoiled['refused']} refused; "
            f"{time.perf_counter() - begin:.0f} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
