"""How a diagnosis grows with samples and with the catalogue: processor seconds and peak memory, as
ratios in one run.

One simulated bench that hides asymmetric viscous friction, recorded by the experiments of the blind
proof at 1 kHz. Each case is diagnosed in a process of its own, with one thread. The catalogue is
cut by declaring the other effects as physics of this bench, which keeps them from being sought.

    python benchmarks/diagnosis_growth.py --recordings 2 4 8 16 --effects 5 10 20 39
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Joint
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Dataset
from rig.common.tables import table
from rig.results.prove.draw import draw
from rig.results.prove.excitation import DURATION_S, experiments
from rig.results.prove.simulate import CAMPAIGN_FILE, campaign, write
from rig.sources import load_source

HIDDEN = "asymmetric_viscous"
FULL = 8
"""Recordings of the blind proof; cases of the catalogue have as many."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def record(folder: Path, recordings: int, seed: int) -> None:
    """Record so many experiments, unloaded and loaded in turn, and one to set aside."""
    fitted = [e for e in experiments() if e.role == "fit"]
    ordered = [fitted[k] for k in (0, 4, 1, 3, 6, 7, 5, 2)]
    turns = [ordered[k % len(ordered)] for k in range(recordings)]
    plan = [e._replace(name=f"{k:02d}{e.name}") for k, e in enumerate(turns)]
    plan.append(next(e for e in experiments() if e.role == "validate"))
    rig = draw("one", (HIDDEN,), (seed, 1))
    machine = replace(rig.machine, effects={HIDDEN: {"coefficient_Nms_rad": 0.5}})
    rig = rig._replace(machine=machine, pauses_s=(30.0,) * len(plan), gravity=False)
    write(folder, machine, campaign(rig, plan))


def subset(count: int) -> list[str]:
    """Return so many effects of the catalogue, spread over its groups, each set within the next
    larger one.

    What is hidden is in all of them, and so is the friction that only benches with a declared
    weight can show: declaring it would change the nominal model.
    """
    always = [HIDDEN, "load_dependent_friction"]
    others = [t.name for t in MOTION if t.name not in always]
    return (always + [others[k] for k in np.random.default_rng(0).permutation(len(others))])[:count]


def measure(folder: Path, names: list[str]) -> None:
    """Diagnose in this process with the effects of these names; print what it took as JSON."""
    dataset = load_source(folder / CAMPAIGN_FILE)
    others = tuple(t.name for t in MOTION if t.name not in names)
    model = replace(dataset.model, terms=(*dataset.model.terms, *others))
    screened = []

    def count(joint: Joint) -> None:
        context = Context(joint.equations[0].views, joint.nominal)
        screened.append(sum(len(t.shapes(context)) for t in MOTION if t.name in names))

    began = time.process_time()
    found = diagnose(
        Dataset(dataset.recordings, model), rng=np.random.default_rng(0), inspect=count
    )
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    named = ", ".join(e.name for e in found.effects) or found.verdict.value
    print(json.dumps({"seconds": seconds, "peak": peak, "shapes": screened[0], "named": named}))


def measured(folder: Path, names: list[str]) -> dict[str, Any]:
    """Return what one case takes in a process of its own."""
    command = [sys.executable, __file__, "--measure", str(folder), *names]
    told = subprocess.run(
        command, check=True, capture_output=True, text=True, env=os.environ | ONE_THREAD
    )
    return dict(json.loads(told.stdout))


def main() -> None:
    """Record, run every case in its own process, print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, nargs="+", default=[2, 4, 8, 16])
    parser.add_argument("--effects", type=int, nargs="+", default=[5, 10, 20, len(MOTION)])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--measure", nargs="+", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(Path(arguments.measure[0]), arguments.measure[1:])
        return
    everything = subset(len(MOTION))
    with tempfile.TemporaryDirectory() as scratch:
        folders = {n: Path(scratch) / str(n) for n in sorted({*arguments.recordings, FULL})}
        for recordings, folder in folders.items():
            record(folder, recordings, arguments.seed)
        measured(folders[min(folders)], everything)  # compiles what is not yet compiled
        full = measured(folders[FULL], everything)
        lengths = [
            (n, full if n == FULL else measured(folders[n], everything))
            for n in arguments.recordings
        ]
        sizes = [
            (n, full if n == len(everything) else measured(folders[FULL], subset(n)))
            for n in arguments.effects
        ]
    header = ["times the full one", "s", "peak GiB", "named"]
    print(
        f"full: {FULL} recordings of {DURATION_S:g} s at 1 kHz and one set aside, "
        f"{len(everything)} effects\n"
    )
    print(
        table(["recordings", *header], [[str(n), *_cells(c, full)] for n, c in lengths], range(4))
        + "\n"
    )
    rows = [[str(n), str(c["shapes"]), *_cells(c, full)] for n, c in sizes]
    print(table(["effects", "trial shapes", *header], rows, range(5)))


def _cells(case: dict[str, Any], full: dict[str, Any]) -> list[str]:
    ratio = case["seconds"] / full["seconds"]
    return [f"{ratio:.2f}", f"{case['seconds']:.1f}", f"{case['peak']:.2f}", case["named"]]


if __name__ == "__main__":
    main()
