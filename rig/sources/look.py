"""Describes the content of a log for ``rig look``; converts and repairs nothing."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from identification.model.parameters import LINEAR
from identification.recording import CHANNELS, Array, Recording
from rig.common.errors import InputError
from rig.common.places import usable
from rig.config.campaign_sections import ReadSection
from rig.sources.channels import POSITIONS, on_one_time, starts_again, unwrapped, unwrapped_counts
from rig.sources.columns import (
    UNITS,
    Guess,
    channel_unit,
    guess_channels,
    is_linear,
    split_unit,
)
from rig.sources.formats import FORMATS, open_table, unknown_format
from rig.sources.plausible import findings
from rig.sources.repair import GAP_PERIODS, MIN_SAMPLES, other_unit
from rig.sources.table import Table, format_of

STRIP = 40
FLICKER_SHARE = 0.02
"""Share of reversed steps to a neighbouring value above which a column counts as flickering."""
_INDEX = re.compile(r"\[\d+\]$")
_COARSE = 1000
"""Greatest number of different values of a column for which the quantisation step is determined."""


@dataclass(frozen=True)
class Column:
    """One column of a log.

    Attributes:
        scale: SI units per unit of the column; 1 if the unit is unknown.
        step: Quantisation step of a coarse column; 0 if none was found.
        flicker: Share of steps to a neighbouring value that the next step reverses.
        wrap: Text on a counter that overflows; empty for none.
        turn: Change after which the column starts again, where a campaign must state it.
        course: Means of equal parts of the column, for a picture, at most :data:`STRIP` values.
    """

    name: str
    index: int
    channel: str
    unit: str
    scale: float
    samples: int
    missing: int
    least: float
    greatest: float
    step: float
    flicker: float
    wrap: str
    problem: str
    course: tuple[float, ...]
    turn: float | None = None


@dataclass(frozen=True)
class Clock:
    """Time base of a log, s; percentiles 5, 50 and 95 of the steps, and counts of odd ones."""

    column: int
    scale: float
    period_s: float
    low_s: float
    high_s: float
    gaps: int
    longest_s: float
    backwards: int
    repeated: int


@dataclass(frozen=True)
class Look:
    """Content of a log, with the guessed channels, and their contradictions as doubts."""

    name: str
    format: str
    columns: tuple[Column, ...]
    clock: Clock | None
    guesses: Mapping[str, Guess]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def look_at_file(path: Path, options: ReadSection) -> Look:
    """Describe a file of any format of campaigns; raise an InputError if it cannot be read."""
    kind = format_of(path)
    if kind not in FORMATS:
        raise InputError(f"{path}: {unknown_format(path)}")
    with usable(path, "read"):
        table = open_table(path, options)
        series = _series(table)
    units = table.units or ("",) * len(table.names)
    stated = [
        f"{name} [{unit.strip('[]()')}]" if unit else name
        for name, unit in zip(table.names, (*units, *[""] * len(table.names)), strict=False)
    ]
    # For an MCAP field, a member of a struct and an element of a list, the guess uses the last part
    # of the name, without the index.
    leaves = [_INDEX.sub("", name.rsplit(".", 1)[-1]) for name in stated]
    guesses = {
        channel: guess._replace(column=leaves.index(str(guess.column)))
        for channel, guess in guess_channels(leaves, is_linear(leaves)).items()
    }
    guesses = _time_of_most(table, leaves, guesses)
    columns = tuple(
        _column(
            *(k, table.names[k], split_unit(leaves[k])[1], series[k], guesses),
            scale=table.counts.get(k),
        )
        for k in range(len(table.names))
    )
    time = guesses.get("time")
    clock = None
    if time is not None and isinstance(time.column, int):
        found = series[time.column]
        clock = _clock(time.column, found, time.scale) if isinstance(found, np.ndarray) else None
    doubted = _doubts(table, series, guesses)
    return Look(path.name, kind, columns, clock, guesses, table.notes, doubted)


def _time_of_most(table: Table, leaves: list[str], guesses: dict[str, Guess]) -> dict[str, Guess]:
    """Return the guesses, with the time column of the time base of most guessed channels."""
    if not table.bases or "time" not in guesses or len(guesses) < 2:
        return guesses
    bases = [table.bases[int(g.column)] for name, g in guesses.items() if name != "time"]
    most = max(dict.fromkeys(bases), key=bases.count)
    own = [k if table.bases[k] == most else -1 for k in range(len(leaves))]
    there = {k: leaves[k] for k in own if k >= 0}
    time = guess_channels(there.values(), is_linear(there.values())).get("time")
    if time is None:
        return guesses
    place = next(k for k, leaf in there.items() if leaf == time.column)
    return guesses | {"time": time._replace(column=place)}


def _doubts(
    table: Table, series: list[Array | str], guesses: Mapping[str, Guess]
) -> tuple[str, ...]:
    """Return the notes that the loading of a campaign would give on the guessed channels."""
    data = {k: values for k, values in enumerate(series) if isinstance(values, np.ndarray)}
    used = {name: int(g.column) for name, g in guesses.items() if int(g.column) in data}
    if "time" not in used:
        return ()
    clock = _clock(used["time"], data[used["time"]], guesses["time"].scale)
    doubt = other_unit(clock.period_s) if clock is not None else ""
    first = tuple(filter(None, [doubt]))
    try:
        raw, _, _ = on_one_time(table, used, data, {})
    except InputError as error:
        return (*first, *error.problems)
    channels = {name: values * guesses[name].scale for name, values in raw.items()}
    rows = len(channels["time"])
    channels = {name: values for name, values in channels.items() if len(values) == rows}
    known = np.isfinite(channels["time"])
    known &= np.concatenate(([True], np.diff(channels["time"]) > 0))
    channels = {name: values[known] for name, values in channels.items()}
    if len(channels["time"]) < MIN_SAMPLES:
        return first
    if "angle" not in channels:
        # The gear ratio is not known, and the speed may be that of the motor or of the joint.
        channels.pop("velocity", None)
    problems, notes = findings(channels, None, driven_by_weight=False, has_lever=False)
    return (*first, *problems, *notes)


def look_at_recording(recording: Recording) -> Look:
    """Describe the channels of a recording from a run folder or a campaign, in SI units."""
    guesses = {name: Guess(k, 1.0) for k, name in enumerate(recording.channels)}
    linear = recording.bench.motion == LINEAR
    columns = tuple(
        _column(k, name, channel_unit(name, linear) if name in CHANNELS else "", values, guesses)
        for k, (name, values) in enumerate(recording.channels.items())
    )
    clock = _clock(list(recording.channels).index("time"), recording.time, 1.0)
    return Look(recording.name, "recording", columns, clock, guesses, recording.notes)


def _series(table: Table) -> list[Array | str]:
    """Read every column; a column that does not contain numbers gives an error message instead."""
    every = range(len(table.names))
    try:
        return list(table.read(every))
    except InputError:
        found: list[Array | str] = []
    for k in every:
        try:
            found.append(table.read([k])[0])
        except InputError as error:
            found.append(error.problems[0])
    if found and all(isinstance(values, str) for values in found):
        raise InputError(dict.fromkeys(str(values) for values in found))
    return found


def _column(
    index: int,
    name: str,
    unit: str,
    values: Array | str,
    guesses: Mapping[str, Guess],
    scale: tuple[float, float] | None = None,
) -> Column:
    channel = next((c for c, guess in guesses.items() if guess.column == index), "")
    si, size = UNITS.get(unit, ("", 1.0))
    if channel and si != channel_unit(channel):
        size = 1.0
    wrap = unwrapped if scale is None else partial(unwrapped_counts, scale=scale)
    nan = float("nan")
    if isinstance(values, str):
        return Column(name, index, channel, unit, size, 0, 0, nan, nan, 0.0, 0.0, "", values, ())
    known = values[np.isfinite(values)]
    step = _step(known)
    note = wrap(channel or "angle", values)[1]
    turn = starts_again(values) if not note and channel in ("", *POSITIONS) else None
    if turn is not None:
        note = f"starts again after {turn.after:.6g} ({turn.times} x): state `wraps_after`"
    return Column(
        name=name,
        index=index,
        channel=channel,
        unit=unit,
        scale=size,
        samples=len(values),
        missing=len(values) - len(known),
        least=float(known.min()) if known.size else nan,
        greatest=float(known.max()) if known.size else nan,
        step=step,
        flicker=_flicker(known, step),
        wrap=note,
        turn=None if turn is None else turn.after,
        problem="",
        course=tuple(
            float(np.mean(part[np.isfinite(part)])) if np.isfinite(part).any() else nan
            for part in np.array_split(values, max(1, min(STRIP, len(values))))
        ),
    )


def _step(known: Array) -> float:
    """Return the least distance between two values if all distances are its multiples, else 0."""
    levels = np.unique(known[: 1 << 20])
    if not 2 <= len(levels) <= max(_COARSE, len(known) // 10):
        return 0.0
    least = float(np.min(np.diff(levels)))
    ratio = np.diff(levels) / least
    return least if np.all(np.abs(ratio - np.rint(ratio)) < 0.01 * np.rint(ratio)) else 0.0


def _flicker(known: Array, step: float) -> float:
    if step == 0.0 or len(known) < 3:
        return 0.0
    steps = np.rint(np.diff(known) / step)
    back = (np.abs(steps[:-1]) == 1) & (steps[1:] == -steps[:-1])
    share = float(np.mean(back))
    return share if share > FLICKER_SHARE else 0.0


def _clock(column: int, values: Array, scale: float) -> Clock | None:
    known = values[np.isfinite(values)]
    if len(known) < 3:
        return None
    steps = np.diff(unwrapped("time", known)[0]) * scale
    low, period, high = (float(q) for q in np.percentile(steps, [5, 50, 95]))
    gaps = steps > GAP_PERIODS * period
    return Clock(
        column,
        scale,
        period,
        low,
        high,
        int(gaps.sum()) if period > 0 else 0,
        float(steps.max()),
        int((steps < 0).sum()),
        int((steps == 0).sum()),
    )
