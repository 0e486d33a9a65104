"""Builds recordings in SI units from one file and its entry in the campaign."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array, Bench, Recording
from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.config.campaign import Campaign
from rig.config.campaign_sections import ANGLE_TIME, ChannelSection, RecordingSection
from rig.config.configuration import Document, Loc, nearest
from rig.runs.alignment import aligned
from rig.sources.contradictions import doubts, unit_row_doubts
from rig.sources.formats import open_table
from rig.sources.plausible import gear_finding, sign_errors, unit_hints, value_errors
from rig.sources.repair import (
    MIN_SAMPLES,
    MISSING_SHARE,
    Mask,
    Timing,
    UnusableError,
    examine_time,
    fill_missing,
)
from rig.sources.table import Table
from rig.sources.wraps import unwrapped

Rows = NDArray[np.intp]

SLOW = frozenset({"supply_voltage", "temperature", "pressure"})
"""Channels often logged at a lower rate: their missing samples are interpolated without limit."""


def build(
    file: Path, section: RecordingSection, bench: Bench, document: Document[Campaign], index: int
) -> list[Recording]:
    """Read one file, convert it to SI, and make the allowed corrections.

    Args:
        file: The recording.
        section: Its entry in the campaign.
        bench: The machine.
        document: The campaign, to point at the entry in errors.
        index: Position of the entry in ``recordings``.

    Returns:
        One recording per piece without gaps; every correction is in its notes.

    Raises:
        InputError: A column is missing, or the data cannot be used; names file and row.
    """
    try:
        table = open_table(file, section.read)
        channels, found = _read_channels(table, section, document, index)
        digest = sha256_file(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from error
    channels, timing, mended = _mend(table, channels, stamped=section.rate is None)
    stamps = channels.pop(ANGLE_TIME, None)
    notes = [*table.notes, *found, *mended, *unit_row_doubts(table, section)]
    problems = list(value_errors(channels))
    if not problems:
        problems += sign_errors(channels, driven_by_weight=section.gravity is not None)
        notes += unit_hints(channels, bench.gear_ratio, has_lever=bench.moment_arm is not None)
        notes += doubts(channels, bench.gear_ratio, driven_by_weight=section.gravity is not None)
    if "motor_angle" in channels and "angle" in channels:
        finding = gear_finding(channels["motor_angle"], channels["angle"], bench.gear_ratio)
        if finding is not None:
            (problems if finding[1] else notes).append(finding[0])
    if problems:
        raise InputError(f"{file}: {problem}" for problem in problems)
    constant = [
        name for name, values in channels.items() if name != "enabled" and _is_constant(values)
    ]
    notes.extend(f"`{name}` is constant ({channels[name][0]:.6g})" for name in constant)
    whole = Recording(
        name=_stem(file),
        channels=channels,
        bench=bench,
        stage=section.stage,
        weight_mass=section.weight_mass,
        pendulum=section.gravity.pendulum() if section.gravity else None,
        controller=section.controller.controller() if section.controller else None,
        role=section.role,
        averaged=frozenset(name for name, channel in section.channels.items() if channel.average),
        source=str(file),
        sha256=digest,
        notes=tuple(notes),
    )
    return _cut(whole, timing, stamps)


def _read_channels(
    table: Table, section: RecordingSection, document: Document[Campaign], index: int
) -> tuple[dict[str, Array], list[str]]:
    """Return canonical channels in SI units, all of shape (n,), time among them, and notes."""
    columns: dict[str, int] = {}
    problems = []
    notes: list[str] = []
    for name, channel in section.channels.items():
        found = _find(table, channel.column)
        if isinstance(found, int):
            columns[name] = found
            if isinstance(channel.column, str) and table.names[found] != channel.column:
                notes.append(f"`{name}`: {channel.column!r} is column {table.names[found]!r}")
        else:
            problems.append(document.problem(_column_loc(index, name), found, channel.column))
    if problems:
        raise InputError(problems)
    # A column may feed several channels; it is read once.
    wanted = sorted(set(columns.values()))
    data = dict(zip(wanted, table.read(wanted), strict=True))
    lengths = {name: len(data[column]) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise InputError(
            f"{table.path}: channels differ in length: {listed}; they must share their rows"
        )
    channels = {}
    for name, column in columns.items():
        values, note = unwrapped(name, data[column])
        notes += [f"`{name}`: {note}"] if note else []
        channels[name] = _to_si(values, section.channels[name])
    if section.rate is not None:
        channels["time"] = np.arange(next(iter(lengths.values()))) / section.rate
    return channels, notes


def _find(table: Table, column: str | int) -> int | str:
    """Return a column's index, or an error message."""
    if isinstance(column, int):
        count = len(table.names)
        return (
            column
            if column < count
            else f"{table.path} has {count} columns, index 0 to {count - 1}"
        )
    matches = [k for k, name in enumerate(table.names) if name == column]
    if len(matches) == 1:
        return matches[0]
    if not matches:
        matches = [k for k, name in enumerate(table.names) if name.endswith(f".{column}")]
        if len(matches) == 1:
            return matches[0]
    if matches:
        return (
            f"{table.path} has {len(matches)} columns of this name; give the index, one of "
            f"{matches}"
        )
    named = [name for name in table.names if name]
    if not named:
        return (
            f"{table.path} has no header line below the skipped rows; give the index, 0 to "
            f"{len(table.names) - 1}"
        )
    listed = f"columns are {', '.join(named[:20])}{', ...' if len(named) > 20 else ''}"
    suggestion = nearest(column, named)
    return f"no such column in {table.path}; " + (
        f"{suggestion} {listed}" if "did you" in suggestion else listed
    )


