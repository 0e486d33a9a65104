"""Judges sealed rigs from any simulator: diagnoses all rigs first, then opens all truths."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_json
from rig.common.places import write_json
from rig.config.campaign import load_campaign
from rig.results.prove.interchange.folder import SealedRig, check_sums, sealed_rigs
from rig.results.prove.judge import Judge, Judgement
from rig.results.prove.located import REFUSED
from rig.results.prove.pool import each
from rig.results.prove.row import VERSION, row_of
from rig.results.prove.run import PROOF_FILE, ROWS, diagnosis_seed, seals_begun
from rig.results.prove.seal import unseal

DIAGNOSES, JUDGEMENTS = "diagnoses", "judgements"
Oracle = Callable[[Path, Sequence[str]], Mapping[str, Any] | None]
"""(campaign file, true names) to the errors with the true structure, or None."""
Floors = Callable[[Path], Mapping[str, float]]
"""Campaign file of a rig without effects to the nominal model's residual in each equation."""
Progress = Callable[[str, float], None]


class FromProof(NamedTuple):
    """State of a proof of sealed rigs.

    Attributes:
        out: Its folder.
        seed: Seed of the diagnoses.
        rigs: The rigs, in order.
    """

    out: Path
    seed: int
    rigs: tuple[SealedRig, ...]

    def file(self, folder: str, rig: SealedRig) -> Path:
        """Return a rig's file in a folder of the proof."""
        return self.out / folder / f"{rig.name}.json"


def begin_from(out: Path, rigs: int, seed: int, source: Path) -> FromProof:
    """Read the seals of a folder, or continue a proof that began with these seals.

    Raises:
        InputError: The folder has no sealed rigs, or files that were changed; or ``out`` holds a
            proof with other settings or seals.
        OSError: It cannot be written.
    """
    given = sealed_rigs(source)[:rigs]
    check_sums(source)
    settings = {"rigs": rigs, "seed": seed, "from": str(source.resolve()), "row_version": VERSION}
    file, seals = out / PROOF_FILE, {rig.name: rig.digest for rig in given}
    if is_file(file):
        changed = [n for n, d in seals_begun(file, settings).items() if seals.get(n) != d]
        if changed:
            raise InputError(
                f"{source}: the truths of {', '.join(changed)} are missing or were changed since "
                f"this proof began; give --out another folder"
            )
    else:
        for name in (ROWS, DIAGNOSES, JUDGEMENTS):
            (out / name).mkdir(parents=True, exist_ok=True)
        write_json(file, {"settings": settings, "seals": seals})
    return FromProof(out, seed, tuple(given))


def diagnose_all(proof: FromProof, judge: Judge, jobs: int, progress: Progress) -> None:
    """Diagnose the rigs that have no judgement yet; no truth is opened.

    Args:
        proof: The proof as begun.
        judge: Judges a campaign; with more than one job it must be importable.
        jobs: Processes.
        progress: Called with the label of a step and the share that is done.

    Raises:
        OSError: A file cannot be written.
    """
    numbered = list(enumerate(proof.rigs, start=1))
    todo = [(n, r) for n, r in numbered if not is_file(proof.file(JUDGEMENTS, r))]
    done = len(numbered) - len(todo)
    for name in each(partial(_diagnosed, proof=proof, judge=judge), todo, jobs):
        done += 1
        progress(f"{name} diagnosed, {done} of {len(numbered)}", done / len(numbered))


def _diagnosed(numbered: tuple[int, SealedRig], proof: FromProof, judge: Judge) -> str:
    """Diagnose one rig and store the judgement; return the name of the rig."""
    number, rig = numbered
    try:
        judgement = judge(rig.campaign, diagnosis_seed(proof.seed, number))
    except InputError as error:
        judgement = _refusal("; ".join(error.problems))
    except Exception as error:  # noqa: BLE001 - a breakdown on one rig is a result, the others go on
        trace = traceback.format_exc()
        judgement = _refusal(f"broke down: {type(error).__name__}: {error}", trace)
    write_json(proof.file(DIAGNOSES, rig), judgement.diagnosis)
    beside = {
        "baselines": {method: list(names) for method, names in judgement.baselines.items()},
        "seconds": judgement.seconds,
        "baseline_seconds": judgement.baseline_seconds,
        "left": dict(judgement.left),
    }
    write_json(proof.file(JUDGEMENTS, rig), beside)
    return rig.name


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
    proof: FromProof, oracle: Oracle, floors: Floors, progress: Progress
) -> list[dict[str, Any]]:
    """Open the truths and score the judgements; return all rows in order.

    Args:
        proof: The proof, every rig of it diagnosed.
        oracle: Fits the true structure.
        floors: Computes the residual of the nominal model on a rig without effects.
        progress: Called with the label of a step and the share that is done.

    Raises:
        InputError: A rig is not diagnosed yet; a truth was changed or is not valid.
        OSError: A file cannot be written.
    """
    missing = [rig.name for rig in proof.rigs if not is_file(proof.file(JUDGEMENTS, rig))]
    if missing:
        raise InputError(
            f"{proof.out}: not diagnosed yet: {', '.join(missing)}; the truths "
            "are opened only after all rigs are diagnosed"
        )
    rows = []
    for n, rig in enumerate(proof.rigs, start=1):
        file = proof.file(ROWS, rig)
        if not is_file(file):
            write_json(file, _row(proof, rig, oracle, floors))
        progress(f"{rig.name} scored, {n} of {len(proof.rigs)}", n / len(proof.rigs))
        rows.append(read_json(file))
    return rows


def _row(proof: FromProof, rig: SealedRig, oracle: Oracle, floors: Floors) -> dict[str, Any]:
    diagnosis = read_json(proof.file(DIAGNOSES, rig))
    beside = read_json(proof.file(JUDGEMENTS, rig))
    truth = unseal(rig.truth, rig.digest)
    names = list(truth.scored)
    refused = diagnosis["verdict"] == REFUSED
    held = oracle(rig.campaign, names) if truth.kind in ("one", "two") and not refused else None
    floor = floors(rig.reference) if is_file(rig.reference) and not refused else truth.floor
    excused = list(truth.excused)
    diagnosis["effects"] = [e for e in diagnosis["effects"] if e["name"] not in excused]
    if excused and not diagnosis["effects"] and diagnosis["verdict"] in ("named", "ambiguous"):
        diagnosis["verdict"] = "nothing_missing"
    judgement = Judgement(
        diagnosis,
        beside["baselines"],
        lambda _names: None,
        beside["seconds"],
        beside["baseline_seconds"],
        beside["left"],
    )
    recordings = _recordings(rig.campaign)
    row = row_of(
        truth.record(rig.name), truth.strength, judgement, held, rig.digest, floor, recordings
    )
    return {**row, "excused": excused, "axes": truth.axes}


def _recordings(campaign: Path) -> list[str]:
    """Return the names of a campaign's recordings in the form that a diagnosis uses."""
    names = []
    for section in load_campaign(campaign).value.recordings:
        files = (section.file,) if isinstance(section.file, str) else section.file
        names += [Path(file.removesuffix(".gz")).stem for file in files]
    return names
