"""Investigates simulated machines with an injected effect, and compares with Figure 10 repeated.

``python -m benchmarks.investigations OUT [--seeds N] [--first SEED] [--only NAME] [--baseline]``
draws machines as ``rig prove`` does, gives each to ``rig investigate`` as a bench file, and prints
one row each and the counts. The bench file states what the simulated machine is; the investigation
sees only its recordings. A row that exists is not computed again.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

import yaml

from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.investigate.experiments import bench_seconds
from rig.investigate.investigation import judge
from rig.planning.plan import make_plan
from rig.results.prove.draw import draw

SINGLE = (
    *("asymmetric_coulomb", "current_offset", "asymmetric_viscous", "load_exponent"),
    *("inverter_dead_time", "brush_drop", "cogging", "torque_ripple", "gravity_imbalance"),
    *("return_spring", "backlash", "coupling_hysteresis", "transmission_efficiency"),
    *("load_dependent_friction", "current_loop_lag", "time_skew", "quadratic_drag"),
    *("stribeck_shape", "viscous_thermal_drift", "coulomb_drift", "end_stop"),
    *("position_dependent_friction", "encoder_eccentricity", "gear_mesh_ripple", "compliance"),
    "presliding",
)
MACHINES = (*((name, (name,)) for name in SINGLE), ("nothing", ()), ("nothing-2", ()))
BUDGET_MIN = 40
SEED = 71129


def bench_of(names: tuple[str, ...], seed: tuple[int, int], path: Path) -> None:
    """Write the bench file of a machine with these effects, of sizes that are drawn."""
    machine = asdict(draw("one" if names else "nothing", names, [SEED, *seed]).machine)
    plain = yaml.safe_load(resolve("practical", "benches").read_text())
    mock = plain["mock"]
    for section in ("motor", "joint", "sensing"):
        mock[section] = {key: machine[section][key] for key in mock[section]}
    for key in ("effects", "temperature_C"):
        mock[key] = machine[key]
    plain |= {"name": "bench", "mock": json.loads(json.dumps(mock))}
    path.write_text(yaml.safe_dump(plain))


def investigated(bench: Path, folder: Path, seed: int) -> dict[str, Any]:
    """Return the result of an investigation, computed once."""
    file = folder.with_suffix(".json")
    if not file.exists():
        words = ["investigate", "figure10", "--bench", str(bench), "--yes", "--out", str(folder)]
        status([*words, "--budget", str(BUDGET_MIN), "--json", str(file), "--seed", str(seed)])
    return dict(json.loads(file.read_text()))


def repeated(bench: Path, folder: Path, bench_s: float) -> list[str]:
    """Return what a diagnosis of Figure 10 identifies, repeated for at least as long."""
    each = bench_seconds(make_plan(load_sequence("figure10"), load_bench(bench)))
    runs = [folder.with_name(f"{folder.name}-f10-{k}") for k in range(math.ceil(bench_s / each))]
    for k, run in enumerate(runs):
        if not run.exists():
            words = ["run", "figure10", "--bench", str(bench), "--yes", "--out", str(run)]
            status([*words, "--seed", str(1000 + k)])
    found = judge(runs, 0, [], lambda *_: None).diagnosis
    return [found.verdict.value, *(e.name for e in found.effects)]


def main() -> None:
    """Investigate every machine, and print rows and counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--baseline", action="store_true")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for seed in range(asked.first, asked.first + asked.seeds):
        for number, (label, names) in enumerate(MACHINES):
            if asked.only and label not in asked.only.split(","):
                continue
            folder = asked.out / f"{label}-{seed}"
            bench = folder.with_suffix(".yaml")
            bench_of(names, (seed, number), bench)
            found = investigated(bench, folder, seed)
            identified = [e["name"] for e in found["effects"]]
            verdict, right = found["verdict"], identified == list(names)
            ok = right if names else verdict == "nothing_missing"
            state = "right" if ok and verdict != "ambiguous" else "open"
            if verdict == "named" and not right:
                state = "wrong"
            held = (found["confirmation"] or {}).get("band_held")
            row = [label, seed, state, verdict, "+".join(identified), len(found["experiments"])]
            row += [round(found["bench_seconds"] / 60.0, 1), held and round(held, 2)]
            if asked.baseline:
                row.append("+".join(repeated(bench, folder, found["bench_seconds"])))
            rows.append(row)
            print(*row, sep="\t", file=sys.stderr, flush=True)
    count = {s: sum(row[2] == s for row in rows) for s in ("right", "open", "wrong")}
    minutes = [row[6] for row in rows if row[2] == "right"]
    print(count, f"median {median(minutes):.1f} min" if minutes else "")


if __name__ == "__main__":
    main()
