"""Accuracy and coverage of the default method on the default Figure 10 run, or another, over seeds
of noise.

Each seed runs `rig run` through the whole simulated chain (drive loops, bus, quantisation, noise)
and identifies that run's own log. Prints the error of every parameter, the share of 90 % intervals
that hold the truth, and what was flagged.

    python benchmarks/figure10_accuracy.py --seeds 20
    python benchmarks/figure10_accuracy.py --sequence hotfire --bench practical_hot --seeds 12
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from identification.estimate.default import identify
from rig.cli import entry as cli
from rig.common.tables import table
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run


def main() -> None:
    """Run, identify, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--sequence", default="figure10")
    parser.add_argument("--bench", default="practical")
    arguments = parser.parse_args()
    errors: dict[str, list[float]] = {}
    inside: dict[str, list[bool]] = {}
    flagged: list[str] = []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "run"
            asked = [arguments.sequence, "--bench", arguments.bench, "--seed", str(seed)]
            status = cli.status(["run", *asked, "--yes", "--out", str(folder)])
            if status != 0:
                raise SystemExit(f"seed {seed}: rig run ended with status {status}")
            truth = truth_of(folder)
            assert truth is not None
            result = identify(load_run(folder))
        for name, parameter in result.parameters.items():
            true = truth[name]
            if parameter.value is None or parameter.low is None or parameter.high is None:
                flagged.append(f"seed {seed}: {name}: {parameter.reason}")
                continue
            errors.setdefault(name, []).append(parameter.value / true - 1.0)
            inside.setdefault(name, []).append(parameter.low <= true <= parameter.high)
        flagged += [f"seed {seed}: {text}" for text in result.warnings]
    rows = [
        [
            name,
            f"{100 * np.median(np.abs(values)):.3f}",
            f"{100 * np.max(np.abs(values)):.3f}",
            f"{100 * np.mean(values):+.3f}",
            f"{sum(inside[name])}/{len(values)}",
        ]
        for name, values in errors.items()
    ]
    print(
        table(
            ["parameter", "median error %", "worst %", "mean %", "90 % interval holds truth"], rows
        )
    )
    pooled = np.concatenate([np.array(v) for v in inside.values()])
    print(f"pooled coverage {100 * np.mean(pooled):.1f} % of {len(pooled)} intervals")
    print("\n".join(flagged) if flagged else "nothing flagged")


if __name__ == "__main__":
    main()
