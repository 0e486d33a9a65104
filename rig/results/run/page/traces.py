"""Reads a recording for plotting: the whole recording in reduced form, and its end sample by
sample.

Whole files are streamed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from identification.recording import Array, Bench
from rig.common.sample import Sample
from rig.results.run.page.channels import NAMES, Derived, Deriver
from rig.results.run.page.envelope import Bins, Envelope, of_samples
from rig.runs.mcap.records import DamageError
from rig.runs.mcap.stream import Attached, Block, Happening, run_items
from rig.runs.run_samples import read_log

TAIL_S = 8.0
"""Time at the end of a recording that is kept sample by sample, s; braking takes up to 1 s of this
time.
"""


@dataclass
class Traces:
    """Content of a recording for plotting.

    Attributes:
        bins: All samples, reduced, or None if no cycle was recorded.
        tail: The last :data:`TAIL_S` of the recording, sample by sample, or None if no cycle was
            recorded.
        events: Events in order; each has ``time`` and ``event``.
        attachments: Name to content.
        starts: Time, s, and command, rad, of the first sample of each stage under power.
        extremes: Channel to its least and greatest value; channels without values are omitted.
        count: Number of samples.
        damage: None for a complete file, else a message on the damage.
    """

    bins: Bins | None = None
    tail: Derived | None = None
    events: list[Mapping[str, Any]] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    starts: list[tuple[float, float]] = field(default_factory=list)
    extremes: dict[str, tuple[float, float]] = field(default_factory=dict)
    count: int = 0
    damage: str | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """Time of the first and the last sample, s; requires samples."""
        assert self.bins is not None
        return float(self.bins.start[0]), float(self.bins.stop[-1])


def read_traces(path: Path, bench: Bench, cycle_s: float) -> Traces:
    """Read one recording of a run.

    A recording that was not closed in order is read at once, and its damage is reported.

    Args:
        path: The recording.
        bench: Constants of the bench.
        cycle_s: Control cycle, s.

    Raises:
        InputError: The file cannot be opened, or is not a recording.
    """
    try:
        return _gathered(run_items(path, Sample._fields), bench, cycle_s)
    except (DamageError, OSError):
        log = read_log(path)
    found = _gathered(_items(log.samples, log.events), bench, cycle_s)
    found.attachments.update(log.attachments)
    found.damage = log.damage
    return found


def _items(
    samples: Mapping[str, Array], events: tuple[Mapping[str, Any], ...]
) -> Iterator[Block | Happening]:
    yield from (Happening(event) for event in events)
    if len(samples["time"]):
        yield Block(samples)


def _gathered(
    items: Iterator[Block | Happening | Attached], bench: Bench, cycle_s: float
) -> Traces:
    traces, envelope, derive = Traces(), Envelope(), Deriver(bench, cycle_s)
    tail: list[Derived] = []
    for item in items:
        if isinstance(item, Happening):
            traces.events.append(item.event)
        elif isinstance(item, Attached):
            traces.attachments[item.name] = item.content
        else:
            derived = derive(item.samples, traces.events)
            traces.count += len(derived.time)
            envelope.add(of_samples(derived.time, derived.values, derived.broken))
            tail.append(derived)
            while len(tail) > 1 and tail[1].time[0] < derived.time[-1] - TAIL_S:
                tail.pop(0)
    traces.starts = derive.starts
    traces.bins = envelope.bins()
    if traces.bins is not None:
        joined = Derived(*(np.concatenate(fields) for fields in zip(*tail, strict=True)))
        keep = joined.time >= joined.time[-1] - TAIL_S
        traces.tail = Derived(*(values[keep] for values in joined))
        traces.extremes = _extremes(traces.bins)
    return traces


def _extremes(bins: Bins) -> dict[str, tuple[float, float]]:
    low, high = np.fmin.reduce(bins.low, axis=0), np.fmax.reduce(bins.high, axis=0)
    return {
        name: (float(least), float(most))
        for name, least, most in zip(NAMES, low, high, strict=True)
        if least == least
    }
