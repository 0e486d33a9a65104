"""Long recordings: processor seconds and peak memory of the default method and of reading, over 1e4 to 3.6e7 samples.

3.6e7 are 10 h at 1 kHz. Half of the samples unloaded, half at 30.6 kg, 20 deg at 0.2 Hz; noise of the current and steps
of both sensors as on the practical bench, fresh throughout. They come from the cheap forward simulation of the nominal
model, are written as npz files and read back through a campaign, each size in a process of its own. Up to 2e5 samples
the in-memory path is run on the same data, and the greatest difference of a parameter is told in half widths of its
interval.

    python benchmarks/long_recording.py --sizes 1e4 1e5 1e6
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from identification.design.forward import respond, usual_loop
from identification.estimate import default
from identification.estimate.long import identify_long
from identification.model.nominal import NOMINAL
from identification.recording import Array, Bench
from rig.sources import load_source
from rig.tables import table

SIZES = (1e4, 1e5, 1e6, 4e6, 3.6e7)
IN_MEMORY = 200_000
PERIOD_S = 1e-3
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)
NOISE_A, QUANTUM_A, COUNT_RAD = 0.02, 0.015, 2.0 * np.pi / 4096.0
CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095}
defaults: {channels: {time: time, current: {column: current, average: true}, motor_angle: motor_angle}}
recordings:
  - {file: unloaded.npz, stage: unloaded}
  - {file: loaded.npz, stage: loaded, weight_mass: 30.6}
"""


def command(time: Array) -> Array:
    """Return 20 deg at 0.2 Hz, eased in over the first second, rad."""
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * np.clip(time, 0.0, 1.0))


def write(folder: Path, samples: int) -> None:
    """Simulate and write both recordings and their campaign."""
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    time_s = PERIOD_S * np.arange(samples // 2)
    for seed, (name, weight) in enumerate((("unloaded", 0.0), ("loaded", 30.6))):
        noise = NOISE_A * np.random.default_rng(seed).standard_normal(len(time_s))
        moment = BENCH.contact_force(weight) * 0.095
        out = respond(command(time_s), PERIOD_S, NOMINAL, moment, 2.0, usual_loop(NOMINAL["J"], 75.0))
        current = np.round((out.torque / 3.0 + noise) / QUANTUM_A) * QUANTUM_A
        angle = np.floor(out.angle * 100.0 / COUNT_RAD) * COUNT_RAD
        np.savez(folder / f"{name}.npz", time=time_s, current=current, motor_angle=angle)


def measure(folder: Path, path: str) -> None:
    """Read and identify in this process; print seconds, peak memory in GiB and the parameters as JSON."""
    began = time.process_time()
    dataset = load_source(folder / "campaign.yaml")
    read = time.process_time() - began
    result = default.identify(dataset) if path == "memory" else identify_long(dataset)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    parameters = {n: (p.value, p.low, p.high) for n, p in result.parameters.items()}
    seconds = time.process_time() - began
    print(json.dumps({"read": read, "seconds": seconds, "peak": peak, "parameters": parameters, "w": result.warnings}))


def main() -> None:
    """Run every size in its own process and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=float, nargs="+", default=SIZES)
    parser.add_argument("--measure", nargs=2, metavar=("FOLDER", "PATH"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(Path(arguments.measure[0]), arguments.measure[1])
        return
    rows = []
    for size in arguments.sizes:
        with tempfile.TemporaryDirectory() as scratch:
            write(Path(scratch), int(size))
            found = {}
            for path in ("pieces", "memory") if size <= IN_MEMORY else ("pieces",):
                told = subprocess.run(
                    [sys.executable, __file__, "--measure", scratch, path], check=True, capture_output=True, text=True
                )
                found[path] = json.loads(told.stdout)
        row = found["pieces"]
        apart = "-"
        if "memory" in found:
            pairs = zip(row["parameters"].values(), found["memory"]["parameters"].values(), strict=True)
            gaps = [abs(a[0] - b[0]) / (0.5 * (b[2] - b[1])) for a, b in pairs if None not in (*a, *b)]
            apart = f"{max(gaps):.3f}" if gaps else "-"
        rate = size / row["seconds"] / 1e3
        rows.append(
            [f"{size:.1e}", f"{row['seconds']:.1f}", f"{row['read']:.1f}", f"{rate:.0f}", f"{row['peak']:.2f}", apart]
        )
        print("row:", *rows[-1], *row["w"], flush=True)
    print(
        table(["samples", "s", "of that reading", "1000 samples/s", "peak GiB", "apart, half widths"], rows, range(6))
    )


if __name__ == "__main__":
    main()
