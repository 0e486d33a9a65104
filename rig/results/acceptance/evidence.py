"""Acceptance of a finished run: compares the run with its limits, and writes the certificate."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from identification.diagnosis.gas import PRESSURE
from identification.numerics.arrays import Progress
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.provenance import RESULT_FILE as IDENTIFY_FILE
from rig.common.provenance import sha256_file
from rig.common.tables import number
from rig.config.acceptance import NOTHING_MISSING, WEIGHT_CHECK, Bound, Limit, Range, Required
from rig.results.diagnose.diagnose import RESULT_FILE as DIAGNOSIS_FILE
from rig.results.diagnose.diagnose import diagnose_source, without_torque
from rig.results.diagnose.exports import write_diagnosis
from rig.results.identify.document import write_identification
from rig.results.identify.identify import Request, identify_source
from rig.results.measured import clock_words, measured
from rig.runs.catalogue.entry import Constant
from rig.runs.catalogue.index import constants_of
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE, Ending, RunRecord
from rig.runs.run_record import Verdict as WeightVerdict
from rig.weighing.weight_check import judged as weighed_recordings

DIAGNOSIS_FOLDER = "diagnosis"


@dataclass(frozen=True)
class Evidence:
    """Values of a run that the acceptance limits apply to."""

    record: RunRecord
    digests: Mapping[str, str]  # SHA-256 of the recordings of the run, by file
    # Finished excitations of the run, or None if no excitation was finished.
    dataset: Dataset | None = None
    # Identified constants; empty if no limit needs an identification.
    constants: Mapping[str, Constant] = field(default_factory=dict)
    method: str = ""  # method of the identification; empty without one
    fit_rms: float | None = None  # torque error of the identification; None without one
    diagnosis: str = ""  # verdict of the diagnosis; empty if no limit needs a diagnosis
    # Verdict and message of the last weight check, by the name of the stage or of its recording.
    weights: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()  # messages on values that could not be obtained


def gather(folder: Path, limits: Sequence[Limit], progress: Progress) -> Evidence:
    """Collect the values of a run that the limits apply to.

    An identification or diagnosis in the run folder is used if it was made from the present
    recordings and the present ``run.json``, and a diagnosis if it has the equations of the motion
    that was recorded; else the run is identified and diagnosed as by ``rig identify`` and ``rig
    diagnose``, and the results are written into the folder.
    """
    record = read_record(folder)
    digests = {
        p.file: sha256_file(folder / p.file) for p in record.parts if is_file(folder / p.file)
    }
    problems: list[str] = []
    dataset = _tried(lambda: load_run(folder), problems)
    used = {r.sha256 for r in dataset.recordings} if dataset is not None else set()
    present = sha256_file(folder / RUN_FILE)
    identified = _current(folder / IDENTIFY_FILE, used, present)
    needed = any(
        isinstance(limit, Range) or getattr(limit, "measure", "") == "torque error"
        for limit in limits
    )
    if not identified and dataset is not None and needed:
        identified = _tried(lambda: _identified(folder, progress), problems) or {}
    diagnosed: Mapping[str, Any] = {}
    if any(limit.text == NOTHING_MISSING for limit in limits):
        diagnosed = _current(folder / DIAGNOSIS_FOLDER / DIAGNOSIS_FILE, used, present)
        gas = (diagnosed.get("fit") or {}).get("equation") == PRESSURE
        if dataset is not None and (not diagnosed or (gas and not without_torque(dataset))):
            diagnosed = _tried(lambda: _diagnosed(folder, progress), problems) or {}
    weighed = any(limit.text == WEIGHT_CHECK for limit in limits)
    fit = identified.get("fit") or {}
    return Evidence(
        record,
        digests,
        dataset,
        constants_of(identified),
        str(identified.get("method", "")),
        fit.get("train_rms"),
        str(diagnosed.get("verdict", "")),
        _weights(record, dataset if weighed else None),
        tuple(dict.fromkeys(problems)),
    )


def _tried(made: Callable[[], Any], problems: list[str]) -> Any:
    """Return the result of a function; if it fails, None, with its message among the problems."""
    try:
        return made()
    except InputError as error:
        problems += error.problems
        return None


def _current(path: Path, present: Collection[str], run: str) -> dict[str, Any]:
    """Return the record of a result file made from all present recordings and, if the file names a
    ``run.json``, from the present one, by their digests; otherwise, {}.
    """
    try:
        found = json.loads(path.read_bytes())
        inputs = [(Path(each["file"]), each["sha256"]) for each in found["inputs"]]
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    used = {digest for file, digest in inputs if file.suffix == ".mcap"}
    described = {digest for file, digest in inputs if file.name == RUN_FILE}
    current = used and used == {*present} and described <= {run}
    return found if current and not found.get("partial") else {}


def _identified(folder: Path, progress: Progress) -> dict[str, Any]:
    """Identify a run as ``rig identify`` does; return the record."""
    outcome = identify_source(folder, Request(), progress)
    return write_identification(folder, outcome, truth_of(folder), folder)[0]


def _diagnosed(folder: Path, progress: Progress) -> dict[str, Any]:
    """Diagnose a run as ``rig diagnose`` does; return the record."""
    outcome = diagnose_source(folder, 0, progress=progress, refine=True)
    return write_diagnosis(folder, outcome, folder / DIAGNOSIS_FOLDER)[0]


def _weights(record: RunRecord, dataset: Dataset | None) -> dict[str, tuple[str, str]]:
    """Return the last weight check of each stage, from the run or else from the recordings."""
    found = {str(w["stage"]): (str(w["verdict"]), str(w["message"])) for w in record.weights}
    if found or dataset is None:
        return found
    found = {w.stage: (w.verdict.value, w.message) for w in weighed_recordings(dataset)}
    unknown = WeightVerdict.UNCHECKED.value, "too little motion or no current was recorded"
    loaded = [s.name for s in record.stages if s.stage == "loaded"] if found else []
    return found | {name: unknown for name in loaded if weight_verdict(found, name) is None}


def weight_verdict(weights: Mapping[str, tuple[str, str]], stage: str) -> str | None:
    """Return the worst verdict of the weight checks of a stage and of its recordings; None without
    a check.
    """
    worst = [v.value for v in (WeightVerdict.WRONG, WeightVerdict.UNCHECKED, WeightVerdict.RIGHT)]
    mine = [verdict for name, (verdict, _) in weights.items() if name.partition("[")[0] == stage]
    return min(mine, key=lambda v: worst.index(v) if v in worst else -1, default=None)


COMPLETE = "run complete"  # name of the check that every run must pass before its limits are judged
SAME_LOAD = "same load during the stage"
"""Name of the check that a stage fails whose load changed, whatever the limits."""


@dataclass(frozen=True)
class Check:
    """One limit, and whether the run met it."""

    limit: str  # the limit as written
    passed: bool  # whether the limit is met; a check without a found value is not passed
    words: str  # message on the found value, or a remedy if there is no value
    value: float | None = None  # found value, in `unit`, or None if it is unknown or not a number
    low: float | None = (
        None  # lower end of the 90 % interval of the value; None without an interval
    )
    high: float | None = None  # upper end of the interval
    unit: str = ""


def judge(limits: Sequence[Limit], evidence: Evidence) -> tuple[Check, ...]:
    """Return checks of completeness and of unchanged loads, and one check for each limit."""
    changed = (
        Check(
            SAME_LOAD,
            False,
            f"run.json: stages[{at}].load_change_kg: the load of stage {stage.name} changed by "
            f"{number(stage.load_change_kg)} kg; repeat the stage",
            stage.load_change_kg,
            unit="kg",
        )
        for at, stage in enumerate(evidence.record.stages)
        if stage.load_change_kg is not None
    )
    return (_complete(evidence), *changed, *(_judged(limit, evidence) for limit in limits))


def accepted(checks: Iterable[Check]) -> bool:
    """Return whether every check is passed."""
    return all(check.passed for check in checks)


def _complete(evidence: Evidence) -> Check:
    record = evidence.record
    done = record.state == Ending.DONE.value and all(s.state == "done" for s in record.stages)
    return Check(
        COMPLETE, done, f"{record.state}: {record.message}" if record.message else record.state
    )


def _judged(limit: Limit, evidence: Evidence) -> Check:
    match limit:
        case Range():
            return _range(limit, evidence)
        case Bound():
            return _bound(limit, evidence)
        case Required() if limit.text == NOTHING_MISSING:
            if not evidence.diagnosis:
                return _unknown(limit, evidence, "the run was not diagnosed")
            words = f"the diagnosis found: {evidence.diagnosis.replace('_', ' ')}"
            return Check(limit.text, evidence.diagnosis == "nothing_missing", words)
        case Required():
            return _weight(limit, evidence)


def _unknown(limit: Limit, evidence: Evidence, what: str) -> Check:
    return Check(limit.text, False, "; ".join((what, *evidence.problems)))


def _range(limit: Range, evidence: Evidence) -> Check:
    """Judge a parameter: its whole 90 % interval must be inside (the rule of ISO 14253-1)."""
    found = evidence.constants.get(limit.name)
    if found is None:
        return _unknown(limit, evidence, f"{limit.name} was not identified")
    if found.value is None:
        return _unknown(limit, evidence, f"the recordings do not determine {limit.name}")
    words, passed = f"{number(found.value)} {found.unit}", False
    if found.half_width is None or found.low is None or found.high is None:
        words += ", without an interval, so that it is not known whether the true value is inside"
    else:
        words += f", 90 % interval {number(found.low)} to {number(found.high)}"
        passed = limit.low <= found.low and found.high <= limit.high
        if not passed and limit.low <= found.value <= limit.high:
            words += ": the value is inside the limits, but its interval is not; record more data"
        elif not passed:
            words += ": outside"
    return Check(limit.text, passed, words, found.value, found.low, found.high, found.unit)


def _bound(limit: Bound, evidence: Evidence) -> Check:
    value = evidence.fit_rms
    if limit.measure != "torque error":
        value = measured(limit.measure, evidence.record, evidence.dataset, limit.statistic)
    if value is None or not math.isfinite(value):
        return _unknown(limit, evidence, f"{limit.measure} was not recorded")
    shown = value / limit.scale
    name = f"{limit.measure} {limit.statistic}".strip()
    words = f"{name} {number(shown, 4)} {limit.unit}".strip() + clock_words(
        limit.measure, evidence.record
    )
    return Check(limit.text, limit.holds(shown), words, shown, unit=limit.unit)


def _weight(limit: Limit, evidence: Evidence) -> Check:
    if not evidence.weights:
        words = (
            "no mass could be checked: the check needs a run with --identification, or stages with "
            "two masses and with the empty lever"
        )
        return Check(limit.text, False, words)
    bad = {s: each for s, each in evidence.weights.items() if each[0] != WeightVerdict.RIGHT.value}
    listed = "; ".join(f"{stage}: {verdict}, {text}" for stage, (verdict, text) in bad.items())
    return Check(limit.text, not bad, listed or f"right in {', '.join(evidence.weights)}")
