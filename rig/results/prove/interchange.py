"""Sealed rigs as plain files: any simulator can write sealed rigs; this package diagnoses the rigs,
opens their truths and scores the diagnoses.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.places import is_file, read_json, write_json
from rig.common.provenance import sha256_file
from rig.config.campaign import load_campaign
from rig.results.prove.draw import Assigned, assignment, draw
from rig.results.prove.engine import (
    Bundle,
    Engine,
    Files,
    bundle,
    read_folder,
    unpacked,
    without_place,
    write_folder,
)
from rig.results.prove.excitation import experiments
from rig.results.prove.generate import truth_of
from rig.results.prove.judge import Judge, Judgement
from rig.results.prove.row import REFUSED, VERSION, row_of
from rig.results.prove.run import (
    DIAGNOSES,
    PROOF_FILE,
    REPEATED,
    ROWS,
    TIMES,
    check_sums,
    diagnosis_seed,
    seals_begun,
    timed_row,
    without_times,
    write_sums,
)
from rig.results.prove.simulate import CAMPAIGN_FILE, campaign, reference_of, strength, write
from rig.results.prove.truth import Truth, random_salt, seal, strangers, unseal

SEALED = "sealed"
REFERENCE = ".reference"
SUFFIXES = (".yaml", ".yml", ".json")
PREFIX = "rig-"
"""Name of a rig's folder if the file of its truth is named by a number, as ``rig prove`` writes
it.
"""


class SealedRig(NamedTuple):
    """One rig of a folder of sealed rigs.

    Attributes:
        name: Name of the rig's folder.
        campaign: Campaign file.
        truth: File of the truth.
        reference: Campaign file of the rig without its effects; this file need not exist.
        digest: SHA-256 of the truth's file.
    """

    name: str
    campaign: Path
    truth: Path
    reference: Path
    digest: str = ""


def place(home: Path, name: str) -> SealedRig:
    """Return the paths of the files of the sealed rig with this name."""
    sealed = home / SEALED
    return SealedRig(
        name,
        home / name / CAMPAIGN_FILE,
        sealed / f"{name}.json",
        sealed / f"{name}{REFERENCE}" / CAMPAIGN_FILE,
    )


def sealed_rigs(home: Path) -> list[SealedRig]:
    """Return the rigs of a folder in order of their names, with the digests of their truths.

    Raises:
        InputError: The folder has no rigs, or a truth cannot be read.
    """
    found = list(_found(home))
    if not found:
        raise InputError(
            f"{home}: no NAME/{CAMPAIGN_FILE} with a {SEALED}/NAME.yaml or {SEALED}/NAME.json; "
            f"give --from a folder of sealed rigs (docs/guides/worlds.md)"
        )
    return found


def _found(home: Path) -> Iterator[SealedRig]:
    for truth in sorted((home / SEALED).glob("*")):
        if truth.suffix not in SUFFIXES or truth.name.startswith("."):
            continue
        for name in (truth.stem, PREFIX + truth.stem):
            rig = place(home, name)
            if is_file(rig.campaign):
                try:
                    yield rig._replace(truth=truth, digest=sha256_file(truth))
                except OSError as error:
                    raise InputError(f"{truth}: cannot be read: {error.strerror}") from error
                break


def write_truth(where: SealedRig, truth: Mapping[str, Any], salt: str) -> None:
    """Write the truth of a rig with a salt.

    Raises:
        OSError: The truth cannot be written.
    """
    where.truth.parent.mkdir(parents=True, exist_ok=True)
    content = {"truth": 1, "rig": where.name, "outside": strangers(truth["effects"]), **truth}
    seal(where.truth, content, salt)


class Task(NamedTuple):
    """One rig to make."""

    number: int
    assigned: Assigned
    salt: str


class Made(NamedTuple):
    """One rig that was made.

    Attributes:
        name: Name of the rig.
        files: Files of the rig, by paths relative to the folder of sealed rigs; the truth is last.
    """

    name: str
    files: Files


def seal_all(
    home: Path,
    drawn: Sequence[tuple[int, Assigned]],
    one: Callable[[Task], Made],
    engine: Engine,
    progress: Callable[[str, float], None],
    salt: Callable[[int], str] = random_salt,
) -> list[SealedRig]:
    """Make and write the rigs that do not exist yet; return all rigs with their digests.

    Raises:
        InputError: Workers die repeatedly.
        OSError: A file cannot be written.
    """
    todo = [
        Task(n, assigned, salt(n))
        for n, assigned in drawn
        if not is_file(place(home, _name(n)).truth)
    ]
    done = len(drawn) - len(todo)
    for rig in engine.each(one, todo):
        write_folder(home, rig.files)
        done += 1
        progress(f"{rig.name} sealed, {done} of {len(drawn)}", done / len(drawn))
    write_sums(home)
    return sealed_rigs(home)


@contextmanager
def making(number: int) -> Iterator[SealedRig]:
    """Yield the paths of a rig in a temporary folder."""
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        yield place(Path(scratch), _name(number))


def made(where: SealedRig) -> Made:
    """Return the files of a rig that was written into a temporary folder."""
    files = read_folder(where.campaign.parents[1])
    truth = f"{SEALED}/{where.truth.name}"
    return Made(where.name, {**{k: v for k, v in files.items() if k != truth}, truth: files[truth]})


def _name(number: int) -> str:
    return f"{PREFIX}{number:04d}"


def seal_own(
    home: Path, rigs: int, seed: int, engine: Engine, progress: Callable[[str, float], None]
) -> list[SealedRig]:
    """Draw, simulate and seal trials; return the trials with their digests. Nothing is diagnosed.

    Trials that exist already are kept, so that a call that was stopped can be repeated.

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


