"""Runs a proof: seals every trial, shows the digests, then diagnoses, unseals and scores one trial
after another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from rig.common.errors import InputError
from rig.common.places import is_file, read_json, read_utf8, write_json, write_text
from rig.common.provenance import sha256_file
from rig.results.prove.draw import Assigned, assignment, draw
from rig.results.prove.engine import Engine, Files, read_folder, without_place, write_folder
from rig.results.prove.excitation import experiments
from rig.results.prove.gas_simulate import gas_assignment, seal_gas, simulate_gas
from rig.results.prove.generate import Sealed, place, seal_rig, simulate_rig
from rig.results.prove.judge import Judge
from rig.results.prove.row import VERSION, row_of
from rig.results.prove.simulate import FLOOR_SUFFIX
from rig.results.prove.truth import repeated_salt, sealed_content, unseal

SUMS_FILE = "SHA256SUMS"


def write_sums(home: Path, parts: Sequence[str] = (".",)) -> Path:
    """Write the digest of every file of the folder; return the path of the list.

    Raises:
        OSError: The list cannot be written.
    """
    path = home / SUMS_FILE
    found = {f for part in parts for f in (home / part, *(home / part).rglob("*"))}
    files = sorted(f for f in found if is_file(f) and f != path)
    lines = [f"{sha256_file(file)}  {file.relative_to(home).as_posix()}" for file in files]
    write_text(path, "\n".join(lines) + "\n")
    return path


def check_sums(home: Path) -> None:
    """Compare the files of the folder with its list of digests; without a list nothing is checked.

    Raises:
        InputError: A file is missing, or its digest differs from the listed digest; the message
            names all files with an error.
    """
    path = home / SUMS_FILE
    if not is_file(path):
        return
    problems = []
    for number, line in enumerate(read_utf8(path).splitlines(), start=1):
        digest, _, name = line.partition(" ")
        file = home / name.strip().removeprefix("*")
        try:
            found = sha256_file(file)
        except OSError as error:
            problems.append(f"{path}:{number}: {name.strip()}: cannot be read: {error.strerror}")
            continue
        if found != digest:
            problems.append(
                f"{path}:{number}: {name.strip()}: SHA-256 is {found}, listed is {digest}; the "
                f"file was changed"
            )
    if problems:
        raise InputError(problems)


TIMES = "times"
"""Folder of a proof with date and durations of every trial, which differ if a proof is repeated."""
FIELDS = ("created", "seconds", "baseline_seconds")


def without_times(record: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a record without date and durations, and a record of date and durations alone."""
    kept = {name: value for name, value in record.items() if name not in FIELDS}
    return kept, {name: record[name] for name in FIELDS if name in record}


def timed_row(out: Path, name: str) -> dict[str, Any]:
    """Return the row of a trial with its durations.

    Raises:
        InputError: A file is missing or damaged.
    """
    row = dict(read_json(out / "rows" / f"{name}.json"))
    beside = out / TIMES / f"{name}.json"
    spent = read_json(beside) if is_file(beside) else {}
    return row | {key: spent.get(key, row.get(key, 0.0)) for key in FIELDS if key != "created"}


Seed = Sequence[int]


class Family(NamedTuple):
    """Functions that make the trials of one proof.

    Attributes:
        assignment: Function of number of trials and seed; returns kind and effects of each trial.
        seal: Function of folder, number, kind and effects, and seed; returns the sealed trial.
        simulate: Function of sealed trial, kind and effects, and seed; writes the campaign and
            returns the strength by channel.
    """

    assignment: Callable[[int, int], list[Assigned]]
    seal: Callable[[Path, int, Assigned, Seed], Sealed]
    simulate: Callable[[Sealed, Assigned, Seed], dict[str, float]]


def _seal_motion(out: Path, number: int, assigned: Assigned, seed: Seed) -> Sealed:
    return seal_rig(out, number, draw(*assigned, seed), repeated_salt(*seed))


def _simulate_motion(where: Sealed, assigned: Assigned, seed: Seed) -> dict[str, float]:
    return simulate_rig(where, draw(*assigned, seed))


MOTION, GAS = "motion", "gas"
FAMILIES: Mapping[str, Family] = {
    MOTION: Family(assignment, _seal_motion, _simulate_motion),
    GAS: Family(gas_assignment, seal_gas, simulate_gas),
}


PROOF_FILE = "proof.json"
ROWS, DIAGNOSES = "rows", "diagnoses"
REPEATED = (PROOF_FILE, "sealed", DIAGNOSES, "judgements", ROWS)
"""Files and folders of a proof whose bytes depend on the settings of the proof alone."""


