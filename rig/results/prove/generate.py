"""Draws and seals blind trials, then simulates and writes them.

    python -m rig.results.prove.generate OUT --rigs 12 --seed 1

writes ``OUT/rig-0001/campaign.yaml`` and, in another folder, ``OUT/sealed/0001.json`` with the
truth and the strength of the injected effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import click

from rig.common.places import write_json
from rig.results.prove.draw import Kind, Rig, assignment, draw
from rig.results.prove.excitation import experiments
from rig.results.prove.simulate import (
    CAMPAIGN_FILE,
    FLOOR_SUFFIX,
    SETTLE_S,
    campaign,
    floors,
    reference_of,
    strength,
    write,
)
from rig.results.prove.truth import random_salt, seal, strangers
from rig.runs.recorded_inputs import true_parameters


class Sealed(NamedTuple):
    """Files and digest of one trial whose truth is sealed."""

    number: int
    campaign: Path
    truth: Path
    digest: str


def place(out: Path, number: int, digest: str = "") -> Sealed:
    """Return the file paths of the trial with this number."""
    return Sealed(
        number,
        out / f"rig-{number:04d}" / CAMPAIGN_FILE,
        out / "sealed" / f"{number:04d}.json",
        digest,
    )


def seal_rig(out: Path, number: int, rig: Rig, salt: str) -> Sealed:
    """Write and seal the truth of a trial; nothing is simulated yet.

    Raises:
        OSError: The truth cannot be written.
    """
    return seal_truth(out, number, truth_of(rig), salt)


def truth_of(rig: Rig) -> dict[str, Any]:
    """Return the sealed content of a trial."""
    maker = {
        "machine": asdict(rig.machine),
        "pauses_s": rig.pauses_s,
        "gravity": rig.gravity,
        "seed": rig.seed,
    }
    return {
        "effects": as_recorded(rig.machine.effects),
        "parameters": true_parameters(rig.machine),
        "maker": maker,
    }


def seal_truth(out: Path, number: int, truth: Mapping[str, Any], salt: str) -> Sealed:
    """Write and seal the truth of one trial.

    Raises:
        OSError: The truth cannot be written.
    """
    where = place(out, number)
    where.truth.parent.mkdir(parents=True, exist_ok=True)
    content = {"truth": 1, "rig": number, "outside": strangers(truth["effects"]), **truth}
    return where._replace(digest=seal(where.truth, content, salt))


def simulate_rig(where: Sealed, rig: Rig) -> dict[str, float]:
    """Simulate a trial, write its campaign, and return the strength of its effects in each channel.

    The noise floors of the trial's reference simulation are written next to its truth.

    Raises:
        OSError: A file cannot be written.
    """
    plan = experiments(rig.gravity)
    recorded = campaign(rig, plan)
    write(where.campaign.parent, rig.machine, recorded)
    if not rig.machine.effects:
        return {}
    reference = reference_of(rig, plan)
    write_json(where.truth.with_suffix(FLOOR_SUFFIX), floors(rig.machine, reference))
    return strength(recorded, reference)


def as_recorded(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return the injected effects with times counted from the start of a recording, as in the
    catalogue; the plant counts them from power-on, because a recording begins only after the
    machine has come to rest under power.
    """
    out = {name: dict(parameters) for name, parameters in effects.items()}
    if "encoder_slip" in out:
        out["encoder_slip"]["at_s"] -= SETTLE_S
    if "load_swing" in out:
        out["load_swing"]["fraction"] *= math.exp(-SETTLE_S / out["load_swing"]["decay_s"])
    return out


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--rigs", type=click.IntRange(min=1), default=12, show_default=True, help="Number of rigs."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the draws."
)
@click.option(
    "--only", multiple=True, help="Inject these effects in every trial, instead of drawing them."
)
def main(out: Path, rigs: int, seed: int, only: Sequence[str]) -> None:
    """Generate blind trials into OUT, without diagnosing them."""
    drawn: list[tuple[Kind, tuple[str, ...]]] = assignment(rigs, seed)
    if only:
        drawn = [("one" if len(only) == 1 else "two", tuple(only))] * rigs
    for number, (kind, names) in enumerate(drawn, start=1):
        rig = draw(kind, names, (seed, number))
        where = seal_rig(out, number, rig, random_salt())
        click.echo(f"{where.campaign}  {where.digest}")
        write_json(where.truth.with_suffix(".strength.json"), simulate_rig(where, rig))


if __name__ == "__main__":
    main()