JUDGEMENTS = "judgements"
Oracle = Callable[[Path, Sequence[str]], Mapping[str, Any] | None]
"""Function of campaign file and true names; returns the errors with the true structure, or None."""
Floors = Callable[[Path], Mapping[str, float]]
"""Function of the campaign file of a rig without effects; returns the residual of the nominal model
in each equation.
"""
Progress = Callable[[str, float], None]


class FromProof(NamedTuple):
    """State of a proof of sealed rigs."""

    out: Path
    seed: int
    rigs: tuple[SealedRig, ...]

    def file(self, folder: str, rig: SealedRig) -> Path:
        """Return the path of the file of a rig in a folder of the proof."""
        return self.out / folder / f"{rig.name}.json"


def begin_from(out: Path, rigs: int, seed: int, source: Path) -> FromProof:
    """Read the seals of a folder, or continue a proof that began with these seals.

    Raises:
        InputError: The folder has no sealed rigs, or files that were changed; or ``out`` holds a
            proof with other settings or seals.
        OSError: A file cannot be written.
    """
    given = sealed_rigs(source)[:rigs]
    check_sums(source)
    settings = {"rigs": rigs, "seed": seed, "from": _stated(source, out), "row_version": VERSION}
    file, seals = out / PROOF_FILE, {rig.name: rig.digest for rig in given}
    if is_file(file):
        changed = [n for n, d in seals_begun(file, settings).items() if seals.get(n) != d]
        if changed:
            raise InputError(
                f"{source}: the truths of {', '.join(changed)} are missing or were changed since "
                f"this proof began; give --out another folder"
            )
    _make_folders(out)
    if not is_file(file):
        write_json(file, {"settings": settings, "seals": seals})
    return FromProof(out, seed, tuple(given))


def _make_folders(out: Path) -> None:
    """Make the folders of a proof, of which a copied or older proof may lack some."""
    for name in (ROWS, DIAGNOSES, JUDGEMENTS, TIMES):
        (out / name).mkdir(parents=True, exist_ok=True)


