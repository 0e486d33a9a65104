"""Computes the plotted channels of every sample: recorded values, and values derived as in the
safety check.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.canopen.cia402 import decode_state
from drivers.errors import StateError
from drivers.interfaces import ServoState
from identification.model.gas_generator import impacted_area
from identification.recording import Array, Bench
from rig.common.sample import Sample
from rig.control.safety import RUNNING_MASK
from rig.results.run.page.chart import Bins, Envelope, Flags, of_samples
from rig.runs.mcap.reader import Attached, Block, DamageError, Happening, run_items
from rig.runs.run import read_log

NAMES = (
    "command",
    "angle",
    "motor",
    "error",
    "following_error",
    "disagreement",
    "velocity",
    "current",
    "torque",
    "voltage",
    "supply_voltage",
    "temperature",
    "pressure",
    "force",
    "state",
    "age",
    "answer",
    "late",
    "drive_clock",
    "encoder_clock",
)
"""Columns of the values, in SI units.

``motor`` is the joint angle by the motor's encoder, ``error`` the command less the joint angle,
``disagreement`` the joint angle by the motor's encoder less that by the joint encoder, ``torque``
Km i I, ``force`` the contact force computed from the pressure. ``age`` is the time since the last
fresh sample, ``answer`` the time from a cycle's start until its answers had been collected,
``late`` the lateness of a cycle, or zero if it was less than about a period. ``drive_clock`` and
``encoder_clock`` are the times of these devices less the host's, relative to the difference at the
start of the stage.
"""
STATES = ("off", "fault", "quick stop", "enabled")
"""State names of the drive, by the number in ``state``."""
ENABLED = float(STATES.index("enabled"))
PAUSES = frozenset({"stage start", "units", "weight check"})
"""Events after which the control cycle restarts, so that a time step before them does not count as
lateness.
"""
_GAP_CYCLES = 10.0
"""Number of consecutive missing cycles from which on the curve is interrupted."""
_CODES: Mapping[ServoState, str] = {
    ServoState.OPERATION_ENABLED: "enabled",
    ServoState.QUICK_STOP_ACTIVE: "quick stop",
    ServoState.FAULT: "fault",
    ServoState.FAULT_REACTION: "fault",
}


def _code(statusword: int) -> float:
    try:
        return float(STATES.index(_CODES.get(decode_state(statusword), "off")))
    except StateError:
        return math.nan


_STATE = np.array([_code(word) for word in range(RUNNING_MASK + 1)])


class Derived(NamedTuple):
    """Plotted channels of consecutive samples.

    Attributes:
        time: Time, s, shape (n,).
        values: Columns in the order of :data:`NAMES`, shape (n, 20).
        broken: Whether cycles are missing before a sample, or the drive was off.
        segment: Number of the excitation, 0 for none.
    """

    time: Array
    values: Array
    broken: Flags
    segment: Array


@dataclass
class _Carried:
    """State that is carried from one block of samples to the next."""

    time: float = -math.inf
    fresh: float = math.nan
    drive: float = math.nan
    encoder: float = math.nan


class Deriver:
    """Function that derives the plotted channels of consecutive blocks of samples.

    Args:
        bench: Constants of the bench.
        cycle_s: Control cycle, s.

    Attributes:
        starts: Time, s, and command, rad, of the first sample of each stage under power.
    """

    def __init__(self, bench: Bench, cycle_s: float) -> None:
        self._bench = bench
        self._cycle_s = cycle_s
        self._carried = _Carried()
        self.starts: list[tuple[float, float]] = []

    def __call__(
        self, samples: Mapping[str, Array], events: Iterable[Mapping[str, Any]]
    ) -> Derived:
        """Derive one block.

        Args:
            samples: Every field of :class:`rig.common.sample.Sample` to its values, shape (n,).
            events: All events recorded up to the end of the block.
        """
        time = samples["time"]
        pauses = self._pauses(time, events, PAUSES)
        stages = self._pauses(time, events, frozenset({"stage start"}))
        step = np.diff(time, prepend=self._carried.time)
        self.starts += [
            (float(time[k]), float(samples["command"][k])) for k in np.flatnonzero(stages)
        ]
        found = {
            **self._motion(samples),
            **self._gas(samples),
            "state": _STATE[samples["statusword"].astype(np.int64) & RUNNING_MASK],
            **self._times(samples, step, pauses, stages),
        }
        self._carried.time = float(time[-1])
        values = np.column_stack([found.get(name, np.full(len(time), np.nan)) for name in NAMES])
        return Derived(
            time, values, stages | (step > _GAP_CYCLES * self._cycle_s), samples["segment"]
        )

    def _pauses(
        self, time: Array, events: Iterable[Mapping[str, Any]], kinds: frozenset[str]
    ) -> Flags:
        """Return a mask of the samples directly after an event of one of the ``kinds``."""
        flags = np.zeros(len(time), dtype=np.bool_)
        at = np.array(
            [e["time"] for e in events if e["event"] in kinds and e["time"] > self._carried.time]
        )
        index = np.searchsorted(time, at)
        flags[index[index < len(time)]] = True
        return flags

    def _motion(self, samples: Mapping[str, Array]) -> dict[str, Array]:
        motor = samples["motor_angle"] / self._bench.gear_ratio
        plain = ("command", "angle", "following_error", "velocity", "current", "voltage")
        return {
            **{name: samples[name] for name in (*plain, "supply_voltage", "temperature")},
            "motor": motor,
            "error": samples["command"] - samples["angle"],
            "disagreement": motor - samples["angle"],
            "torque": samples["current"] * self._bench.ampere_torque,
        }

    def _gas(self, samples: Mapping[str, Array]) -> dict[str, Array]:
        pressure, generator = samples["pressure"], self._bench.gas_generator
        if generator is None:
            return {"pressure": pressure}
        area = impacted_area(samples["angle"], generator.valve)
        return {"pressure": pressure, "force": (pressure - generator.p_c0) * area}

    def _times(
        self, samples: Mapping[str, Array], step: Array, pauses: Flags, stages: Flags
    ) -> dict[str, Array]:
        time, fresh, carried = samples["time"], samples["fresh"] != 0.0, self._carried
        late = np.where(
            (step > 1.99 * self._cycle_s) & ~pauses & np.isfinite(step), step - self._cycle_s, 0.0
        )
        before = time[0] if math.isnan(carried.fresh) else carried.fresh
        latest = np.maximum.accumulate(np.where(fresh | pauses, time, before))
        carried.fresh = float(latest[-1])
        drive, carried.drive = _since(samples["device_time"] - time, stages, carried.drive)
        encoder, carried.encoder = _since(samples["encoder_time"] - time, stages, carried.encoder)
        return {
            "age": time - latest,
            "answer": samples["host_time"] - time,
            "late": late,
            "drive_clock": drive,
            "encoder_clock": encoder,
        }


def _since(values: Array, starts: Flags, before: float) -> tuple[Array, float]:
    """Return each value of a block less the value at the latest start before or at its sample, and
    the value at the last start up to the end of the block.

    ``starts`` marks the starts; ``before`` is the value at the last start before the block.
    """
    if math.isnan(before):
        before = float(values[0])
    index = np.maximum.accumulate(np.where(starts, np.arange(len(values)), -1))
    zero = np.where(index < 0, before, values[np.maximum(index, 0)])
    return values - zero, float(zero[-1])


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
