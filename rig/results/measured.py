"""Computes the measured quantities of a run for acceptance limits and comparisons."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from identification.recording import Array, Dataset, Recording
from rig.common.errors import InputError
from rig.common.places import is_folder
from rig.runs.catalogue.index import bench_name
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

Measured = Callable[[RunRecord, Dataset | None, str], float | None]
"""Computes a statistic, SI, of a run and its excitations; None if it was not recorded."""
SIMULATED, PACED = ("answer",), ("lateness",)
"""Durations that a simulated bench measures in simulated time: the first always, the second only if
the bench does not run in real time. In real time the lateness is that of this computer.
"""


def clock_words(measure: str, record: RunRecord) -> str:
    """Return a remark on a duration that was measured in simulated time; else an empty text."""
    if record.simulated and measure in (*SIMULATED, *(() if record.realtime else PACED)):
        return ", in simulated time"
    return ""


def _timing(part: str) -> Measured:
    """Return the statistic of a timing histogram, s; of several recordings the worst counts."""

    def measured(record: RunRecord, dataset: Dataset | None, statistic: str) -> float | None:
        timings = [p.timing[part] for p in record.parts if p.timing]
        values = [t.get(f"{statistic}_us") for t in timings if isinstance(t, Mapping)]
        known = [float(v) for v in values if isinstance(v, int | float)]
        return max(known) * 1e-6 if known and len(known) == len(values) else None

    return measured


def _count(*names: str) -> Measured:
    def measured(record: RunRecord, dataset: Dataset | None, statistic: str) -> float | None:
        timings = [p.timing for p in record.parts if p.timing]
        return float(sum(t[name] for t in timings for name in names)) if timings else None

    return measured


def _trace(of: Callable[[Recording], Array | None]) -> Measured:
    """Return rms or greatest magnitude of a signal over all excitations."""

    def measured(record: RunRecord, dataset: Dataset | None, statistic: str) -> float | None:
        recordings = dataset.recordings if dataset else ()
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


QUANTITIES: Mapping[str, Measured] = {
    "lateness": _timing("lateness"),
    "answer": _timing("answer"),
    "tracking error": _trace(_difference("command", "angle")),
    "disagreement": _trace(_difference("motor_angle", "angle", ratio=True)),
    "current": _trace(lambda recording: recording.channels.get("current")),
    "temperature": _trace(lambda recording: recording.channels.get("temperature")),
    "lost samples": _count("lost_servo", "lost_encoder"),
    "missed SYNCs": _count("missed_syncs"),
}
"""Functions of :data:`rig.config.acceptance.MEASURES`, except the torque error."""


def facts_of(source: Path) -> tuple[tuple[str, str], ...]:
    """Return bench, date and operator of a run, or the file of a campaign."""
    if not is_folder(source):
        return (("campaign", source.name),)
    try:
        record = read_record(source)
    except InputError:
        return (("run", source.name),)
    kind = "simulated" if record.simulated else "REAL BENCH"
    return (
        ("bench", f"{bench_name(source, record)} ({kind})"),
        ("begun", record.created.replace("T", " ").replace("+00:00", " UTC")),
        ("operator", record.operators_words),
        ("sequence", record.name),
    )