def _stated(source: Path, out: Path) -> str:
    """Return the path of the source, relative to the proof's folder if it is inside."""
    whole = source.resolve()
    inside = whole.is_relative_to(out.resolve())
    return str(whole.relative_to(out.resolve()) if inside else whole)


def diagnose_all(proof: FromProof, judge: Judge, engine: Engine, progress: Progress) -> None:
    """Diagnose the rigs that have no judgement yet; no truth is opened.

    Raises:
        InputError: Workers die repeatedly, or lack a file of a campaign.
        OSError: A file cannot be written.
    """
    numbered = list(enumerate(proof.rigs, start=1))
    todo = [(n, r) for n, r in numbered if not is_file(proof.file(JUDGEMENTS, r))]
    done = len(numbered) - len(todo)
    tasks = (
        ToDiagnose(diagnosis_seed(proof.seed, n), rig.name, given(rig.campaign, engine))
        for n, rig in todo
    )
    for said in engine.each(partial(diagnosed, judge=judge), tasks):
        for folder, record in ((DIAGNOSES, said.diagnosis), (TIMES, said.times)):
            write_json(proof.out / folder / f"{said.name}.json", record)
        write_json(proof.out / JUDGEMENTS / f"{said.name}.json", said.beside)
        done += 1
        progress(f"{said.name} diagnosed, {done} of {len(numbered)}", done / len(numbered))


class ToDiagnose(NamedTuple):
    """One rig to diagnose: seed of the diagnosis, name, and campaign."""

    seed: int
    name: str
    campaign: Path | Bundle


class Diagnosed(NamedTuple):
    """One diagnosed rig."""

    name: str
    diagnosis: Mapping[str, Any]
    beside: Mapping[str, Any]
    times: Mapping[str, Any]


def given(campaign: Path, engine: Engine) -> Path | Bundle:
    """Return a campaign in the form in which a worker of the engine can read it.

    Raises:
        InputError: The campaign has files outside its folder, which another machine cannot read.
    """
    return campaign if engine.shares_files else bundle(campaign)


def diagnosed(task: ToDiagnose, judge: Judge) -> Diagnosed:
    """Diagnose one rig; the result depends on the arguments alone, except for its times."""
    with unpacked(task.campaign) as campaign:
        try:
            judgement = judge(campaign, task.seed)
        except InputError as error:
            judgement = _refusal("; ".join(error.problems))
        except Exception as error:  # noqa: BLE001 - a failure on one rig is a result of the proof
            trace = traceback.format_exc()
            judgement = _refusal(f"broke down: {type(error).__name__}: {error}", trace)
        diagnosis, times = without_times(without_place(judgement.diagnosis, campaign.parent))
    beside = {
        "baselines": {method: list(names) for method, names in judgement.baselines.items()},
        "left": dict(judgement.left),
    }
    spent = {"seconds": judgement.seconds, "baseline_seconds": judgement.baseline_seconds}
    return Diagnosed(task.name, diagnosis, beside, times | spent)


def _refusal(message: str, trace: str = "") -> Judgement:
    """Return the judgement of a rig that could not be diagnosed."""
    fit = dict.fromkeys(("validate_baseline_rms", "validate_final_rms", "noise_floor_rms"))
    record: dict[str, Any] = {
        "verdict": REFUSED,
        "message": message,
        "traceback": trace,
        "effects": [],
        "fit": {"equation": None, **fit},
        "fits": [],
        "location": None,
        "parameter_shift": {},
        "p_value": None,
    }
    return Judgement(record, {}, lambda _names: None, 0.0, 0.0)


