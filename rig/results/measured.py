"""Computes the measured quantities of a run for acceptance limits and comparisons."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from identification.effects.own import EffectError
from identification.recording import Array, Dataset, Recording, RecordingError
from rig.common.errors import InputError
from rig.common.places import is_folder
from rig.runs.catalogue.index import bench_name
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

SIMULATED, PACED = ("answer",), ("lateness",)
"""Durations that a simulated bench measures in simulated time: the first always, the second only if
the bench does not run in real time. In real time the lateness is that of this computer.
"""


def clock_words(measure: str, record: RunRecord) -> str:
    """Return a remark on a duration that was measured in simulated time; else an empty text."""
    if record.simulated and measure in (*SIMULATED, *(() if record.realtime else PACED)):
        return ", in simulated time"
    return ""


_SIGNALS: Mapping[str, Callable[[Recording], Array | None]] = {
    "tracking error": lambda r: _difference(r.channels.get("command"), r.channels.get("angle")),
    "disagreement": lambda r: _difference(
        r.channels.get("motor_angle"), r.channels.get("angle"), r.bench.gear_ratio
    ),
    "current": lambda r: r.channels.get("current"),
    "temperature": lambda r: r.channels.get("temperature"),
}
_COUNTS = {"lost samples": ("lost_servo", "lost_encoder"), "missed SYNCs": ("missed_syncs",)}


def _difference(first: Array | None, second: Array | None, ratio: float = 1.0) -> Array | None:
    return None if first is None or second is None else np.asarray(first / ratio - second)


def measured(
    measure: str, record: RunRecord, dataset: Dataset | None, statistic: str
) -> float | None:
    """Return a statistic, SI, of a run and its excitations; None if it was not recorded.

    ``measure`` is one of :data:`rig.config.acceptance.MEASURES`, but not the torque error. Of the
    durations of several recordings the worst counts. Counts and durations are unknown if a
    recording with motion or control cycles has none, because its writer died.
    """
    moved = {segment.part for segment in record.segments}
    used = [p for n, p in enumerate(record.parts, start=1) if p.cycles or n in moved]
    timings = [p.timing for p in used if p.timing] if all(p.timing for p in used) else []
    if measure in _COUNTS:
        names = _COUNTS[measure]
        return float(sum(t[name] for t in timings for name in names)) if timings else None
    if measure not in _SIGNALS:
        found = [t[measure] for t in timings if isinstance(t[measure], Mapping)]
        values = [t.get(f"{statistic}_us") for t in found]
        known = [float(v) for v in values if isinstance(v, int | float)]
        return max(known) * 1e-6 if known and len(known) == len(values) else None
    recordings = dataset.recordings if dataset else ()
    traces = [trace for r in recordings if (trace := _SIGNALS[measure](r)) is not None]
    if not traces or len(traces) < len(recordings):
        return None
    every = np.concatenate(traces)
    if statistic == "worst":
        return float(np.max(np.abs(every)))
    return float(np.sqrt(np.mean(np.square(every))))


@contextmanager
def named_errors(source: Path, remedy: str = "") -> Iterator[None]:
    """Turn an error of recordings, with the name of their source, or of an effect of one's own into
    an InputError.
    """
    try:
        yield
    except RecordingError as error:
        raise InputError(f"{source}: {error}{remedy}") from error
    except EffectError as error:
        raise InputError(str(error)) from error


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
