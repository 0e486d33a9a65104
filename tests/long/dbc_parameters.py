"""The Figure 10 sequence over a drive's own CAN frames and over CANopen: the same parameters, seed by seed.

python tests/long/dbc_parameters.py [--seeds N]

Columns come in pairs: CANopen, then the drive's own frames. Two honest 90 % intervals of one value miss each other in
2 % of cases; this passes where at most 5 % of the pairs do.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from statistics import fmean, median
from typing import Any

from rig.bench import load_bench
from rig.cli import status
from rig.tables import table
from rig.truth import true_parameters

BENCHES = ("practical", "practical_dbc")
MISSES = 0.05


def identified(bench: str, seed: int, folder: Path) -> dict[str, dict[str, Any]]:
    """Run and identify; return parameter name to its record."""
    run, result = folder / f"{bench}-{seed}", folder / f"{bench}-{seed}.json"
    for words in (
        ["run", "figure10", "--yes", "--bench", bench, "--seed", str(seed), "--out", str(run)],
        ["identify", str(run), "--out", str(run / "identified"), "--json", str(result)],
    ):
        with redirect_stdout(StringIO()):
            code = status(words)
        if code:
            raise SystemExit(f"rig {' '.join(words)} ended with status {code}")
    parameters: dict[str, dict[str, Any]] = json.loads(result.read_text())["parameters"]
    return parameters


def main(argv: list[str] | None = None) -> int:
    """Print the comparison; return 1 where too many pairs of intervals do not overlap."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = parser.parse_args(argv).seeds
    machine = load_bench(BENCHES[0]).value.mock
    assert machine is not None
    truth = true_parameters(machine)
    with tempfile.TemporaryDirectory() as folder:
        found = {bench: [identified(bench, seed, Path(folder)) for seed in range(seeds)] for bench in BENCHES}
    rows, apart = [], 0
    for name, true in truth.items():
        pairs = [tuple(found[bench][seed][name] for bench in BENCHES) for seed in range(seeds)]
        overlap = sum(a["low"] <= b["high"] and b["low"] <= a["high"] for a, b in pairs)
        apart += seeds - overlap
        errors = [median(abs(pair[k]["value"] / true - 1.0) for pair in pairs) for k in (0, 1)]
        biases = [fmean(pair[k]["value"] / true - 1.0 for pair in pairs) for k in (0, 1)]
        held = [sum(pair[k]["low"] <= true <= pair[k]["high"] for pair in pairs) for k in (0, 1)]
        row = [f"{100 * e:.3f}" for e in errors] + [f"{100 * b:+.3f}" for b in biases]
        rows.append([name, *row, f"{held[0]}/{seeds}", f"{held[1]}/{seeds}", f"{overlap}/{seeds}"])
    head = ["parameter", "error %", "own frames", "bias %", "own frames", "holds truth", "own frames", "overlap"]
    print(table(head, rows, right=range(1, 8)))
    pairs_in_all = seeds * len(truth)
    print(f"{apart} of {pairs_in_all} pairs of 90 % intervals do not overlap (limit {MISSES:.0%})")
    return 1 if apart > MISSES * pairs_in_all else 0


if __name__ == "__main__":
    sys.exit(main())
