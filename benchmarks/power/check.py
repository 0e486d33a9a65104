"""Compares what the map calls visible with what a diagnosis names, on rigs that were drawn anew.

python -m benchmarks.power.check out/power --seal out/power-check --rigs 20 --seed 4711
rig prove --from out/power-check --out out/power-proof
python -m benchmarks.power.check out/power --sealed out/power-check --proof out/power-proof
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.power.axes import AXES
from benchmarks.power.measure import shown_in
from benchmarks.power.sizes import injected, strength
from benchmarks.power.table import Key, Spread, machines_of, table
from rig.common.places import write_json
from rig.config.campaign import load_campaign
from rig.results.prove.engines.choice import engine
from rig.results.prove.interchange.folder import SealedRig, sealed_rigs
from rig.results.prove.interchange.sealing import seal_all
from rig.results.prove.mujoco_plant.plant import MujocoPlant, require_mujoco
from rig.results.prove.truth import load_truth
from rig.results.prove.worlds.draw import draw_world
from rig.results.prove.worlds.seal import seal_world

CHECK_FILE = "check.json"
FARTHEST = 1e6
"""Ratio in place of infinity, where an effect is not shown on one axis."""


def seal(home: Path, rigs: int, seed: int, jobs: int) -> None:
    """Seal rigs with one effect each, effects in random order."""
    require_mujoco()
    plant = MujocoPlant()
    rng = np.random.default_rng([seed, 0])
    names = [str(name) for name in rng.permutation(sorted(plant.effects))]
    drawn = [(k + 1, ("one", (names[k % len(names)],))) for k in range(rigs)]
    make = partial(seal_world, plant=plant, seed=seed)
    with engine(jobs, None, None) as shared_out:
        seal_all(home, drawn, make, shared_out, lambda what, share: click.echo(what))


def compared(
    rig: SealedRig,
    row: Mapping[str, Any],
    cells: dict[str, dict[Key, Spread]],
    before: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Return the size of a rig's effect over the least that can be seen, by its own recordings
    and by the map, beside the verdict.

    Args:
        rig: The rig.
        row: Its row in the proof.
        cells: The map.
        before: An earlier comparison of this rig, of which what its own recordings show is kept.
    """
    truth, content = load_truth(rig.truth), json.loads(rig.truth.read_text())
    ((effect, given),) = truth.effects.items()
    sections = load_campaign(rig.campaign).value.recordings
    masses = {float(getattr(r.weight_mass, "value", r.weight_mass)) for r in sections}
    labels = sorted(masses - {0.0})
    size = strength(effect, given, labels)
    if before is None:
        seen = shown_in(rig.reference)
        least = (seen["least"] or {}).get(effect)
        own = size / strength(effect, least, labels) if least else 0.0
        before = {"own": own, "alike": seen["alike"].get(effect, [])}
    world = draw_world("one", (effect,), content["maker"]["seed"])
    middle = injected(world, [effect])[effect]["strength"][1]
    expected = middle * predicted(cells[effect], truth.axes)
    return {
        "rig": rig.name,
        "sha256": rig.digest,
        "effect": effect,
        "own": before["own"],
        "map": size / expected if math.isfinite(expected) else 0.0,
        "alike": before["alike"],
        "verdict": row["verdict"],
        "named": [e["name"] for e in row["named"]],
        "first": bool(row["top1"]),
        "alias": bool(row["alias"]),
        "left": row["left"],
    }


def predicted(cells: Mapping[Key, Spread], axes: Mapping[str, Any]) -> float:
    """Return the map's least size over the middle injected one at a place in the world: the base
    world's, times the factor of each axis.
    """
    base = cells[("base", "base")].middle
    if not math.isfinite(base):
        return math.inf
    total = math.log(base)
    for axis, values in place_of(axes).items():
        logs = [math.log(min(cells[(axis, v)].middle / base, FARTHEST)) for v in values]
        total += float(np.mean(logs))
    return math.exp(total) if total < math.log(FARTHEST) else math.inf


def place_of(axes: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the values of the map's axes that are nearest to a world."""
    words = str(axes["encoders"]).replace(" and ", " ").split()
    bits = [int(words[k + 1]) for k, word in enumerate(words) if word == "joint"]
    loads = {"none": "none", "pendulum": "on the joint"}.get(str(axes["load"]))
    weights = min(max(int(axes["loads"]) - 1, 1), 3)
    return {
        "rate": [_nearest(AXES["rate"], float(axes["log_Hz"]))],
        **({"bits": [_nearest(AXES["bits"], float(2 ** bits[0]), base=2.0)]} if bits else {}),
        "encoders": ["both" if axes["two_encoders"] else words[0]],
        "loads": [loads or ("1 weight" if weights == 1 else f"{weights} weights")],
        "excitation": str(axes["motion"]).split(", "),
        "voltage": [str(axes["voltage"])],
    }


def _nearest(values: Sequence[str], wanted: float, base: float = 0.0) -> str:
    """Return the value that is nearest on a logarithmic scale."""

    def distance(value: str) -> float:
        number = float(value.split()[0])
        return abs(math.log((base**number if base else number) / wanted))

    return min(values, key=distance)


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--seal", "home", type=click.Path(path_type=Path, file_okay=False))
@click.option("--rigs", type=click.IntRange(min=1), default=20, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=4711, show_default=True)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--sealed", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--proof", type=click.Path(path_type=Path, file_okay=False, exists=True))
def main(
    out: Path,
    home: Path | None,
    rigs: int,
    seed: int,
    jobs: int,
    sealed: Path | None,
    proof: Path | None,
) -> None:
    """Seal new rigs, or compare their diagnoses with the map in OUT."""
    if home is not None:
        seal(home, rigs, seed, jobs)
    if sealed is None or proof is None:
        return
    cells = table(machines_of(out))
    file, found = out / CHECK_FILE, []
    earlier = json.loads(file.read_text())["rigs"] if file.is_file() else []
    kept = {r["sha256"]: r for r in earlier}
    for rig in sealed_rigs(sealed):
        scored = proof / "rows" / f"{rig.name}.json"
        if scored.is_file():
            row = json.loads(scored.read_text())
            found.append(compared(rig, row, cells, kept.get(rig.digest)))
            click.echo(json.dumps(found[-1]))
    write_json(file, {"rigs": found})


if __name__ == "__main__":
    main()
