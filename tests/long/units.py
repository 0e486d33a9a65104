"""Units proven by motion: benches with a mistake, and right ones, each run with its first pass.

python -m tests.long.units [--wrong 100] [--right 200] [--first 0]

Passes where every mistake is found before full amplitude, with the right factor, and no right bench
is refused. Writes its table to the terminal.
"""

import argparse
import contextlib
import io
import logging
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from rig.common.tables import table

from .unit_benches import MISTAKES, draw, judged, run


def trial(seed: int, mistake: str | None, folder: Path) -> tuple[str, str]:
    """Run one bench; returns make and transport, and what is wrong with the outcome."""
    drawn = draw(np.random.default_rng([seed, 0 if mistake is None else 1]), mistake)
    with contextlib.redirect_stdout(io.StringIO()):
        record, outcome = run(drawn, seed, folder)
    bus = "serial" if drawn.bench["bus"]["interface"] == "epos_serial" else "CAN"
    return f"{drawn.make}, {bus}", judged(drawn, outcome, record)


def main() -> int:
    """Run all, and print a table; returns the exit status."""
    logging.getLogger("can").addHandler(logging.NullHandler())
    parser = argparse.ArgumentParser()
    parser.add_argument("--wrong", type=int, default=100)
    parser.add_argument("--right", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    kinds: list[str | None] = [MISTAKES[n % len(MISTAKES)] for n in range(given.wrong)]
    kinds += [None] * given.right
    tried, good = Counter[tuple[str, str]](), Counter[tuple[str, str]]()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(kinds):
            where, problem = trial(given.first + number, kind, Path(folder) / str(number))
            cell = (kind or "none", where)
            tried[cell] += 1
            good[cell] += not problem
            if problem:
                print(f"{given.first + number} {kind} {where}: {problem}", flush=True)
    names = [*MISTAKES, "none"]
    places = sorted({where for _, where in tried})
    rows = [[where, *(f"{good[n, where]} of {tried[n, where]}" for n in names)] for where in places]
    sums = [
        f"{sum(good[n, w] for w in places)} of {sum(tried[n, w] for w in places)}" for n in names
    ]
    print(table(["drive", *names], [*rows, ["all", *sums]]))
    print(f"{time.monotonic() - began:.0f} s")
    return int(sum(good.values()) != sum(tried.values()))


if __name__ == "__main__":
    sys.exit(main())
