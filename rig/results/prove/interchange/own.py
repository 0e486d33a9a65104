"""Writes trials of the project's own plant for other tools: campaigns and sealed truths."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rig.results.prove.draw import assignment, draw
from rig.results.prove.engines import Engine
from rig.results.prove.excitation import experiments
from rig.results.prove.folder import write
from rig.results.prove.generate import truth_of
from rig.results.prove.interchange.folder import SealedRig, write_truth
from rig.results.prove.interchange.sealing import Made, Task, made, making, seal_all
from rig.results.prove.simulate import campaign, reference_of, strength


def seal_own(
    home: Path, rigs: int, seed: int, engine: Engine, progress: Callable[[str, float], None]
) -> list[SealedRig]:
    """Draw, simulate and seal trials; return the trials with their digests. Nothing is diagnosed.

    Trials that exist already are kept, so that a call that was stopped can be repeated.

    Args:
        home: Folder of the sealed rigs.
        rigs: Number of trials.
        seed: Seed of the draws.
        engine: Engine that does the work on the trials.
        progress: Called with the label of a step and the share that is done.

    Raises:
        InputError: Workers die repeatedly.
        OSError: A file cannot be written.
    """
    drawn = list(enumerate(assignment(rigs, seed), start=1))
    return seal_all(home, drawn, partial(_seal, seed=seed), engine, progress)


def _seal(task: Task, seed: int) -> Made:
    """Simulate and seal one trial in a temporary folder."""
    with making(task.number) as where:
        rig = draw(*task.assigned, (seed, task.number))
        plan = experiments(rig.gravity)
        recorded = campaign(rig, plan)
        write(where.campaign.parent, rig.machine, recorded)
        truth: dict[str, Any] = truth_of(rig)
        if rig.machine.effects:
            reference = reference_of(rig, plan)
            write(where.reference.parent, rig.machine, reference)
            truth["strength"] = strength(recorded, reference)
        write_truth(where, truth, task.salt)
        return made(where)
