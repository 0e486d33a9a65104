"""Writes trials of the project's own plant for other tools: campaigns and sealed truths."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rig.common.input_files import is_file
from rig.results.prove.draw import Assigned, assignment, draw
from rig.results.prove.excitation import experiments
from rig.results.prove.folder import write
from rig.results.prove.generate import truth_of
from rig.results.prove.interchange.folder import (
    PREFIX,
    SealedRig,
    place,
    sealed_rigs,
    write_sums,
    write_truth,
)
from rig.results.prove.pool import each
from rig.results.prove.simulate import campaign, reference_of, strength

Numbered = tuple[int, Assigned]


def seal_own(
    home: Path, rigs: int, seed: int, jobs: int, progress: Callable[[str, float], None]
) -> list[SealedRig]:
    """Draw, simulate and seal trials; return the trials with their digests. Nothing is diagnosed.

    Trials that are there already are kept, so that a call that was stopped can be repeated.

    Args:
        home: Folder of the sealed rigs.
        rigs: Number of trials.
        seed: Seed of the draws.
        jobs: Processes.
        progress: Called with the label of a step and the share that is done.

    Raises:
        OSError: It cannot be written.
    """
    todo = list(enumerate(assignment(rigs, seed), start=1))
    for done, name in enumerate(each(partial(_seal, home=home, seed=seed), todo, jobs), start=1):
        progress(f"{name} sealed, {done} of {rigs}", done / rigs)
    write_sums(home)
    return sealed_rigs(home)


def _seal(numbered: Numbered, home: Path, seed: int) -> str:
    """Simulate and seal one trial; return its name."""
    number, assigned = numbered
    where = place(home, f"{PREFIX}{number:04d}")
    if is_file(where.truth):
        return where.name
    rig = draw(*assigned, (seed, number))
    plan = experiments(rig.gravity)
    recorded = campaign(rig, plan)
    write(where.campaign.parent, rig.machine, recorded)
    truth: dict[str, Any] = truth_of(rig)
    if rig.machine.effects:
        reference = reference_of(rig, plan)
        write(where.reference.parent, rig.machine, reference)
        truth["strength"] = strength(recorded, reference)
    write_truth(where, truth)
    return where.name
