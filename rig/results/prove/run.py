"""Runs a proof, of trials of this program or of rigs that other simulators have sealed.

Whoever sealed the rigs, all of them are diagnosed before the first truth is opened.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np

from identification.numerics.arrays import Progress
from rig.common.errors import InputError
from rig.common.places import is_file, read_json, read_utf8, usable, write_json, write_text
from rig.common.provenance import sha256_file
from rig.config.campaign import load_campaign, matching_files
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
from rig.results.prove.judge import Judge, Judgement
from rig.results.prove.score import REFUSED, VERSION, row_of
from rig.results.prove.simulate import campaign, reference_of, strength, truth_of, write
from rig.results.prove.truth import (
    CAMPAIGN_FILE,
    SEALED,
    Sealed,
    Truth,
    place,
    random_salt,
    seal_truth,
    unseal,
)
from rig.sources.build import distinct_names

SUMS_FILE = "SHA256SUMS"
SETTINGS_FILE = f"{SEALED}/.settings.json"
"""File of a folder of sealed rigs with the settings of its draws. It is beside the truths, because
it repeats them, and no digest of it is listed, because a digest would show the seed.
"""


def write_sums(home: Path, parts: Sequence[str] = (".",)) -> Path:
    """Write the digest of every file of the folder but the settings; return the path of the
    list.
    """
    path = home / SUMS_FILE
    left_out = (path, home / SETTINGS_FILE)
    found = {f for part in parts for f in (home / part, *(home / part).rglob("*"))}
    files = sorted(f for f in found if is_file(f) and f not in left_out)
    lines = [f"{sha256_file(file)}  {file.relative_to(home).as_posix()}" for file in files]
    write_text(path, "\n".join(lines) + "\n")
    return path


def check_sums(home: Path) -> None:
    """Compare the files of the folder with its list of digests, if there is a list."""
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
FIELDS = ("created", "seconds")


def without_times(record: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a record without date and durations, and a record of date and durations alone."""
    kept = {name: value for name, value in record.items() if name not in FIELDS}
    return kept, {name: record[name] for name in FIELDS if name in record}


def timed_row(out: Path, name: str) -> dict[str, Any]:
    """Return the row of a trial with its durations."""
    row = dict(read_json(out / ROWS / f"{name}.json"))
    beside = out / TIMES / f"{name}.json"
    spent = read_json(beside) if is_file(beside) else {}
    return row | {key: spent.get(key, row.get(key, 0.0)) for key in FIELDS if key != "created"}


PROOF_FILE = "proof.json"
ROWS, DIAGNOSES, JUDGEMENTS = "rows", "diagnoses", "judgements"
REPEATED = (PROOF_FILE, DIAGNOSES, JUDGEMENTS, ROWS)
"""Files and folders of a proof whose bytes depend on the settings of the proof alone."""


class Proof(NamedTuple):
    """State of a proof."""

    out: Path
    seed: int
    rigs: tuple[Sealed, ...]

    def file(self, folder: str, rig: Sealed) -> Path:
        """Return the path of the file of a rig in a folder of the proof."""
        return self.out / folder / f"{rig.name}.json"


Done = TypeVar("Done")


def _told(
    results: Iterable[Done], left: int, of: int, words: Callable[[Done], str], progress: Progress
) -> Iterator[Done]:
    """Yield the results of the rigs that are left; after each, tell how many are done."""
    for done, result in enumerate(results, start=of - left + 1):
        yield result
        progress(f"{words(result)}, {done} of {of}", done / of)


def seals_begun(file: Path, settings: Mapping[str, Any]) -> dict[str, str]:
    """Return the digest of each trial of a proof that was begun earlier, by its number."""
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


def diagnosis_seed(seed: int, number: int) -> int:
    """Return the seed of a diagnosis, from which no truth can be drawn again."""
    return int(np.random.SeedSequence([seed, number, 1]).generate_state(1)[0])


SUFFIXES = (".yaml", ".yml", ".json")
PREFIX = "rig-"  # prefix of a rig's folder if its truth is named by a number