class Proof(NamedTuple):
    """State of a proof."""

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
        OSError: A file cannot be written.
    """
    settings = {"rigs": rigs, "seed": seed, "from": None, "family": family, "row_version": VERSION}
    file = out / PROOF_FILE
    if is_file(file):
        begun = seals_begun(file, settings)
        try:
            seals = tuple(place(out, int(number), digest) for number, digest in begun.items())
        except ValueError as error:
            raise InputError(f"{file}: damaged: {error}; give --out another folder") from error
        _make_folders(out)
        return Proof(out, seed, seals, family)
    _make_folders(out)
    made = FAMILIES[family]
    drawn = enumerate(made.assignment(rigs, seed), start=1)
    seals = tuple(made.seal(out, n, assigned, (seed, n)) for n, assigned in drawn)
    write_json(file, {"settings": settings, "seals": {str(s.number): s.digest for s in seals}})
    return Proof(out, seed, seals, family)


def _make_folders(out: Path) -> None:
    """Make the folders of a proof, of which a copied or older proof may lack some."""
    for name in (ROWS, DIAGNOSES, TIMES):
        (out / name).mkdir(parents=True, exist_ok=True)


def seals_begun(file: Path, settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the seals of a proof that was begun earlier: the digest of each trial, by its number.

    Raises:
        InputError: The file is not by this program, or belongs to a proof with other settings.
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
            "another folder"
        )
    return seals


class Trial(NamedTuple):
    """One trial as it is sent to a worker.

    Attributes:
        number: Number of the trial, from 1.
        assigned: Kind and effects.
        sealed: Content of the sealed truth, which the worker writes to its disk, and reads, only
            after the diagnosis.
        truth: Path of the sealed truth where the proof was begun, for messages.
        digest: SHA-256 of the sealed truth.
    """

    number: int
    assigned: Assigned
    sealed: bytes
    truth: Path
    digest: str


class Proved(NamedTuple):
    """Result of one trial as a worker returns it."""

    number: int
    diagnosis: Mapping[str, Any]
    row: Mapping[str, Any]
    times: Mapping[str, Any]
    floor: Mapping[str, float]
    files: Files


def work(
    proof: Proof, judge: Judge, engine: Engine, keep: bool, progress: Callable[[str, float], None]
) -> list[dict[str, Any]]:
    """Diagnose and score the trials that have no row yet; return all rows in order.

    Raises:
        InputError: A truth was changed after it was sealed, or workers die repeatedly.
        OSError: A file cannot be written.
    """
    assigned = FAMILIES[proof.family].assignment(len(proof.seals), proof.seed)
    todo = [s for s in proof.seals if not is_file(proof.row_file(s.number))]
    done = len(proof.seals) - len(todo)
    trials = (
        Trial(s.number, assigned[s.number - 1], sealed_content(s.truth), s.truth, s.digest)
        for s in todo
    )
    one = partial(prove_trial, seed=proof.seed, family=proof.family, judge=judge, keep=keep)
    for proved in engine.each(one, trials):
        _store(proof, proved)
        done += 1
        progress(
            f"trial {proved.number} diagnosed, {done} of {len(proof.seals)}",
            done / len(proof.seals),
        )
    write_sums(proof.out, REPEATED)
    names = [f"{s.number:04d}" for s in proof.seals]
    return [timed_row(proof.out, name) for name in names]


def prove_trial(trial: Trial, seed: int, family: str, judge: Judge, keep: bool) -> Proved:
    """Simulate, diagnose, unseal and score one trial in a temporary folder.

    The result depends on the arguments alone, except for its date and durations. The truth is
    opened after the judgement.

    Raises:
        InputError: The truth was changed after it was sealed.
        OSError: The temporary folder cannot be written.
    """
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        home = Path(scratch)
        sealed = place(home, trial.number, trial.digest)
        sealed.truth.parent.mkdir()
        strengths = FAMILIES[family].simulate(sealed, trial.assigned, (seed, trial.number))
        beside = sealed.truth.with_suffix(FLOOR_SUFFIX)
        floor = read_json(beside) if is_file(beside) else {}
        judgement = judge(sealed.campaign, diagnosis_seed(seed, trial.number))
        sealed.truth.write_bytes(trial.sealed)
        try:
            truth = unseal(sealed.truth, sealed.digest).record(trial.number)
        except InputError as error:
            moved = (p.replace(str(sealed.truth), str(trial.truth)) for p in error.problems)
            raise InputError(moved) from error
        asked = truth["kind"] in ("one", "two")
        oracle = judgement.oracle(list(truth["effects"])) if asked else None
        names = [e.name for e in experiments()]
        row = row_of(truth, strengths, judgement, oracle, sealed.digest, floor, names)
        folder = sealed.campaign.parent
        diagnosis, times = without_times(without_place(judgement.diagnosis, folder))
        row, spent = without_times(row)
        kept = read_folder(folder) if keep else {}
    return Proved(trial.number, diagnosis, row, times | spent, floor, kept)


def _store(proof: Proof, proved: Proved) -> None:
    """Write the files of one trial; the row is written last, because it marks the trial as done."""
    where = place(proof.out, proved.number)
    name = f"{proved.number:04d}.json"
    write_folder(where.campaign.parent, proved.files)
    if proved.floor:
        write_json(where.truth.with_suffix(FLOOR_SUFFIX), proved.floor)
    write_json(proof.out / DIAGNOSES / name, proved.diagnosis)
    write_json(proof.out / TIMES / name, proved.times)
    write_json(proof.row_file(proved.number), proved.row)


def diagnosis_seed(seed: int, number: int) -> int:
    """Return the seed of a trial's diagnosis, from which the draws of the truth cannot be
    reproduced.
    """
    return int(np.random.SeedSequence([seed, number, 1]).generate_state(1)[0])
