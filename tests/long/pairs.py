"""Investigates machines that hide one effect of a pair which Figure 10 hardly tells apart.

python -m tests.long.pairs [--draws 5] [--seed 1] [--jobs 2] [--out out/pairs.json]

A draw is resolved if the hidden effect is named alone, and rightly left open if the verdict is
open, the hidden effect is in the group, and is in a pair of which the investigation says that
no experiment of the bench separates it. Draws that no experiment shows at three times the
noise are drawn again, at most :data:`TRIES` times, and then counted apart.
"""

import argparse
import json
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from identification.diagnosis.result import Verdict
from rig.config.bench import load_bench
from rig.investigate.investigation import State
from rig.investigate.proof import (
    BENCH,
    BUDGET_MIN,
    FIRST,
    SimulatedInvestigation,
    machine_on,
)
from rig.results.prove.draw import draw
from rig.results.prove.engine import Processes
from rig.results.prove.score import STRONG

PAIRS = (
    ("asymmetric_coulomb", "current_offset"),
    ("load_exponent", "wrong_weight"),
    ("inverter_dead_time", "brush_drop"),
    ("cogging", "torque_ripple"),
    ("gravity_imbalance", "return_spring"),
    ("backlash", "coupling_hysteresis"),
    ("transmission_efficiency", "load_dependent_friction"),
    ("current_loop_lag", "time_skew"),
    ("quadratic_drag", "stribeck_shape"),
    ("viscous_thermal_drift", "coulomb_drift"),
    ("end_stop", "position_dependent_friction"),
    ("encoder_eccentricity", "gear_mesh_ripple"),
)
WITHIN_A_RUN = frozenset({"wrong_weight"})
"""Effects that a simulated machine has in one recording of a campaign only, and not hidden here."""
TRIES = 4


class Draw(NamedTuple):
    """One hidden effect of a pair."""

    pair: tuple[str, str]
    hidden: str
    number: int


def draws(count: int) -> list[Draw]:
    """Return the draws: the effects of a pair in turn."""
    found = []
    for p, pair in enumerate(PAIRS):
        possible = [name for name in pair if name not in WITHIN_A_RUN]
        found += [Draw(pair, possible[k % len(possible)], 100 * p + k) for k in range(count)]
    return found


def investigated(one: Draw, seed: int) -> dict[str, Any]:
    """Investigate one draw; return its row."""
    bench = load_bench(BENCH)
    with tempfile.TemporaryDirectory() as folder:
        strength = 0.0
        for again in range(TRIES):
            hiding = draw("one", [one.hidden], (seed, one.number, again))._replace(gravity=False)
            state = State({"file": str(bench.path)}, seed + one.number, BUDGET_MIN, first=FIRST)
            machine = machine_on(bench.value, hiding.machine)
            run = SimulatedInvestigation(bench, Path(folder), state, machine)
            strength = run.strength()
            if strength >= STRONG:
                break
        judged, _ = run.run()
    diagnosis = judged.diagnosis
    names = [e.name for e in diagnosis.effects]
    group = {name for e in diagnosis.effects for name in e.alias_group}
    told = any(one.hidden in name for pair in state.cannot_separate for name in pair["names"])
    verdict = diagnosis.verdict
    result = "wrong" if verdict is Verdict.NAMED else "missed"
    if strength < STRONG:
        result = "not shown"
    elif verdict is Verdict.NAMED and names == [one.hidden]:
        result = "resolved"
    elif verdict is not Verdict.NOTHING_MISSING and result != "wrong":
        result = "told" if one.hidden in group and told else "open"
    return {
        "pair": one.pair,
        "hidden": one.hidden,
        "number": one.number,
        "strength": strength,
        "result": result,
        "verdict": verdict.value,
        "named": names,
        "group": sorted(group),
        "minutes": state.bench_seconds / 60.0,
        "experiments": len(state.experiments),
    }


def main() -> None:
    """Run all draws and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/pairs.json"))
    options = parser.parse_args()
    rows = []
    for row in Processes(options.jobs).each(
        partial(investigated, seed=options.seed), draws(options.draws)
    ):
        rows.append(row)
        print(
            f"{' | '.join(row['pair']):55} {row['hidden']:28} {row['strength']:8.1f} "
            f"{row['result']:10} {row['verdict']:18} {'+'.join(row['named'])}",
            flush=True,
        )
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(rows, indent=1))
    counts = {
        r: sum(row["result"] == r for row in rows) for r in sorted({r["result"] for r in rows})
    }
    print(f"{len(rows)} draws: {counts}")
    sys.exit(any(row["result"] == "wrong" for row in rows))


if __name__ == "__main__":
    main()
