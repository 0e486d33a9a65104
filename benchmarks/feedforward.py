"""Tracking before and after friction feed-forward, on stiff and on soft gains, through the whole
simulated chain.

Each seed runs `figure10` on each of the two benches and identifies that bench's own log; then sines
and ramps follow there, with other noise, without feed-forward and with it. Errors of the identified
parameters are printed as well.

    python benchmarks/feedforward.py --seeds 8
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from identification.signals import Tracking, track
from rig.cli import entry as cli
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.planning.feedforward import load_feedforward
from rig.runs.recorded_inputs import true_parameters
from rig.runs.run import bench_constants

BENCHES = {"stiff": "practical", "soft": "practical_soft"}
"""Gains to the packaged bench that has them."""
RAMPS = {0.1: 0.5, 0.3: 4.0, 1.0: 6.0, 3.0: 8.0, 6.0: 12.0}
"""Speed, deg/s, to travel, deg.

A soft drive gives way by 1.7 deg before friction yields, by 5.2 deg under 3000 N.
"""
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
            f"  - {{name: {load}-sine, {head}, tones: [{{amplitude_deg: 20, frequency_Hz: 0.2}}], "
            f"duration_s: 12}}"
        )
        for speed, travel in RAMPS.items():
            ramp = f"{{travel_deg: {travel:g}, speed_deg_s: {speed:g}, rest_s: 0.5}}"
            duration = 2.0 * travel / speed + 1.0
            lines.append(
                f"  - {{name: {load}-ramp-{speed:g}, {head}, ramp: {ramp}, duration_s: "
                f"{duration:g}}}"
            )
    return "\n".join(lines) + "\n"


def identify(bench: str, seed: int, scratch: Path) -> Path:
    """Run `figure10` on a packaged bench, identify that run; return the result file."""
    own, found = scratch / f"{bench}-own", scratch / f"{bench}.json"
    for command in (
        ["run", "figure10", "--bench", bench, "--yes", "--seed", str(seed), "--out", str(own)],
        ["identify", str(own), "--out", str(scratch / f"{bench}-report"), "--json", str(found)],
    ):
        with contextlib.redirect_stdout(io.StringIO()):
            status = cli.status(command)
        if status:
            raise SystemExit(f"seed {seed}: rig {command[0]} on {bench} ended with status {status}")
    return found


def errors(found: Path, bench: str) -> Iterator[tuple[str, float | None, bool]]:
    """Yield each parameter, its error (None where it is left open) and whether the 90 % interval
    holds the truth.
    """
    machine = load_bench(bench).value.mock
    assert machine is not None
    truth = true_parameters(machine)
    for name, p in json.loads(found.read_text())["parameters"].items():
        if p["value"] is None:
            yield name, None, False
        else:
            yield name, p["value"] / truth[name] - 1.0, p["low"] <= truth[name] <= p["high"]


def compare(
    name: str, found: Path, seed: int, scratch: Path
) -> Iterator[tuple[str, Tracking, Tracking]]:
    """Yield each stage, and how it was followed before and after."""
    path = scratch / "tracking.yaml"
    path.write_text(sequence())
    plan = load_sequence(path)
    bench = load_bench(name)
    model = load_feedforward(found, bench_constants(bench.value))
    if model.remark:
        print(f"seed {seed}: {model.remark}")
    noise = seed + OTHER_NOISE
    before = run_simulated(bench, plan, noise, scratch / f"{name}-before")
    after = run_simulated(bench, plan, noise, scratch / f"{name}-after", model)
    for one, other in zip(before.recordings, after.recordings, strict=True):
        span = (FIRST_S, LAST_S) if one.name.endswith("sine") else (0.0, math.inf)
        yield one.name, track(one, *span), track(other, *span)


def known(off: Mapping[tuple[str, str], Sequence[tuple[float | None, bool]]]) -> list[list[str]]:
    """Return a row for each bench and parameter: seeds that leave it open, errors, intervals that
    hold the truth.
    """
    cells = []
    for (gains, name), seeds in off.items():
        sizes = [100.0 * abs(error) for error, _ in seeds if error is not None]
        spread = [f"{statistics.median(sizes):.3f}", f"{max(sizes):.3f}"] if sizes else ["", ""]
        held = sum(inside for _, inside in seeds)
        cells.append([gains, name, str(len(seeds) - len(sizes)), *spread, f"{held}/{len(sizes)}"])
    return cells


def main() -> None:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    started = time.perf_counter()
    rows: dict[tuple[str, str], list[tuple[Tracking, Tracking]]] = {}
    off: dict[tuple[str, str], list[tuple[float | None, bool]]] = {}
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        for gains, bench in BENCHES.items():
            with tempfile.TemporaryDirectory() as scratch:
                found = identify(bench, seed, Path(scratch))
                for name, error, held in errors(found, bench):
                    off.setdefault((gains, name), []).append((error, held))
                for stage, before, after in compare(bench, found, seed, Path(scratch)):
                    rows.setdefault((gains, stage), []).append((before, after))
    print(
        table(
            [
                "gains",
                "parameter",
                "open",
                "median error %",
                "worst %",
                "90 % interval holds truth",
            ],
            known(off),
        )
    )
    print()
    cells = []
    for (gains, stage), pairs in rows.items():
        gain = [before.rms / after.rms for before, after in pairs]
        cycles = (LAST_S - FIRST_S) / SINE_PERIOD_S if stage.endswith("sine") else 1.0
        mean_rms = [statistics.fmean(p[k].rms for p in pairs) for k in (0, 1)]
        cells.append(
            [
                gains,
                stage,
                *(f"{1e3 * statistics.median(p[k].rms for p in pairs):.4f}" for k in (0, 1)),
                f"{statistics.median(gain):.2f}",
                f"{min(gain):.2f}",
                f"{mean_rms[0] / mean_rms[1]:.2f}",
                *(f"{1e3 * max(p[k].largest for p in pairs):.2f}" for k in (0, 1)),
                *(f"{100.0 * statistics.median(p[k].waiting for p in pairs):.0f}" for k in (0, 1)),
                *(f"{statistics.median(p[k].energy for p in pairs) / cycles:.1f}" for k in (0, 1)),
            ]
        )
    header = [
        "gains",
        "stage",
        "rms mrad",
        "after",
        "ratio",
        "worst seed",
        "of means",
        "largest mrad",
        "after",
    ]
    print(table([*header, "waits %", "after", "energy J", "after"], cells, right=range(2, 13)))
    print(
        f"{arguments.seeds} seeds, {time.perf_counter() - started:.0f} s; energy per cycle (sine) "
        f"or ramp"
    )


if __name__ == "__main__":
    main()
