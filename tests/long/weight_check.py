"""How often the weight check is right: stages on the simulated bench with right and wrong masses,
through `rig run`.

Run from the root of the repository; takes some minutes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from rig.common.tables import table
from rig.control.operator import AutomaticOperator
from rig.runs.run import read_record

from .console import rig

STAGE = """\
sequence: 1
name: weighing
stages:
  - {{name: loaded, stage: loaded, weight_kg: {mass:.3f}, tones: [{{amplitude_deg: 20,
     frequency_Hz: 0.2}}],
     duration_s: 7, ramp_in_s: 1, ramp_out_s: 1}}
"""
LEAST_ERROR, GREATEST_ERROR = 0.15, 0.5
SIGNS = {"right": 0, "too light": -1, "too heavy": 1}
"""Kinds of stages, and on which side of its label the hung mass lies."""
WANTED_REFUSED, WANTED_ACCEPTED = 0.95, 0.99
LIGHTEST_KG, HEAVIEST_KG = 5.0, 40.0


def identification(folder: Path, bench: str) -> Path:
    """Identify the bench by the Figure 10 sequence; return the result file."""
    result = folder / "identification.json"
    run = str(folder / "first")
    rig("run", "figure10", "--bench", bench, "--yes", "--seed", "1000", "--out", run)
    rig("identify", run, "--json", str(result))
    return result


def verdict(
    folder: Path, bench: str, known: Path, label_kg: float, hung_kg: float, seed: int
) -> dict[str, object]:
    """Run one stage; return what its weight check found."""
    sequence, out = folder / "stage.yaml", folder / f"run{seed}"
    sequence.write_text(STAGE.format(mass=label_kg))
    # The operator hangs this mass, whatever was asked for.
    with mock.patch.object(AutomaticOperator, "hangs", return_value=hung_kg):
        words = ["run", str(sequence), "--bench", bench, "--yes", "--seed", str(seed)]
        rig(*words, "--identification", str(known), "--out", str(out), check=False)
    record = read_record(out)
    if record.weights:
        return dict(record.weights[0])
    if record.trip is None or "phase first pass" not in record.message:
        raise SystemExit(f"the run ended before its weight check: {record.message}")
    # So much too heavy that a limit of the first pass trips: it never gets to full amplitude
    # either.
    return {"verdict": "wrong", "measured_kg": None, "message": record.message}


def draw(kind: str, number: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return label and hung mass of one stage, kg."""
    label = round(float(rng.uniform(LIGHTEST_KG, HEAVIEST_KG)), 3)
    wrong_by = LEAST_ERROR if number % 2 else float(rng.uniform(LEAST_ERROR, GREATEST_ERROR))
    return label, label * (1.0 + SIGNS[kind] * wrong_by)


def judged(
    kind: str, stages: int, folder: Path, bench: str, known: Path, rng: np.random.Generator
) -> Kind:
    """Run all stages of one kind; says each that was misjudged."""
    hits, errors, tripped = 0, [], 0
    wanted = "wrong" if SIGNS[kind] else "right"
    for number in range(stages):
        label, hung = draw(kind, number, rng)
        found = verdict(
            folder, bench, known, label, hung, 10_000 * (1 + list(SIGNS).index(kind)) + number
        )
        hits += found["verdict"] == wanted
        measured = found["measured_kg"]
        errors += [] if measured is None else [float(str(measured)) / hung - 1.0]
        tripped += measured is None and found["verdict"] == "wrong"
        if found["verdict"] != wanted:
            print(f"{kind}: label {label:.3f} kg, hung {hung:.3f} kg: {found['message']}")
    return Kind(kind, hits, tripped, np.array(errors))


@dataclass(frozen=True)
class Kind:
    """Stages of one kind: how many were judged rightly, how many of those by a limit, and the
    errors of the masses.
    """

    name: str
    hits: int
    tripped: int
    errors: NDArray[np.float64]

    def row(self, stages: int) -> list[str]:
        """Return it as a row of the table."""
        word = "refused" if SIGNS[self.name] else "accepted"
        e = self.errors
        figures = (
            [f"{e.mean():+.2%}", f"{e.std():.2%}", f"{np.abs(e).max():.2%}"]
            if e.size
            else ["-"] * 3
        )
        return [self.name, f"{self.hits} of {stages} {word}", str(self.tripped), *figures]

    def good(self, stages: int) -> bool:
        """Whether enough of them were judged rightly."""
        return self.hits >= (WANTED_REFUSED if SIGNS[self.name] else WANTED_ACCEPTED) * stages


def main() -> int:
    """Print the shares and what was misjudged; 0 when all are as wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=100, help="of each kind")
    parser.add_argument("--bench", default="practical")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    stages, rng = arguments.stages, np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        known = identification(folder, arguments.bench)
        kinds = [judged(kind, stages, folder, arguments.bench, known, rng) for kind in SIGNS]
    print(arguments.bench)
    head = ["weight", "judged", "by a limit", "mean error", "sd", "worst"]
    print(table(head, [kind.row(stages) for kind in kinds], right=range(2, 6)))
    return 0 if all(kind.good(stages) for kind in kinds) else 1


if __name__ == "__main__":
    sys.exit(main())