def sealed_rigs(home: Path) -> list[Sealed]:
    """Return the rigs of a folder in order of their names, with the digests of their truths.

    Raises:
        InputError: There is no rig, a truth has no campaign, or a rig has two truths.
    """
    problems: list[str] = []
    found: dict[str, Sealed] = {}
    for truth in sorted((home / SEALED).glob("*")):
        if truth.suffix not in SUFFIXES or truth.name.startswith("."):
            continue
        places = [place(home, name) for name in (truth.stem, PREFIX + truth.stem)]
        rig = next((each for each in places if is_file(each.campaign)), None)
        if rig is None:
            problems.append(f"{truth}: no {places[0].campaign}; add it, or remove this truth")
        elif rig.name in found:
            first = found[rig.name].truth.name
            problems.append(f"{truth}: {rig.name} already has the truth {first}; remove one")
        else:
            with usable(truth, "read"):
                found[rig.name] = rig._replace(truth=truth, digest=sha256_file(truth))
    if problems:
        raise InputError(problems)
    if not found:
        raise InputError(
            f"{home}: no NAME/{CAMPAIGN_FILE} with a {SEALED}/NAME.yaml or {SEALED}/NAME.json; "
            f"give --from a folder of sealed rigs (docs/guides/worlds.md)"
        )
    return list(found.values())


class Task(NamedTuple):
    """One rig to make."""

    number: int
    assigned: Assigned
    salt: str


class Made(NamedTuple):
    """One rig that was made."""

    name: str
    # Files of the rig, by paths relative to the folder of sealed rigs; the truth is last.
    files: Files


def seal_all(
    home: Path,
    drawn: Sequence[tuple[int, Assigned]],
    one: Callable[[Task], Made],
    engine: Engine,
    progress: Progress,
    settings: Mapping[str, Any],
    salt: Callable[[int], str] = random_salt,
) -> list[Sealed]:
    """Make and write the rigs that do not exist yet; return all rigs with their digests.

    Raises:
        InputError: The folder holds rigs of other settings, or of settings that are not known.
    """
    _require_settings(home, settings)
    todo = [
        Task(n, assigned, salt(n))
        for n, assigned in drawn
        if not is_file(place(home, _name(n)).truth)
    ]
    results = engine.each(one, todo)
    for rig in _told(results, len(todo), len(drawn), lambda r: f"{r.name} sealed", progress):
        write_folder(home, rig.files)
    write_sums(home)
    return sealed_rigs(home)


