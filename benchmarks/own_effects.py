"""Blind trials of effects of one's own: six effects of a file, each hidden in drawn benches of the
blind proof, and benches that hide nothing, diagnosed with the file.

Run from the root of the repository; a trial takes one to two minutes:

    python -m benchmarks.own_effects --rigs 5 --nothing 10 --out own.jsonl

A trial that the file of results has already is not repeated.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import stats

from identification.diagnosis.joint import Joint
from rig.results.diagnose.diagnose import diagnose_source
from rig.results.diagnose.own_effects import OwnFile, read_effects
from rig.results.prove.draw import Draw, Rig, draw, log
from rig.results.prove.excitation import experiments
from rig.results.prove.simulate import (
    campaign,
    floors_of,
    left_over,
    reference_of,
    residual_rms,
    strength,
    write,
)

FILE = Path(__file__).with_name("six_effects.py")
SIZES: Mapping[str, Mapping[str, Draw]] = {
    "root_drag": {"c": log(0.3, 6.0)},
    "cubic_spring": {"k": log(3.0, 150.0)},
    "speed_resonance": {
        "torque": log(0.3, 4.0), "speed": log(0.08, 0.6), "width": log(0.02, 0.06)
    },
    "loaded_drag": {"c": log(0.01, 0.2)},
    "lagged_drag": {"c": log(0.5, 6.0), "lag": log(0.05, 0.8)},
    "seal_drag": {"torque": log(0.3, 4.0), "travel": log(0.02, 0.3)},
}  # fmt: skip
VISIBLE = 3.0
"""Strength, over the noise, from which an effect counts."""


def trial(name: str, number: int, seed: int, own: OwnFile) -> dict[str, Any]:
    """Simulate a bench that hides an effect, or nothing with an empty name, and diagnose it."""
    place = list(SIZES).index(name) if name else len(SIZES)
    rig = draw("nothing", (), [seed, place, number])
    rng = np.random.default_rng([seed, place, number, 1])
    true = {key: size(rng) for key, size in SIZES[name].items()} if name else {}
    hidden = {name: true} if name else {}
    machine = replace(rig.machine, effects=hidden, effects_file=str(FILE) if name else "")
    rig = rig._replace(machine=machine)
    plan = experiments(rig.gravity)
    recorded = campaign(rig, plan)
    seen: list[Joint] = []
    with TemporaryDirectory() as folder:
        source = write(Path(folder), machine, recorded, packed=False)
        outcome = diagnose_source(source, number, inspect=seen.append, own=own)
    found = outcome.diagnosis
    return {
        "effect": name,
        "number": number,
        "true": true,
        **(_strengths(rig, recorded, plan, seen[0]) if name else {}),
        "verdict": found.verdict.value,
        "found": [
            {
                "name": e.name,
                "alias_group": list(e.alias_group),
                "confidence": e.confidence,
                "parameters": {n: [p.value, p.low, p.high] for n, p in e.parameters.items()},
            }
            for e in found.effects
        ],
        "seconds": found.seconds,
    }


def _strengths(rig: Rig, recorded: Any, plan: Any, first: Joint) -> dict[str, float]:
    """Return the strength of an effect, and the part that the nominal parameters leave."""
    reference = reference_of(rig, plan)
    with TemporaryDirectory() as folder:
        floors = floors_of(write(Path(folder), rig.machine, reference, packed=False))
    left = left_over(residual_rms(first), floors)
    strengths = strength(recorded, reference)
    return {"strength": max(strengths.values()), "left": max(left.values(), default=0.0)}


def rate(count: int, of: int) -> str:
    """Return a count with its 95 % interval by Wilson."""
    if not of:
        return "0 of 0"
    found = stats.binomtest(count, of).proportion_ci(0.95, "wilson")
    ends = f"{100.0 * found.low:.0f} to {100.0 * found.high:.0f}"
    return f"{count} of {of}, {100.0 * count / of:.0f} % ({ends})"


def summary(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the counts of all trials as lines."""
    hiding = [r for r in rows if r["effect"]]
    for name in (*SIZES, ""):
        own = [r for r in hiding if r["effect"] == name or not name]
        for key, words in (("strength", "strength 3 or more"), ("left", "remaining strength 3")):
            shown = [r for r in own if r[key] >= VISIBLE]
            first = [r for r in shown if r["found"] and r["found"][0]["name"] == r["effect"]]
            group = [r for r in shown if r["found"] and r["effect"] in r["found"][0]["alias_group"]]
            missed = [f"{r['effect']} {r['number']}" for r in shown if r not in group]
            yield (
                f"{name or 'all'}, {words}: first {rate(len(first), len(shown))}; in the alias "
                f"group {rate(len(group), len(shown))}; missed: {', '.join(missed) or 'none'}"
            )
    inside = [
        p[1] <= r["true"][n] <= p[2]
        for r in hiding
        for e in r["found"]
        if e["name"] == r["effect"]
        for n, p in e["parameters"].items()
    ]
    yield f"parameters within their 90 % interval: {rate(sum(inside), len(inside))}"
    nothing = [r for r in rows if not r["effect"]]
    alarms = [r for r in nothing if r["verdict"] != "nothing_missing"]
    named = ", ".join(str(r["number"]) for r in alarms) or "none"
    yield f"nothing hidden: alarms {rate(len(alarms), len(nothing))}: {named}"


def main() -> None:
    """Run the trials that the file of results lacks, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=5, help="trials of each effect")
    parser.add_argument("--nothing", type=int, default=10, help="trials that hide nothing")
    parser.add_argument("--only", default=None, help="one effect, or `nothing`")
    parser.add_argument("--seed", type=int, default=58)
    parser.add_argument("--out", type=Path, default=Path("own_effects.jsonl"))
    given = parser.parse_args()
    own = read_effects(FILE)
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {(r["effect"], r["number"]) for r in rows}
    wanted = [(name, k) for k in range(given.rigs) for name in SIZES]
    wanted += [("", k) for k in range(given.nothing)]
    only = None if given.only is None else given.only.replace("nothing", "")
    for name, number in wanted:
        if (name, number) in done or only not in (None, name):
            continue
        row = trial(name, number, given.seed, own)
        rows.append(row)
        with given.out.open("a") as stream:
            stream.write(json.dumps(row) + "\n")
        print(json.dumps(row), flush=True)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
