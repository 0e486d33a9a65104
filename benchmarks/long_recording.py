"""Long recordings: processor seconds and peak memory of the default method and of reading, over 1e4
to 3.6e7 samples.

3.6e7 are 10 h at 1 kHz. Half of the samples unloaded, half at 30.6 kg, 20 deg at 0.2 Hz; noise of
the current and steps of both sensors as on the practical bench, fresh throughout. They come from
the cheap forward simulation of the nominal model and are read back from npz files through a
campaign, or with ``--run`` from a run folder, where every cycle has its sample and eight frames;
each size in a process of its own. Up to 2e5 samples the in-memory path is run on the same data, and
the greatest difference of a parameter is told in half widths of its interval.

    python benchmarks/long_recording.py --sizes 1e4 1e5 1e6 --run
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

from drivers.interfaces import RawFrame
from identification.estimate.default import identify
from identification.model.parameters import NOMINAL
from identification.recording import Array, Bench
from identification.simulation.drive_loop import respond, usual_loop
from rig.common.sample import Sample
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.runs.recorder import Recorder
from rig.sources import load_source

SIZES = (1e4, 1e5, 1e6, 1e7, 3.6e7)
IN_MEMORY = 200_000
PERIOD_S = 1e-3
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)
NOISE_A, QUANTUM_A, COUNT_RAD = 0.02, 0.015, 2.0 * np.pi / 4096.0
STAGES = (("unloaded", 0.0), ("loaded", 30.6))
FRAMES = [RawFrame(0, identifier, bytes(8), identifier == 0x80) for identifier in range(0x80, 0x88)]
CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095}
defaults:
  channels: {time: time, current: {column: current, average: true}, motor_angle: motor_angle}
recordings:
  - {file: unloaded.npz, stage: unloaded}
  - {file: loaded.npz, stage: loaded, weight_mass: 30.6}
"""


def command(time: Array) -> Array:
    """Return 20 deg at 0.2 Hz, eased in over the first second, rad."""
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * np.clip(time, 0.0, 1.0))


def simulated(samples: int, seed: int, weight: float) -> dict[str, Array]:
    """Return time, command, current and motor angle of one stage."""
    time_s = PERIOD_S * np.arange(samples)
    noise = NOISE_A * np.random.default_rng(seed).standard_normal(samples)
    moment = BENCH.contact_force(weight) * 0.095
    out = respond(command(time_s), PERIOD_S, NOMINAL, moment, 2.0, usual_loop(NOMINAL["J"], 75.0))
    current = np.round((out.torque / 3.0 + noise) / QUANTUM_A) * QUANTUM_A
    angle = np.floor(out.angle * 100.0 / COUNT_RAD) * COUNT_RAD
    return {"time": time_s, "command": command(time_s), "current": current, "motor_angle": angle}


def write(folder: Path, samples: int) -> None:
    """Write both recordings as arrays, and their campaign."""
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    for seed, (name, weight) in enumerate(STAGES):
        out = simulated(samples // 2, seed, weight)
        del out["command"]
        np.savez(folder / f"{name}.npz", **out)


def write_run(folder: Path, samples: int) -> None:
    """Write both recordings as a run: that of a short one on the practical bench, its recording
    replaced.
    """
    short = folder / "short"
    run_simulated(load_bench("practical"), load_sequence("figure10"), 0, short)
    (folder / "run").mkdir()
    record = json.loads((short / "run.json").read_text())
    with (folder / "run" / "recording.mcap").open("xb") as stream:
        recorder = Recorder(stream)
        start = 0.0
        for seed, ((_, weight), segment) in enumerate(zip(STAGES, record["segments"], strict=True)):
            out = simulated(samples // 2, seed, weight)
            segment |= {"samples": samples // 2, "start": start, "weight_kg": weight}
            for k in range(samples // 2):
                now = start + out["time"][k]
                command_rad, current, motor = (
                    out["command"][k],
                    out["current"][k],
                    out["motor_angle"][k],
                )
                angle = motor / BENCH.gear_ratio
                rest = (angle, 0.0, current, 0.0, 48.0, 25.0, 0.0, 0x237, segment["index"], True)
                sample = Sample(now, now + 4e-4, now, now, command_rad, motor, *rest)
                recorder.sample(round(1e9 * now), sample, FRAMES)
            start = now + 1.0
            segment["end"] = now
        recorder.close()
    (folder / "run" / "run.json").write_text(json.dumps(record))


def measure(folder: Path, path: str) -> None:
    """Read and identify in this process; print seconds, peak memory in GiB and the parameters as
    JSON.
    """
    began = time.process_time()
    run = folder / "run"
    dataset = load_source(run if run.is_dir() else folder / "campaign.yaml")
    read = time.process_time() - began
    result = identify(dataset, in_pieces=path != "memory")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    parameters = {n: (p.value, p.low, p.high) for n, p in result.parameters.items()}
    seconds = time.process_time() - began
    print(
        json.dumps(
            {
                "read": read,
                "seconds": seconds,
                "peak": peak,
                "parameters": parameters,
                "w": result.warnings,
            }
        )
    )


def main() -> None:
    """Run every size in its own process and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=float, nargs="+", default=SIZES)
    parser.add_argument("--run", action="store_true", help="from a run folder instead of npz files")
    parser.add_argument("--measure", nargs=2, metavar=("FOLDER", "PATH"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        measure(Path(arguments.measure[0]), arguments.measure[1])
        return
    rows = []
    for size in arguments.sizes:
        with tempfile.TemporaryDirectory() as scratch:
            (write_run if arguments.run else write)(Path(scratch), int(size))
            found = {}
            for path in ("pieces", "memory") if size <= IN_MEMORY else ("pieces",):
                told = subprocess.run(
                    [sys.executable, __file__, "--measure", scratch, path],
                    check=True,
                    capture_output=True,
                    text=True,
                )
                found[path] = json.loads(told.stdout)
        row = found["pieces"]
        apart = "-"
        if "memory" in found:
            pairs = zip(
                row["parameters"].values(), found["memory"]["parameters"].values(), strict=True
            )
            gaps = [
                abs(a[0] - b[0]) / (0.5 * (b[2] - b[1])) for a, b in pairs if None not in (*a, *b)
            ]
            apart = f"{max(gaps):.3f}" if gaps else "-"
        rate = size / row["seconds"] / 1e3
        rows.append(
            [
                f"{size:.1e}",
                f"{row['seconds']:.1f}",
                f"{row['read']:.1f}",
                f"{rate:.0f}",
                f"{row['peak']:.2f}",
                apart,
            ]
        )
        print("row:", *rows[-1], *row["w"], flush=True)
    print(
        table(
            ["samples", "s", "of that reading", "1000 samples/s", "peak GiB", "apart, half widths"],
            rows,
            range(6),
        )
    )


if __name__ == "__main__":
    main()
