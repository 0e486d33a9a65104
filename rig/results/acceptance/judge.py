"""Compares the values of a run with the acceptance limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rig.common.tables import number
from rig.config.acceptance import NOTHING_MISSING, Bound, Limit, Range, Required
from rig.results.acceptance.evidence import Evidence
from rig.results.measured import QUANTITIES, clock_words
from rig.runs.run_record import Ending, Verdict

COMPLETE = "run complete"
"""Name of the check that every run must pass before its limits are judged."""
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
        unit: Unit of ``value``, ``low`` and ``high``.
    """

    limit: str
    passed: bool
    words: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""


def judge(limits: Sequence[Limit], evidence: Evidence) -> tuple[Check, ...]:
    """Return a check of completeness, a failed check for each stage whose load changed, and one
    check for each limit.
    """
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
            return _diagnosis(limit, evidence)
        case Required():
            return _weight(limit, evidence)


def _unknown(limit: Limit, evidence: Evidence, what: str) -> Check:
    return Check(limit.text, False, "; ".join((what, *evidence.problems)))


def _range(limit: Range, evidence: Evidence) -> Check:
    """Judge an identified parameter: its whole 90 % interval must be inside the limits, so that an
    estimate that is inside by chance does not pass (the rule of ISO 14253-1).
    """
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


def _diagnosis(limit: Limit, evidence: Evidence) -> Check:
    if not evidence.diagnosis:
        return _unknown(limit, evidence, "the run was not diagnosed")
    words = f"the diagnosis found: {evidence.diagnosis.replace('_', ' ')}"
    return Check(limit.text, evidence.diagnosis == "nothing_missing", words)


def _weight(limit: Limit, evidence: Evidence) -> Check:
    if not evidence.weights:
        words = (
            "no mass could be checked: the check needs a run with --identification, or stages with "
            "two masses and with the empty lever"
        )
        return Check(limit.text, False, words)
    bad = {s: each for s, each in evidence.weights.items() if each[0] != Verdict.RIGHT.value}
    listed = "; ".join(f"{stage}: {verdict}, {text}" for stage, (verdict, text) in bad.items())
    return Check(limit.text, not bad, listed or f"right in {', '.join(evidence.weights)}")
