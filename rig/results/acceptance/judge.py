"""Compares the values of a run with the acceptance limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.recording import Array, Recording
from rig.common.tables import number
from rig.config.acceptance import NOTHING_MISSING, Bound, Limit, Range, Required
from rig.results.acceptance.evidence import Evidence
from rig.runs.run_record import Ending, Verdict

COMPLETE = "run complete"
"""Name of the check that every run must pass before its limits are judged."""

_SIMULATED, _PACED = ("answer",), ("lateness",)
"""Durations that a simulated bench has in simulated time: always, or unless it runs in real time;
in real time the lateness is that of this computer.
"""


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
    """Return a check of completeness, and one check for each limit."""
    return (_complete(evidence), *(_judged(limit, evidence) for limit in limits))


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
    value = _MEASURED[limit.measure](evidence, limit.statistic)
    if value is None or not math.isfinite(value):
        return _unknown(limit, evidence, f"{limit.measure} was not recorded")
    shown = value / limit.scale
    name = f"{limit.measure} {limit.statistic}".strip()
    words = f"{name} {number(shown, 4)} {limit.unit}".strip() + _clock(limit, evidence)
    return Check(limit.text, limit.holds(shown), words, shown, unit=limit.unit)


def _clock(limit: Bound, evidence: Evidence) -> str:
    """Return a remark on a duration that was measured in simulated time."""
    record = evidence.record
    if record.simulated and limit.measure in (*_SIMULATED, *([] if record.realtime else _PACED)):
        return ", in simulated time"
    return ""


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


def _timing(part: str) -> Callable[[Evidence, str], float | None]:
    """Return the function that computes a statistic of a timing histogram, s; of the values of all
    recordings, the worst counts.
    """

    def measured(evidence: Evidence, statistic: str) -> float | None:
        timings = [p.timing[part] for p in evidence.record.parts if p.timing]
        values = [t.get(f"{statistic}_us") for t in timings if isinstance(t, Mapping)]
        known = [float(v) for v in values if isinstance(v, int | float)]
        return max(known) * 1e-6 if known and len(known) == len(values) else None

    return measured


def _count(*names: str) -> Callable[[Evidence, str], float | None]:
    def measured(evidence: Evidence, statistic: str) -> float | None:
        timings = [p.timing for p in evidence.record.parts if p.timing]
        return float(sum(t[name] for t in timings for name in names)) if timings else None

    return measured


def _trace(of: Callable[[Recording], Array | None]) -> Callable[[Evidence, str], float | None]:
    """Return the function that computes rms or greatest magnitude of a signal over all
    excitations.
    """

    def measured(evidence: Evidence, statistic: str) -> float | None:
        recordings = evidence.dataset.recordings if evidence.dataset else ()
        traces = [trace for each in recordings if (trace := of(each)) is not None]
        if not traces or len(traces) < len(recordings):
            return None
        every = np.concatenate(traces)
        if statistic == "worst":
            return float(np.max(np.abs(every)))
        return float(np.sqrt(np.mean(np.square(every))))

    return measured


def _difference(
    first: str, second: str, ratio: bool = False
) -> Callable[[Recording], Array | None]:
    def of(recording: Recording) -> Array | None:
        one, other = recording.channels.get(first), recording.channels.get(second)
        if one is None or other is None:
            return None
        return np.asarray((one / recording.bench.gear_ratio if ratio else one) - other)

    return of


_MEASURED: Mapping[str, Callable[[Evidence, str], float | None]] = {
    "lateness": _timing("lateness"),
    "answer": _timing("answer"),
    "tracking error": _trace(_difference("command", "angle")),
    "disagreement": _trace(_difference("motor_angle", "angle", ratio=True)),
    "current": _trace(lambda recording: recording.channels.get("current")),
    "temperature": _trace(lambda recording: recording.channels.get("temperature")),
    "torque error": lambda evidence, statistic: evidence.fit_rms,
    "lost samples": _count("lost_servo", "lost_encoder"),
    "missed SYNCs": _count("missed_syncs"),
}
"""Functions that compute the quantities of :data:`rig.config.acceptance.MEASURES`, SI units."""
