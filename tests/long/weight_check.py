"""How often the weight check is right: stages on the simulated bench with right and wrong masses, through `rig run`.

Run from the root of the repository; takes some minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np

from rig.cli import status
from rig.operator import AutomaticOperator
from rig.run import read_record

STAGE = """\
sequence: 1
name: weighing
stages:
  - {{name: loaded, stage: loaded, weight_kg: {mass:.3f}, tones: [{{amplitude_deg: 20, frequency_Hz: 0.2}}],
     duration_s: 7, ramp_in_s: 1, ramp_out_s: 1}}
"""
LEAST_ERROR = 0.15
WANTED_REFUSED, WANTED_ACCEPTED = 0.95, 0.99
LIGHTEST_KG, HEAVIEST_KG = 5.0, 40.0


@contextlib.contextmanager
def hanging(mass_kg: float) -> Iterator[None]:
    """Let the automatic operator hang this mass, whatever was asked for."""
    with mock.patch.object(AutomaticOperator, "hangs", return_value=mass_kg):
        yield


def quietly(*arguments: str) -> int:
    """Run a command and keep what it says to itself."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return status(list(arguments))


def identification(folder: Path, bench: str) -> Path:
    """Identify the bench by the Figure 10 sequence; return the result file."""
    result = folder / "identification.json"
    assert quietly("run", "figure10", "--bench", bench, "--yes", "--seed", "1000", "--out", str(folder / "first")) == 0
    assert quietly("identify", str(folder / "first"), "--json", str(result)) == 0
    return result


def verdict(folder: Path, bench: str, known: Path, label_kg: float, hung_kg: float, seed: int) -> dict[str, object]:
    """Run one stage; return what its weight check found."""
    sequence, out = folder / "stage.yaml", folder / f"run{seed}"
    sequence.write_text(STAGE.format(mass=label_kg))
    with hanging(hung_kg):
        quietly(
            *("run", str(sequence), "--bench", bench, "--yes", "--seed", str(seed)),
            *("--identification", str(known), "--out", str(out)),
        )
    record = read_record(out)
    if record.weights:
        return dict(record.weights[0])
    if record.trip is None or "phase first pass" not in record.message:
        raise SystemExit(f"the run ended before its weight check: {record.message}")
    # So much too heavy that a limit of the first pass trips: it never gets to full amplitude either.
    return {"verdict": "wrong", "measured_kg": None, "message": record.message}


def main() -> int:
    """Print the two shares and the hardest cases; 0 when both are as wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=100, help="of each kind")
    parser.add_argument("--bench", default="practical")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    shares = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        known = identification(folder, arguments.bench)
        for kind, wanted in (("right", "right"), ("wrong", "wrong")):
            hits, errors, tripped = 0, [], 0
            for number in range(arguments.stages):
                label = round(float(rng.uniform(LIGHTEST_KG, HEAVIEST_KG)), 3)
                side = rng.choice([-1.0, 1.0])
                factor = 1.0 + side * float(rng.uniform(LEAST_ERROR, 0.5)) if kind == "wrong" else 1.0
                hung = label * factor
                seed = 10_000 * (1 + (kind == "wrong")) + number
                found = verdict(folder, arguments.bench, known, label, hung, seed)
                hits += found["verdict"] == wanted
                measured = found["measured_kg"]
                errors += [] if measured is None else [float(str(measured)) / hung - 1.0]
                tripped += measured is None and found["verdict"] == "wrong"
                if found["verdict"] != wanted:
                    print(f"{kind}: label {label:.3f} kg, hung {hung:.3f} kg: {found['message']}")
            shares[kind] = hits / arguments.stages
            word = "accepted" if kind == "right" else "refused"
            print(
                f"{kind}: {hits} of {arguments.stages} {word} ({tripped} by a limit); error of the measured mass: "
                f"mean {np.mean(errors):+.2%}, sd {np.std(errors):.2%}, worst {np.max(np.abs(errors)):.2%}"
                if errors
                else f"{kind}: no weight could be measured"
            )
    return 0 if shares["right"] >= WANTED_ACCEPTED and shares["wrong"] >= WANTED_REFUSED else 1


if __name__ == "__main__":
    sys.exit(main())