def score_all(
    proof: FromProof, oracle: Oracle, floors: Floors, engine: Engine, progress: Progress
) -> list[dict[str, Any]]:
    """Open the truths and score the judgements; return all rows in order.

    Raises:
        InputError: A rig is not diagnosed yet; a truth was changed or is not valid; workers die
            repeatedly.
        OSError: A file cannot be written.
    """
    missing = [rig.name for rig in proof.rigs if not is_file(proof.file(JUDGEMENTS, rig))]
    if missing:
        raise InputError(
            f"{proof.out}: not diagnosed yet: {', '.join(missing)}; the truths "
            "are opened only after all rigs are diagnosed"
        )
    todo = [rig for rig in proof.rigs if not is_file(proof.file(ROWS, rig))]
    done = len(proof.rigs) - len(todo)
    by_name = {rig.name: (rig, unseal(rig.truth, rig.digest)) for rig in todo}
    tasks = (_to_score(proof, rig, truth, engine) for rig, truth in by_name.values())
    for fits in engine.each(partial(fitted, oracle=oracle, floors=floors), tasks):
        rig, truth = by_name[fits.name]
        write_json(proof.file(ROWS, rig), _row(proof, rig, truth, fits))
        done += 1
        progress(f"{rig.name} scored, {done} of {len(proof.rigs)}", done / len(proof.rigs))
    write_sums(proof.out, REPEATED)
    return [timed_row(proof.out, rig.name) for rig in proof.rigs]


class ToScore(NamedTuple):
    """One rig to score.

    Attributes:
        name: Name of the rig.
        campaign: Campaign of the rig if the true structure is fitted to it, else None.
        names: True effects of the rig.
        reference: Campaign of the rig without its effects, or None if there is none.
    """

    name: str
    campaign: Path | Bundle | None
    names: Sequence[str]
    reference: Path | Bundle | None


class Fits(NamedTuple):
    """Fits with the truth of a rig: errors of the true structure, and residuals of the nominal
    model on the rig without effects; None if the fit is not made.
    """

    name: str
    oracle: Mapping[str, Any] | None
    floor: Mapping[str, float] | None


def _to_score(proof: FromProof, rig: SealedRig, truth: Truth, engine: Engine) -> ToScore:
    refused = read_json(proof.file(DIAGNOSES, rig))["verdict"] == REFUSED
    asked = truth.kind in ("one", "two") and not refused
    beside = is_file(rig.reference) and not refused
    return ToScore(
        rig.name,
        given(rig.campaign, engine) if asked else None,
        list(truth.scored),
        given(rig.reference, engine) if beside else None,
    )


def fitted(task: ToScore, oracle: Oracle, floors: Floors) -> Fits:
    """Fit the true structure to a rig, and the nominal model to that rig without its effects."""
    held = floor = None
    if task.campaign is not None:
        with unpacked(task.campaign) as campaign:
            held = oracle(campaign, task.names)
    if task.reference is not None:
        with unpacked(task.reference) as campaign:
            floor = floors(campaign)
    return Fits(task.name, held, floor)


def _row(proof: FromProof, rig: SealedRig, truth: Truth, fits: Fits) -> dict[str, Any]:
    diagnosis = read_json(proof.file(DIAGNOSES, rig))
    beside = read_json(proof.file(JUDGEMENTS, rig))
    excused = list(truth.excused)
    diagnosis["effects"] = [e for e in diagnosis["effects"] if e["name"] not in excused]
    if excused and not diagnosis["effects"] and diagnosis["verdict"] in ("named", "ambiguous"):
        diagnosis["verdict"] = "nothing_missing"
    judgement = Judgement(
        diagnosis, beside["baselines"], lambda _names: None, 0.0, 0.0, beside["left"]
    )
    floor = truth.floor if fits.floor is None else fits.floor
    names, recorded = truth.record(rig.name), _recordings(rig.campaign)
    row = row_of(names, truth.strength, judgement, fits.oracle, rig.digest, floor, recorded)
    return {**without_times(row)[0], "excused": excused, "axes": truth.axes}


def _recordings(campaign: Path) -> list[str]:
    """Return the names of a campaign's recordings in the form that a diagnosis uses."""
    names = []
    for section in load_campaign(campaign).value.recordings:
        files = (section.file,) if isinstance(section.file, str) else section.file
        names += [Path(file.removesuffix(".gz")).stem for file in files]
    return names
