"""Run of the proof: seal every trial, show the digests, then diagnose, unseal and score one after
another.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_json
from rig.common.places import write_json
from rig.common.provenance import sha256_file
from rig.results.prove.absorbed import FLOOR_SUFFIX
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
        source: Folder of campaigns sealed by someone else; None where trials are drawn here.
        seed: Seed of draws and diagnosis.
        seals: Every trial, its truth sealed.
        family: Family of the trials, from :data:`rig.results.prove.family.FAMILIES`.
    """

    out: Path
    source: Path | None
    seed: int
    seals: tuple[Sealed, ...]
    family: str = MOTION

    def row_file(self, number: int) -> Path:
        """Return the file of a trial's row."""
        return self.out / ROWS / f"{number:04d}.json"


def begin(out: Path, rigs: int, seed: int, source: Path | None, family: str = MOTION) -> Proof:
    """Seal all trials, or continue a proof that was begun in this folder with the same settings.

    Raises:
        InputError: The folder contains a proof with other settings, or ``source`` contains no
            sealed campaigns.
        OSError: It cannot be written.
    """
    home = None if source is None else str(source.resolve())
    settings = {"rigs": rigs, "seed": seed, "from": home, "family": family, "row_version": VERSION}
    file = out / PROOF_FILE
    if is_file(file):
        return Proof(out, source, seed, _begun(file, settings, source or out), family)
    for name in (ROWS, "diagnoses"):
        (out / name).mkdir(parents=True, exist_ok=True)
    if source is None:
        made = FAMILIES[family]
        drawn = enumerate(made.assignment(rigs, seed), start=1)
        seals = tuple(made.seal(out, n, assigned, (seed, n)) for n, assigned in drawn)
    else:
        seals = tuple(_given(source))[:rigs]
        if not seals:
            raise InputError(
                f"{source}: no rig-NNNN/campaign.yaml with a sealed/NNNN.json; give --from such a "
                f"folder"
            )
    write_json(file, {"settings": settings, "seals": {str(s.number): s.digest for s in seals}})
    return Proof(out, source, seed, seals, family)


def _begun(file: Path, settings: Mapping[str, Any], home: Path) -> tuple[Sealed, ...]:
    """Return the trials of a proof that was begun before.

    Raises:
        InputError: The file is not this program's, or belongs to a proof with other settings.
    """
    begun = read_json(file)
    try:
        found = begun["settings"]
        seals = tuple(
            place(home, int(number), str(digest)) for number, digest in begun["seals"].items()
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{file}: damaged: {error}; give --out another folder") from error
    if found != settings:
        raise InputError(
            f"{file.parent}: contains a proof with other settings, {found}; give --out "
            "another folder"
        )
    return seals


def _given(source: Path) -> Iterator[Sealed]:
    """Yield the sealed campaigns of a folder."""
    for truth in sorted((source / "sealed").glob("[0-9]*.json")):
        if truth.stem.isdecimal():
            where = place(source, int(truth.stem))
            if is_file(where.campaign):
                try:
                    yield where._replace(digest=sha256_file(truth))
                except OSError as error:
                    raise InputError(f"{truth}: cannot be read: {error.strerror}") from error


def work(
    proof: Proof, judge: Judge, jobs: int, keep: bool, progress: Callable[[str, float], None]
) -> list[dict[str, Any]]:
    """Diagnose and score the trials that are not done yet; return all rows in order.

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
        progress(f"rig {finished} diagnosed, {done} of {len(proof.seals)}", done / len(proof.seals))
    return [read_json(proof.row_file(s.number)) for s in proof.seals]


def prove_rig(sealed: Sealed, proof: Proof, judge: Judge, keep: bool) -> int:
    """Diagnose, unseal and score one trial; return its number.

    The truth is opened after the judgement.
    """
    strengths: dict[str, float] = {}
    if proof.source is None:
        family = FAMILIES[proof.family]
        assigned = family.assignment(len(proof.seals), proof.seed)[sealed.number - 1]
        strengths = family.simulate(sealed, assigned, (proof.seed, sealed.number))
    else:
        beside = sealed.truth.with_suffix(".strength.json")
        if is_file(beside):
            strengths = read_json(beside)
    beside = sealed.truth.with_suffix(FLOOR_SUFFIX)
    floor = read_json(beside) if is_file(beside) else {}
    judgement = judge(sealed.campaign, _diagnosis_seed(proof.seed, sealed.number))
    write_json(proof.out / "diagnoses" / f"{sealed.number:04d}.json", judgement.diagnosis)
    truth = unseal(sealed.truth, sealed.digest)
    if missing := sorted({"rig", "kind", "effects"} - truth.keys()):
        raise InputError(f"{sealed.truth}: {', '.join(missing)}: missing in the sealed truth")
    oracle = judgement.oracle(list(truth["effects"])) if truth["kind"] in ("one", "two") else None
    write_json(
        proof.row_file(sealed.number),
        row_of(truth, strengths, judgement, oracle, sealed.digest, floor),
    )
    if proof.source is None and not keep:
        shutil.rmtree(sealed.campaign.parent)
    return sealed.number


def _diagnosis_seed(seed: int, number: int) -> int:
    """Return a seed for the diagnosis from which the draws of the truth cannot be repeated."""
    return int(np.random.SeedSequence([seed, number, 1]).generate_state(1)[0])