def _column_loc(index: int, name: str) -> Loc:
    return ("recordings", index, "channels", name)


def _to_si(values: Array, channel: ChannelSection) -> Array:
    if channel.scale == 1.0 and channel.offset == 0.0:
        return np.ascontiguousarray(values)
    scaled: Array = values * channel.scale
    scaled += channel.offset
    return scaled


def _mend(
    table: Table, channels: dict[str, Array], *, stamped: bool
) -> tuple[dict[str, Array], Timing, list[str]]:
    """Check time, fill isolated missing samples, drop repeated time stamps.

    Rows of other topics are dropped only where rows have stamps (``stamped``): with a rate, each
    row is a sample.
    """
    dropped: list[str] = []
    rows: Rows | None = None
    if stamped:
        channels, dropped, rows = _without_other_topics(channels)
    time = channels["time"]
    try:
        timing = examine_time(time)
    except UnusableError as error:
        raise InputError(_at(table, error, "", rows)) from None
    notes = [*dropped, *timing.notes]
    problems = []
    off = _power_off(table, channels, rows)
    mended: dict[str, Array] = {}
    for name, values in channels.items():
        try:
            mended[name], note = _fill(name, values, time, off)
        except UnusableError as error:
            problems.append(_at(table, error, f"`{name}`: ", rows) + _apart(name, channels))
            continue
        notes.extend(note)
    if problems:
        raise InputError(problems)
    if timing.keep is not None:
        mended = {name: values[timing.keep] for name, values in mended.items()}
    return mended, timing, notes


def _power_off(table: Table, channels: dict[str, Array], rows: Rows | None) -> Mask | None:
    """Return where the power stage is off, making ``enabled`` 0 or 1 on the way."""
    if "enabled" not in channels:
        return None
    unknown = np.flatnonzero(~np.isfinite(channels["enabled"]))
    if unknown.size:
        row = int(unknown[0]) if rows is None else int(rows[unknown[0]])
        raise InputError(
            f"{table.place(row)}: `enabled` is missing in {unknown.size} rows; it must be known"
        )
    on = channels["enabled"] > 0.5
    channels["enabled"] = on.astype(np.float64)
    return ~on


def _fill(name: str, values: Array, time: Array, off: Mask | None) -> tuple[Array, list[str]]:
    if name in SLOW:
        finite = np.isfinite(values)
        count = int(len(values) - finite.sum())
        if count in (0, len(values)):
            return values, [f"`{name}` was never measured"] if count else []
        return np.interp(time, time[finite], values[finite]), [
            f"`{name}`: {count} missing samples interpolated"
        ]
    filled, count = fill_missing(values, time, off if name == "voltage" else None)
    return filled, [f"`{name}`: {count} missing samples interpolated"] if count else []


def _without_other_topics(
    channels: dict[str, Array],
) -> tuple[dict[str, Array], list[str], Rows | None]:
    """Drop rows that hold a time and none of the channels: rows of another topic in a sparse log.

    A few rows without values are missing samples, which are interpolated instead.
    """
    others = [values for name, values in channels.items() if name != "time"]
    empty = np.logical_and.reduce([np.isnan(values) for values in others])
    count = int(empty.sum())
    if count <= MISSING_SHARE * len(empty) or len(empty) - count < MIN_SAMPLES:
        return channels, [], None
    note = f"{count} rows with a time only, as of another topic, dropped"
    kept = {name: values[~empty] for name, values in channels.items()}
    return kept, [note], np.flatnonzero(~empty)


def _apart(name: str, channels: dict[str, Array]) -> str:
    """Return a remedy where a channel shares no row with another one."""
    known = np.isfinite(channels[name])
    for other, values in channels.items():
        if other != name and not np.any(known & np.isfinite(values)):
            return (
                f"; it shares no row with `{other}`: they are of different topics, so bring them "
                f"to one time base first"
            )
    return ""


def _at(table: Table, error: UnusableError, channel: str, rows: Rows | None) -> str:
    row = error.row if rows is None or error.row is None else int(rows[error.row])
    place = str(table.path) if row is None else table.place(row)
    hint = ""
    if channel == "`voltage`: ":
        hint = "; where the power stage was off, say so with an `enabled` channel"
    return f"{place}: {channel}{error}{hint}"


def _cut(whole: Recording, timing: Timing, stamps: Array | None) -> list[Recording]:
    """Return one recording per piece, numbered from 1 where there are several, each on one
    clock.
    """
    n = len(whole.time)
    if timing.pieces == ((0, n),):
        return [_on_one_clock(whole, stamps)]
    cut = [
        replace(
            whole,
            name=f"{whole.name}[{number}]",
            channels={name: values[start:stop] for name, values in whole.channels.items()},
        )
        for number, (start, stop) in enumerate(timing.pieces, start=1)
    ]
    parts = [None if stamps is None else stamps[start:stop] for start, stop in timing.pieces]
    return [_on_one_clock(recording, part) for recording, part in zip(cut, parts, strict=True)]


def _on_one_clock(recording: Recording, stamps: Array | None) -> Recording:
    if stamps is None:
        return recording
    channels, words = aligned(
        recording.channels, stamps, recording.averaged, recording.bench.gear_ratio
    )
    return (
        replace(recording, channels=channels, notes=(*recording.notes, words))
        if words
        else recording
    )


def _is_constant(values: Array) -> bool:
    return bool(np.all(values == values[0]))


def _stem(file: Path) -> str:
    return (file.with_suffix("") if file.suffix.lower() == ".gz" else file).stem
