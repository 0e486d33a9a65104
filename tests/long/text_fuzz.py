"""Random EDS files, DBC files and maps: each is read as it states, or refused in words.

python -m tests.long.text_fuzz [--cases N] [--seed N] [--first N] [KIND ...]

Anything else ends the program with the number of the text.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random

from tests.drivers import dbc_shapes, eds_shapes, map_shapes

REPORT = 10_000
TEXTS = {**eds_shapes.TEXTS, **dbc_shapes.TEXTS, **map_shapes.TEXTS}
MEMORY = Path("/dev/shm")


def main(argv: list[str] | None = None) -> int:
    """Draw, read and judge all texts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=list(TEXTS), metavar="KIND")
    parser.add_argument("--cases", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args(argv)
    counts: Counter[str] = Counter()
    began = time.process_time()
    gc.freeze()
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        for number in range(given.first, given.first + given.cases):
            kind = given.kinds[number % len(given.kinds)]
            path = Path(folder) / f"text.{kind[:3].lower()}"
            try:
                read = TEXTS[kind](Random(given.seed << 32 | number), path)
            except BaseException:
                print(f"{kind}: number {number}, seed {given.seed}", file=sys.stderr, flush=True)
                raise
            counts[f"{kind} {'read' if read else 'refused'}"] += 1
            if (number + 1) % REPORT == 0:
                print(dict(counts), file=sys.stderr, flush=True)
    shown = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
    print(f"{shown}, in {time.process_time() - began:.0f} s of the processor")
    return 0


if __name__ == "__main__":
    sys.exit(main())
