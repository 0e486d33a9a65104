"""Acceptance of a finished run: compares the run with its limits, and writes the certificate."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.provenance import RESULT_FILE as IDENTIFY_FILE
from rig.common.provenance import sha256_file
from rig.common.tables import number
from rig.config.acceptance import NOTHING_MISSING, WEIGHT_CHECK, Bound, Limit, Range, Required
from rig.results.diagnose.diagnose import RESULT_FILE as DIAGNOSIS_FILE
from rig.results.diagnose.diagnose import diagnose_source
from rig.results.diagnose.document import diagnose_document
from rig.results.diagnose.exports import exports
from rig.results.document import PAGE_FILE, write_page, write_record, write_texts
from rig.results.identify.document import identify_document
from rig.results.identify.identify import Request, identify_source, outcome_record
from rig.results.measured import QUANTITIES, clock_words, facts_of
from rig.runs.catalogue.entry import Constant
from rig.runs.catalogue.index import constants_of
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run
from rig.runs.run_file import read_record
from rig.runs.run_record import Ending, RunRecord
from rig.runs.run_record import Verdict as WeightVerdict
from rig.weighing.weight_check import comparable, off_label

Progress = Callable[[str, float], None]
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
    # Verdict and message of the last weight check, by the name of the stage.
    weights: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()  # messages on values that could not be obtained


def gather(folder: Path, limits: Sequence[Limit], progress: Progress) -> Evidence:
    """Collect the values of a run that the limits apply to.

    An identification or diagnosis in the run folder is used if it was made from the present
    recordings; else the run is identified and diagnosed as by ``rig identify`` and ``rig
    diagnose``, and the results are written into the folder.
    """
    record = read_record(folder)
    digests = {
        p.file: sha256_file(folder / p.file) for p in record.parts if is_file(folder / p.file)
    }
    problems: list[str] = []
    dataset = _tried(lambda: load_run(folder), problems)
    identified = _current(folder / IDENTIFY_FILE, digests)
    if not identified and dataset is not None and any(map(_needs_constants, limits)):
        identified = _tried(lambda: _identify(folder, progress), problems) or {}
    diagnosed: Mapping[str, Any] = {}
    if any(limit.text == NOTHING_MISSING for limit in limits):
        diagnosed = _current(folder / DIAGNOSIS_FOLDER / DIAGNOSIS_FILE, digests)
        if not diagnosed and dataset is not None:
            diagnosed = _tried(lambda: _diagnose(folder, progress), problems) or {}
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
        _weights(record, dataset) if weighed else {},
        tuple(dict.fromkeys(problems)),
    )


def _needs_constants(limit: Limit) -> bool:
    return isinstance(limit, Range) or (
        isinstance(limit, Bound) and limit.measure == "torque error"
    )


def _tried(made: Callable[[], Any], problems: list[str]) -> Any:
    """Return the result of a function; if it fails, None, with its message among the problems."""
    try:
        return made()
    except InputError as error:
        problems += error.problems
        return None


def _current(path: Path, digests: Mapping[str, str]) -> dict[str, Any]:
    """Return the record of a result file made from the present recordings; otherwise, {}."""
    try:
        found = json.loads(path.read_bytes())
        used = {each["sha256"] for each in found["inputs"] if Path(each["file"]).suffix == ".mcap"}
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    return found if used and used <= set(digests.values()) else {}


def _identify(folder: Path, progress: Progress) -> dict[str, Any]:
    """Identify a run as ``rig identify`` does; returns the record."""
    outcome = identify_source(folder, Request(), progress)
    record = outcome_record(outcome)
    write_record(record, folder / IDENTIFY_FILE, None)
    document = identify_document(folder.name, outcome, truth_of(folder), facts_of(folder))
    write_page(document, folder / PAGE_FILE)
    return record


def _diagnose(folder: Path, progress: Progress) -> dict[str, Any]:
    """Diagnose a run as ``rig diagnose`` does; returns the record."""
    inside = folder / DIAGNOSIS_FOLDER
    outcome = diagnose_source(folder, 0, progress=progress, refine=True)
    record = outcome.record()
    write_record(record, inside / DIAGNOSIS_FILE, None)
    beside = exports(folder, outcome, record)
    write_texts({file.name: file.text for file in beside.files}, inside)
    document = diagnose_document(folder.name, outcome, beside, facts_of(folder))
    write_page(document, inside / PAGE_FILE)
    return record


def _weights(record: RunRecord, dataset: Dataset | None) -> dict[str, tuple[str, str]]:
    """Return the last weight check of each stage, from the run or else from the recordings."""
    found = {str(w["stage"]): (str(w["verdict"]), str(w["message"])) for w in record.weights}
    if found or dataset is None or not comparable(dataset):
        return found
    wrong = off_label(dataset)
    words = "the friction of the stages agrees with their masses"
    loaded = _loaded(record)
    return {name: (WeightVerdict.RIGHT.value, words) for name in loaded} | {
        each.stage: (each.verdict.value, each.message) for each in wrong
    }


def _loaded(record: RunRecord) -> Iterable[str]:
    return (stage.name for stage in record.stages if stage.stage == "loaded")


COMPLETE = "run complete"  # name of the check that every run must pass before its limits are judged
SAME_LOAD = "same load during the stage"
"""Name of the check that a stage fails whose load changed, whatever the limits."""


@dataclass(frozen=True)
class Check:
    """One limit, and whether the run met it.

    Attributes:
        limit: The limit as written.
        passed: Whether the limit is met; a check without a found value is not passed.
        words: Message on the found value, or a remedy if there is no value.
        value: Found value, in ``unit``, or None if it is unknown or not a number.
        low: Lower end of the 90 % interval of the value; None without an interval.
        high: Upper end of the interval.
    """

    limit: str
    passed: bool
    words: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
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
    words = f"{number(found.value)} {found.unit}"
    kept = (limit.text, found.value, found.low, found.high, found.unit)

    def check(passed: bool, more: str) -> Check:
        text, value, low, high, unit = kept
        return Check(text, passed, f"{words}{more}", value, low, high, unit)

    if found.half_width is None or found.low is None or found.high is None:
        return check(
            False, ", without an interval, so that it is not known whether the true value is inside"
        )
    words += f", 90 % interval {number(found.low)} to {number(found.high)}"
    if limit.low <= found.low and found.high <= limit.high:
        return check(True, "")
    if limit.low <= found.value <= limit.high:
        return check(
            False, ": the value is inside the limits, but its interval is not; record more data"
        )
    return check(False, ": outside")


def _bound(limit: Bound, evidence: Evidence) -> Check:
    if limit.measure == "torque error":
        value = evidence.fit_rms
    else:
        measured = QUANTITIES[limit.measure]
        value = measured(evidence.record, evidence.dataset, limit.statistic)
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
