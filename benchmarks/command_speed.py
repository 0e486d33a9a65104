"""Seconds of whole commands: Figure 10 and a run of 240 s identified, eight recordings of 30 s
diagnosed; each as a multiple of one filter pass as well.

Each command runs in a process of its own, with its imports, figures and files. The filter pass goes
over all samples of the same source at the practical bench's values, in the process that has run the
command. Each command runs twice, and the faster run counts; the first one may compile kernels.
Elapsed seconds are those of a quiet machine only; the multiples, of processor time, hold on a busy
one as well.

    python benchmarks/command_speed.py
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path

import yaml
from diagnosis_growth import FULL, record

import rig.config.sequence
from drivers.mock.plant.parts.constants import Machine
from identification.filter.likelihood import Point, torque_noise
from identification.filter.segments import Noise, motion
from identification.model.parameters import pack
from identification.recording import Model
from rig.cli.entry import status
from rig.common.tables import table
from rig.results.prove.simulate import CAMPAIGN_FILE
from rig.runs.recorded_inputs import true_parameters
from rig.sources import load_source

LONG_S = 240.0
RUNS = 2
PASSES = 20
DEFAULT, LONG, DIAGNOSED = "Figure 10, 40 s", f"{LONG_S:g} s", f"{FULL} recordings of 30 s"
LIMITS_S = {DEFAULT: 4.0, LONG: 30.0, DIAGNOSED: 20.0}
"""Seconds that each command should take at most on two free cores."""


def measure(words: Sequence[str]) -> None:
    """Run a command on its source in this process; print what it and a filter pass take as JSON."""
    before = time.process_time(), time.perf_counter()
    with contextlib.redirect_stdout(sys.stderr):
        ended = status(list(words))
    if ended != 0:
        raise SystemExit(f"rig {' '.join(words)} ended with status {ended}")
    # Processor time of a process begins with its first import, elapsed time with the first line.
    cpu_s, elapsed_s = time.process_time(), time.perf_counter() - before[1] + before[0]
    run = _filter_pass(Path(words[1]))
    run()
    passes = []
    for _ in range(PASSES):
        began = time.process_time()
        run()
        passes.append(time.process_time() - began)
    print(json.dumps({"elapsed_s": elapsed_s, "cpu_s": cpu_s, "pass_s": min(passes)}))


def _filter_pass(source: Path) -> Callable[[], object]:
    """Return a function that filters all recordings of a source once."""
    motions = [m for m in map(motion, load_source(source).part("fit")) if m is not None]
    point = Point.of(
        motions, pack(true_parameters(Machine()), 2.0), [], Model(), Noise(torque_noise(motions))
    )
    # A filter does not repeat its last run.
    noises = cycle((point.noise, point.noise.louder(1.001)))
    return lambda: point.run(next(noises))


def sources(folder: Path) -> dict[str, list[str]]:
    """Record the sources on the simulated bench; return each command's words by its name."""
    figure10 = Path(rig.config.sequence.__file__).parent / "sequences" / "figure10.yaml"
    longer = yaml.safe_load(figure10.read_text(encoding="utf-8"))
    for stage in longer["stages"]:
        stage["duration_s"] = LONG_S / len(longer["stages"])
    (folder / "long.yaml").write_text(yaml.safe_dump(longer), encoding="utf-8")
    for sequence, out in (
        ("figure10", folder / "run"),
        (str(folder / "long.yaml"), folder / "240"),
    ):
        with contextlib.redirect_stdout(sys.stderr):
            ended = status(["run", sequence, "--yes", "--out", str(out)])
        if ended != 0:
            raise SystemExit(f"rig run {sequence} ended with status {ended}")
    record(folder / "diagnosed", FULL, 0)
    return {
        DEFAULT: ["identify", str(folder / "run")],
        LONG: ["identify", str(folder / "240")],
        DIAGNOSED: ["diagnose", str(folder / "diagnosed" / CAMPAIGN_FILE)],
    }


def row(name: str, words: Sequence[str], out: Path) -> list[str]:
    """Return the row of one command, the faster of its runs."""
    command = [sys.executable, __file__, "--measure", *words, "--out", str(out)]
    # One thread of the linear algebra, as the command line has.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    runs = []
    for _ in range(RUNS):
        told = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment)
        runs.append(json.loads(told.stdout.splitlines()[-1]))
    best = min(runs, key=lambda each: float(each["cpu_s"]))
    return [
        name,
        f"{best['elapsed_s']:.1f}",
        f"{LIMITS_S[name]:g}",
        f"{best['cpu_s']:.1f}",
        f"{1e3 * best['pass_s']:.1f}",
        f"{best['cpu_s'] / best['pass_s']:.0f}",
    ]


def main() -> None:
    """Record the sources, run every command, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=list(LIMITS_S), nargs="+", default=list(LIMITS_S))
    parser.add_argument("--measure", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(arguments.measure)
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        rows = [
            row(name, words, folder / f"out{k}")
            for k, (name, words) in enumerate(sources(folder).items())
            if name in arguments.only
        ]
    header = ["source", "elapsed s", "at most s", "processor s", "filter pass ms", "passes"]
    print(table(header, rows, range(1, len(header))))


if __name__ == "__main__":
    main()
