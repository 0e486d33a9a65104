"""Tracking before and after friction feed-forward, on stiff and on soft gains, through the whole simulated chain.

Each seed runs `figure10` on the practical bench and identifies that run's own log; then sines and ramps follow on
both gain sets, with other noise, without feed-forward and with it. The soft gains use the same identification: friction
belongs to the machine, and a log made with soft gains does not show its rise toward rest.

    python benchmarks/feedforward.py --seeds 8
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from identification.tracking import Tracking, track
from rig import cli
from rig.bench import load_bench
from rig.feedforward import load_feedforward
from rig.run import bench_constants
from rig.sequence import load_sequence
from rig.simulated_run import run_simulated
from rig.tables import table

RAMPS = {0.1: 0.5, 0.3: 4.0, 1.0: 6.0, 3.0: 8.0, 6.0: 12.0}
"""Speed, deg/s, to travel, deg. A soft drive gives way by 1.7 deg before friction yields, by 5.2 deg under 3000 N."""
SINE_PERIOD_S = 5.0
FIRST_S, LAST_S = 1.0, 11.0
"""Two whole cycles of the sine, between its ramps."""
OTHER_NOISE = 1000


def sequence() -> str:
    """Return the sequence: a sine and five ramps there and back, unloaded and with 30.6 kg."""
    lines = ["sequence: 1", "name: tracking", "stages:"]
    for load, weight in (("unloaded", 0.0), ("loaded", 30.6)):
        head = f"stage: {load}, weight_kg: {weight}"
        lines.append(
            f"  - {{name: {load}-sine, {head}, tones: [{{amplitude_deg: 20, frequency_Hz: 0.2}}], duration_s: 12}}"
        )
        for speed, travel in RAMPS.items():
            ramp = f"{{travel_deg: {travel:g}, speed_deg_s: {speed:g}, rest_s: 0.5}}"
            duration = 2.0 * travel / speed + 1.0
            lines.append(f"  - {{name: {load}-ramp-{speed:g}, {head}, ramp: {ramp}, duration_s: {duration:g}}}")
    return "\n".join(lines) + "\n"


def compare(seed: int, scratch: Path) -> Iterator[tuple[str, str, Tracking, Tracking]]:
    """Yield gains, stage, and how it was followed before and after."""
    found = scratch / "found.json"
    for command in (
        ["run", "figure10", "--yes", "--seed", str(seed), "--out", str(scratch / "own")],
        ["identify", str(scratch / "own"), "--out", str(scratch / "report"), "--json", str(found)],
    ):
        if status := cli.status(command):
            raise SystemExit(f"seed {seed}: rig {command[0]} ended with status {status}")
    path = scratch / "tracking.yaml"
    path.write_text(sequence())
    plan = load_sequence(path)
    for gains, name in (("stiff", "practical"), ("soft", "practical_soft")):
        bench = load_bench(name)
        model = load_feedforward(found, bench_constants(bench.value))
        noise = seed + OTHER_NOISE
        before = run_simulated(bench, plan, noise, scratch / f"{name}-before")
        after = run_simulated(bench, plan, noise, scratch / f"{name}-after", model)
        for one, other in zip(before.recordings, after.recordings, strict=True):
            span = (FIRST_S, LAST_S) if one.name.endswith("sine") else (0.0, math.inf)
            yield gains, one.name, track(one, *span), track(other, *span)


def main() -> None:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    started = time.perf_counter()
    rows: dict[tuple[str, str], list[tuple[Tracking, Tracking]]] = {}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        with tempfile.TemporaryDirectory() as scratch:
            for gains, stage, before, after in compare(seed, Path(scratch)):
                rows.setdefault((gains, stage), []).append((before, after))
    cells = []
    for (gains, stage), pairs in rows.items():
        gain = [before.rms / after.rms for before, after in pairs]
        cycles = (LAST_S - FIRST_S) / SINE_PERIOD_S if stage.endswith("sine") else 1.0
        cells.append(
            [
                gains,
                stage,
                *(f"{1e3 * statistics.median(p[k].rms for p in pairs):.4f}" for k in (0, 1)),
                f"{statistics.median(gain):.2f}",
                f"{min(gain):.2f}",
                f"{statistics.fmean(p[0].rms for p in pairs) / statistics.fmean(p[1].rms for p in pairs):.2f}",
                *(f"{1e3 * max(p[k].largest for p in pairs):.2f}" for k in (0, 1)),
                *(f"{100.0 * statistics.median(p[k].waiting for p in pairs):.0f}" for k in (0, 1)),
                *(f"{statistics.median(p[k].energy for p in pairs) / cycles:.1f}" for k in (0, 1)),
            ]
        )
    header = ["gains", "stage", "rms mrad", "after", "ratio", "worst seed", "of means", "largest mrad", "after"]
    print(table([*header, "waits %", "after", "energy J", "after"], cells, right=range(2, 13)))
    print(f"{arguments.seeds} seeds, {time.perf_counter() - started:.0f} s; energy per cycle (sine) or ramp")


if __name__ == "__main__":
    main()