def _require_settings(home: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings of a folder without rigs; compare those of a folder with rigs."""
    file = home / SETTINGS_FILE
    held: Any = None
    if is_file(file):
        held = read_json(file)
    elif not any(path.suffix in SUFFIXES for path in (home / SEALED).glob("*")):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_json(file, dict(settings))
        return
    if held != settings:
        words = f"rigs with other settings, {held}" if held else "rigs of unknown settings"
        raise InputError(f"{home}: this folder contains {words}; give another folder")


@contextmanager
def making(number: int) -> Iterator[Sealed]:
    """Yield the paths of a rig in a temporary folder."""
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        yield place(Path(scratch), _name(number))


def made(where: Sealed) -> Made:
    """Return the files of a rig that was written into a temporary folder."""
    files = read_folder(where.campaign.parents[1])
    truth = f"{SEALED}/{where.truth.name}"
    return Made(where.name, {**{k: v for k, v in files.items() if k != truth}, truth: files[truth]})


def _name(number: int) -> str:
    return f"{PREFIX}{number:04d}"


def seal_own(
    home: Path,
    rigs: int,
    seed: int,
    engine: Engine,
    progress: Progress,
    salt: Callable[[int], str] = random_salt,
) -> list[Sealed]:
    """Draw, simulate and seal trials; return the trials with their digests. Nothing is diagnosed.

    Trials that exist already are kept, so that a call that was stopped can be repeated.
    """
    drawn = list(enumerate(assignment(rigs, seed), start=1))
    settings = {"rigs": rigs, "seed": seed}
    return seal_all(home, drawn, partial(_seal, seed=seed), engine, progress, settings, salt)


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
        seal_truth(where, where.name, truth, task.salt)
        return made(where)


Oracle = Callable[[Path, Sequence[str]], Mapping[str, Any] | None]
"""Function of campaign file and true names; returns the errors with the true structure, or None."""
Floors = Callable[[Path], Mapping[str, float]]
"""Returns the nominal model's residual in each equation, of a campaign without effects."""


def begin_from(out: Path, rigs: int | None, seed: int, source: Path) -> Proof:
    """Read the seals of a folder, or continue a proof that began with these seals.

    Args:
        out: Folder of the proof.
        rigs: Number of rigs from the first one, or None for all.
        seed: Seed of the diagnoses.
        source: Folder of the sealed rigs.
    """
    whole, home = source.resolve(), out.resolve()
    if whole == home:
        raise InputError(
            f"{out}: holds the sealed rigs, whose {SUMS_FILE} would be overwritten; give --out "
            "another folder"
        )
    given = sealed_rigs(source)[:rigs]
    check_sums(source)
    stated = whole.relative_to(home) if whole.is_relative_to(home) else whole
    settings = {
        "rigs": len(given) if rigs is None else rigs,
        "seed": seed,
        "from": str(stated),
        "row_version": VERSION,
    }
    file, seals = out / PROOF_FILE, {rig.name: rig.digest for rig in given}
    if is_file(file):
        changed = [n for n, d in seals_begun(file, settings).items() if seals.get(n) != d]
        if changed:
            raise InputError(
                f"{source}: the truths of {', '.join(changed)} are missing or were changed since "
                f"this proof began; give --out another folder"
            )
    for name in (ROWS, DIAGNOSES, TIMES, JUDGEMENTS):
        (out / name).mkdir(parents=True, exist_ok=True)
    if not is_file(file):
        write_json(file, {"settings": settings, "seals": seals})
    return Proof(out, seed, tuple(given))


def diagnose_all(proof: Proof, judge: Judge, engine: Engine, progress: Progress) -> None:
    """Diagnose the rigs that have no judgement yet; no truth is opened."""
    numbered = list(enumerate(proof.rigs, start=1))
    todo = [(n, r) for n, r in numbered if not is_file(proof.file(JUDGEMENTS, r))]
    tasks = (
        ToDiagnose(diagnosis_seed(proof.seed, n), rig.name, given(rig.campaign, engine))
        for n, rig in todo
    )
    results = engine.each(partial(diagnosed, judge=judge), tasks)
    for said in _told(results, len(todo), len(numbered), lambda r: f"{r.name} diagnosed", progress):
        file = f"{said.name}.json"
        write_json(proof.out / DIAGNOSES / file, said.diagnosis)
        write_json(proof.out / TIMES / file, said.times)
        # The judgement is written last, because it marks the rig as diagnosed.
        write_json(proof.out / JUDGEMENTS / file, said.beside)


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
    """Return a campaign in the form in which a worker of the engine can read it."""
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
    beside = {"left": dict(judgement.left)}
    return Diagnosed(task.name, diagnosis, beside, times | {"seconds": judgement.seconds})


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
    return Judgement(record, 0.0)


def score_all(
    proof: Proof, oracle: Oracle, floors: Floors, engine: Engine, progress: Progress
) -> list[dict[str, Any]]:
    """Open the truths and score the judgements; return all rows in order."""
    missing = [rig.name for rig in proof.rigs if not is_file(proof.file(JUDGEMENTS, rig))]
    if missing:
        raise InputError(
            f"{proof.out}: not diagnosed yet: {', '.join(missing)}; the truths "
            "are opened only after all rigs are diagnosed"
        )
    todo = [rig for rig in proof.rigs if not is_file(proof.file(ROWS, rig))]
    by_name = {rig.name: (rig, unseal(rig.truth, rig.digest)) for rig in todo}

    def task(rig: Sealed, truth: Truth) -> ToScore:
        judged = read_json(proof.file(DIAGNOSES, rig))["verdict"] != REFUSED
        asked = judged and truth.kind in ("one", "two")
        beside = judged and is_file(rig.reference)
        return ToScore(
            rig.name,
            given(rig.campaign, engine) if asked else None,
            list(truth.scored),
            given(rig.reference, engine) if beside else None,
        )

    tasks = (task(*pair) for pair in by_name.values())
    results = engine.each(partial(fitted, oracle=oracle, floors=floors), tasks)
    for fits in _told(results, len(todo), len(proof.rigs), _scored_words, progress):
        rig, truth = by_name[fits.name]
        write_json(proof.file(ROWS, rig), _row(proof, rig, truth, fits))
    write_sums(proof.out, REPEATED)
    return [timed_row(proof.out, rig.name) for rig in proof.rigs]


class ToScore(NamedTuple):
    """One rig to score."""

    name: str
    # Campaign of the rig if the true structure is fitted to it, else None.
    campaign: Path | Bundle | None
    names: Sequence[str]  # true effects of the rig
    # Campaign of the rig without its effects, or None if there is none.
    reference: Path | Bundle | None


class Fits(NamedTuple):
    """Errors of the true structure, residuals without effects; None if not fitted."""

    name: str
    oracle: Mapping[str, Any] | None
    floor: Mapping[str, float] | None
    problems: Sequence[str] = ()  # messages of fits that failed


def fitted(task: ToScore, oracle: Oracle, floors: Floors) -> Fits:
    """Fit the true structure to a rig, and the nominal model to that rig without its effects; a fit
    that fails leaves None.
    """
    problems: list[str] = []

    def tried(given: Path | Bundle | None, fit: Callable[[Path], Done]) -> Done | None:
        if given is None:
            return None
        try:
            with unpacked(given) as campaign:
                return fit(campaign)
        except InputError as error:
            problems.extend(error.problems)
        except Exception as error:  # noqa: BLE001 - a failure on one rig does not end the proof
            problems.append(f"{type(error).__name__}: {error}")
        return None

    held = tried(task.campaign, lambda campaign: oracle(campaign, task.names))
    return Fits(task.name, held, tried(task.reference, floors), problems)


def _scored_words(fits: Fits) -> str:
    failed = f", but a fit failed: {'; '.join(fits.problems)}" if fits.problems else ""
    return f"{fits.name} scored{failed}"


def _row(proof: Proof, rig: Sealed, truth: Truth, fits: Fits) -> dict[str, Any]:
    diagnosis = read_json(proof.file(DIAGNOSES, rig))
    beside = read_json(proof.file(JUDGEMENTS, rig))
    excused = list(truth.excused)
    diagnosis["effects"] = [e for e in diagnosis["effects"] if e["name"] not in excused]
    if excused and not diagnosis["effects"] and diagnosis["verdict"] in ("named", "ambiguous"):
        diagnosis["verdict"] = "nothing_missing"
    judgement = Judgement(diagnosis, 0.0, beside["left"])
    floor = truth.floor if fits.floor is None else fits.floor
    # The campaign of a rig that could not be diagnosed may be unreadable.
    recorded = [] if diagnosis["verdict"] == REFUSED else _recordings(rig.campaign)
    names = truth.record(rig.name)
    row = row_of(names, truth.strength, judgement, fits.oracle, rig.digest, floor, recorded)
    return {**without_times(row)[0], "excused": excused, "axes": truth.axes}


def _recordings(campaign: Path) -> list[str]:
    """Return the names of a campaign's files, which the diagnosis gives to their recordings."""
    sections, folder = load_campaign(campaign).value.recordings, campaign.parent
    files = [
        file
        for each in sections
        for pattern in each.patterns
        for file in matching_files(folder, pattern)
    ]
    stems = [Path(file.name.removesuffix(".gz")).stem for file in files]
    return distinct_names(stems, [file.parent.name for file in files])
