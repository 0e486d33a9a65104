"""Runs a proof: seals every trial, shows the digests, then diagnoses, unseals and scores one trial
after another.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_json
from rig.common.places import write_json
from rig.results.prove.absorbed import FLOOR_SUFFIX
from rig.results.prove.excitation import experiments
from rig.results.prove.family import FAMILIES, MOTION
from rig.results.prove.generate import Sealed, place
from rig.results.prove.judge import Judge
from rig.results.prove.pool import each
from rig.results.prove.row import VERSION, row_of
from rig.results.prove.seal import unseal

PROOF_FILE = "proof.json"
ROWS = "rows"


class Proof(NamedTuple):
    """State of a proof.

    Attributes:
        out: Its folder.
        seed: Seed of draws and diagnosis.
        seals: Every trial, its truth sealed.
        family: Family of the trials, from :data:`rig.results.prove.family.FAMILIES`.
    """

    out: Path
    seed: int
    seals: tuple[Sealed, ...]
    family: str = MOTION

    def row_file(self, number: int) -> Path:
        """Return the path of the file with a trial's row."""
        return self.out / ROWS / f"{number:04d}.json"


def begin(out: Path, rigs: int, seed: int, family: str = MOTION) -> Proof:
    """Seal all trials, or continue a proof that was begun in this folder with the same settings.

    Raises:
        InputError: The folder holds a proof with other settings.
        OSError: It cannot be written.
    """
    settings = {"rigs": rigs, "seed": seed, "from": None, "family": family, "row_version": VERSION}
    file = out / PROOF_FILE
    if is_file(file):
        begun = seals_begun(file, settings)
        try:
            seals = tuple(place(out, int(number), digest) for number, digest in begun.items())
        except ValueError as error:
            raise InputError(f"{file}: damaged: {error}; give --out another folder") from error
        return Proof(out, seed, seals, family)
    for name in (ROWS, "diagnoses"):
        (out / name).mkdir(parents=True, exist_ok=True)
    made = FAMILIES[family]
    drawn = enumerate(made.assignment(rigs, seed), start=1)
    seals = tuple(made.seal(out, n, assigned, (seed, n)) for n, assigned in drawn)
    write_json(file, {"settings": settings, "seals": {str(s.number): s.digest for s in seals}})
    return Proof(out, seed, seals, family)


def seals_begun(file: Path, settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the seals of a proof that was begun before: number of a trial to digest.

    Raises:
        InputError: The file is not this program's, or belongs to a proof with other settings.
    """
    begun = read_json(file)
    try:
        found = begun["settings"]
        seals = {str(name): str(digest) for name, digest in begun["seals"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{file}: damaged: {error}; give --out another folder") from error
    if found != settings:
        raise InputError(
            f"{file}: this folder contains a proof with other settings, {found}; give --out "
            f"another one"
        )
    return seals


def work(
    proof: Proof, judge: Judge, jobs: int, keep: bool, progress: Callable[[str, float], None]
) -> list[dict[str, Any]]:
    """Diagnose and score the trials that have no row yet; return all rows in order.

    Args:
        proof: The proof as begun.
        judge: Judges a campaign; with more than one job it must be importable.
        jobs: Processes.
        keep: Whether recordings of trials drawn here stay after scoring.
        progress: Called with the label of a step and the share that is done.

    Raises:
        InputError: A truth was changed after it was sealed.
        OSError: A file cannot be written.
    """
    todo = [s for s in proof.seals if not is_file(proof.row_file(s.number))]
    done = len(proof.seals) - len(todo)
    one = partial(prove_rig, proof=proof, judge=judge, keep=keep)
    for finished in each(one, todo, jobs):
        done += 1
        progress(
            f"trial {finished} diagnosed, {done} of {len(proof.seals)}", done / len(proof.seals)
        )
    return [read_json(proof.row_file(s.number)) for s in proof.seals]


def prove_rig(sealed: Sealed, proof: Proof, judge: Judge, keep: bool) -> int:
    """Diagnose, unseal and score one trial; return its number.

    The truth is opened after the judgement.
    """
    family = FAMILIES[proof.family]
    assigned = family.assignment(len(proof.seals), proof.seed)[sealed.number - 1]
    strengths = family.simulate(sealed, assigned, (proof.seed, sealed.number))
    beside = sealed.truth.with_suffix(FLOOR_SUFFIX)
    floor = read_json(beside) if is_file(beside) else {}
    judgement = judge(sealed.campaign, diagnosis_seed(proof.seed, sealed.number))
    write_json(proof.out / "diagnoses" / f"{sealed.number:04d}.json", judgement.diagnosis)
    truth = unseal(sealed.truth, sealed.digest).record(sealed.number)
    oracle = judgement.oracle(list(truth["effects"])) if truth["kind"] in ("one", "two") else None
    names = [e.name for e in experiments()]
    write_json(
        proof.row_file(sealed.number),
        row_of(truth, strengths, judgement, oracle, sealed.digest, floor, names),
    )
    if not keep:
        shutil.rmtree(sealed.campaign.parent)
    return sealed.number


def diagnosis_seed(seed: int, number: int) -> int:
    """Return a seed for the diagnosis; the draws of the truth cannot be reproduced from this
    seed.
    """
    return int(np.random.SeedSequence([seed, number, 1]).generate_state(1)[0])
