"""Builds recordings in SI units from one file and the entry of this file in the campaign."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array, Bench, Recording
from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.config.campaign import Campaign
from rig.config.campaign_sections import ANGLE_TIME, RecordingSection
from rig.config.configuration import Document
from rig.runs.alignment import aligned
from rig.sources.channels import read_channels
from rig.sources.contradictions import doubts, unit_row_doubts
from rig.sources.formats import Table
from rig.sources.plausible import (
    gear_finding,
    sign_errors,
    unit_hints,
    value_errors,
)
from rig.sources.readers import open_table
from rig.sources.repair import (
    MIN_SAMPLES,
    MISSING_SHARE,
    UNEVEN,
    Mask,
    Timing,
    UnusableError,
    examine_time,
    fill_missing,
)
from rig.sources.session import Read
from rig.sources.stamps import even_stamps

Rows = NDArray[np.intp]

ANGLES = ("motor_angle", "angle")
"""Channels by whose values uneven sampling is detected, the channel with finer steps first."""
SLOW = frozenset({"supply_voltage", "temperature", "pressure"})
"""Channels that are often logged at a lower rate; all missing samples of these are interpolated."""


def build(
    file: Path, section: RecordingSection, bench: Bench, document: Document[Campaign], index: int
) -> Read:
    """Read one file, convert its channels to SI units, and make the allowed corrections.

    Args:
        file: The recording.
        section: Entry of the file in the campaign.
        bench: Constants of the machine.
        document: The campaign; error messages state the line of the entry.
        index: Position of the entry in ``recordings``.

    Returns:
        One recording per piece without gaps, with its corrections as notes, and the time span of
        the whole file, also outside the window.

    Raises:
        InputError: A column or a sample in the window is missing, or the data cannot be used.
    """
    unsure = document.value.bench.uncertainties()
    if section.moment_arm is not None:
        bench = replace(bench, moment_arm=float(section.moment_arm))
        unsure.pop("bench.moment_arm", None)
    try:
        table = open_table(file, section.read.beside(document.path.parent))
        channels, unread, found = read_channels(table, section, document, index)
        digest = sha256_file(file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from error
    finite = channels["time"][np.isfinite(channels["time"])]
    first, last = (float(finite[0]), float(finite.max())) if finite.size else (0.0, 0.0)
    channels, skipped, cut = _windowed(file, channels, section)
    channels, timing, mended = _mend(
        table, channels, unread + skipped, stamped=section.rate is None
    )
    stamps = channels.pop(ANGLE_TIME, None)
    found += [*cut, *mended, *unit_row_doubts(table, section)]
    doubted = _doubts(file, channels, section, bench)
    notes = [*table.notes, *found, *doubted, *_load_notes(section, bench)]
    whole = Recording(
        name=_stem(file),
        channels=channels,
        bench=bench,
        stage=section.stage,
        weight_mass=float(section.weight_mass),
        pendulum=section.gravity.pendulum() if section.gravity else None,
        hoist=section.hoisted.hoist() if section.hoisted else None,
        constant_torque=float(section.constant_torque),
        uncertainties={**unsure, **section.uncertainties()},
        controller=section.controller.controller() if section.controller else None,
        role=section.role,
        averaged=frozenset(name for name, channel in section.channels.items() if channel.average),
        source=str(file),
        sha256=digest,
        notes=tuple(notes),
    )
    return Read(tuple(_cut(whole, timing, stamps)), first, last, section, index)


def _doubts(
    file: Path, channels: dict[str, Array], section: RecordingSection, bench: Bench
) -> list[str]:
    """Return notes on channels with implausible values.

    Raises:
        InputError: Values are impossible, or the signs of two channels contradict each other.
    """
    notes: list[str] = []
    problems = list(value_errors(channels))
    if not problems:
        problems += sign_errors(channels, driven_by_weight=section.known_load)
        notes += unit_hints(channels, bench.gear_ratio, has_lever=bench.moment_arm is not None)
        notes += doubts(channels, bench.gear_ratio, driven_by_weight=section.known_load)
    if "motor_angle" in channels and "angle" in channels:
        finding = gear_finding(channels["motor_angle"], channels["angle"], bench.gear_ratio)
        if finding is not None:
            (problems if finding[1] else notes).append(finding[0])
    if problems:
        raise InputError(f"{file}: {problem}" for problem in problems)
    constant = [
        name for name, values in channels.items() if name != "enabled" and _is_constant(values)
    ]
    return [*notes, *(f"`{name}` is constant ({channels[name][0]:.6g})" for name in constant)]


def _windowed(
    file: Path, channels: dict[str, Array], section: RecordingSection
) -> tuple[dict[str, Array], int, list[str]]:
    """Return the channels within the window of the section, the number of rows before the window,
    and notes.

    All rows between the first and the last sample of the window are used, so that the later checks
    find missing time stamps and time that runs backwards.

    Raises:
        InputError: The window contains no sample.
    """
    window, time = section.window, channels["time"]
    if window is None:
        return channels, 0, []
    low = -np.inf if window.begin is None else window.begin
    high = np.inf if window.to is None else window.to
    rows = np.flatnonzero((time >= low) & (time < high))
    if not rows.size:
        finite = time[np.isfinite(time)]
        there = f"{finite.min():.6g} to {finite.max():.6g} s" if finite.size else "nowhere"
        raise InputError(
            f"{file}: the window {window.words()} holds no sample: the file's time runs from "
            f"{there}, after scale and offset; change the window"
        )
    # If an end of the window is open, the rows without time beyond this end are checked as well.
    first = 0 if window.begin is None else int(rows[0])
    stop = len(time) if window.to is None else int(rows[-1]) + 1
    note = f"window {window.words()}: {stop - first} of {len(time)} samples used"
    return {name: values[first:stop] for name, values in channels.items()}, first, [note]


def _load_notes(section: RecordingSection, bench: Bench) -> list[str]:
    """Return notes on the known loads of a recording that do not depend on the angle."""
    unit = "N" if bench.motion == "linear" else "N m"
    notes = []
    if section.constant_torque:
        notes.append(
            f"known constant torque {section.constant_torque:+.4g} {unit} on the joint (positive "
            f"drives the joint forward)"
        )
    if section.hoisted is not None:
        hoist = section.hoisted.hoist()
        notes.append(
            f"hoisted {hoist.mass:.4g} kg: {hoist.torque(bench.gravity):+.4g} {unit} on the joint "
            f"(positive drives the joint forward), and the inertia of this mass"
        )
    return notes


def _mend(
    table: Table, channels: dict[str, Array], skipped: int, *, stamped: bool
) -> tuple[dict[str, Array], Timing, list[str]]:
    """Check the time, fill isolated missing samples, and drop repeated time stamps.

    Rows of other topics are dropped only if rows have time stamps (``stamped``); if the campaign
    states a rate, each row is a sample. ``skipped`` is the number of rows of the table before the
    first row of the channels.
    """
    dropped: list[str] = []
    rows: Rows = skipped + np.arange(len(channels["time"]))
    if stamped:
        channels, dropped, kept = _without_other_topics(channels)
        rows = rows[kept]
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


def _power_off(table: Table, channels: dict[str, Array], rows: Rows) -> Mask | None:
    """Return a mask of the rows in which the power stage is off, and set ``enabled`` to 0 or 1."""
    if "enabled" not in channels:
        return None
    unknown = np.flatnonzero(~np.isfinite(channels["enabled"]))
    if unknown.size:
        place = table.place(int(rows[unknown[0]]))
        raise InputError(
            f"{place}: `enabled` is missing in {unknown.size} rows; it must have a value in "
            "each row"
        )
    on = channels["enabled"] > 0.5
    channels["enabled"] = on.astype(np.float64)
    return ~on


def _fill(name: str, values: Array, time: Array, off: Mask | None) -> tuple[Array, list[str]]:
    if name in SLOW:
        finite = np.isfinite(values)
        count = int(len(values) - finite.sum())
        if count in (0, len(values)):
            return values, [f"`{name}` has no value in any row"] if count else []
        return np.interp(time, time[finite], values[finite]), [
            f"`{name}`: {count} missing samples interpolated"
        ]
    filled, count = fill_missing(values, time, off if name == "voltage" else None)
    return filled, [f"`{name}`: {count} missing samples interpolated"] if count else []


def _without_other_topics(
    channels: dict[str, Array],
) -> tuple[dict[str, Array], list[str], Rows]:
    """Drop rows that contain a time but no channel; a log of several topics has such rows.

    If there are few such rows, they count as missing samples, which are interpolated instead.
    """
    others = [values for name, values in channels.items() if name != "time"]
    empty = np.logical_and.reduce([np.isnan(values) for values in others])
    count = int(empty.sum())
    if count <= MISSING_SHARE * len(empty) or len(empty) - count < MIN_SAMPLES:
        return channels, [], np.arange(len(empty))
    kept = {name: values[~empty] for name, values in channels.items()}
    note = f"{count} rows dropped that contain only a time, probably rows of another topic"
    return kept, [note], np.flatnonzero(~empty)


def _apart(name: str, channels: dict[str, Array]) -> str:
    """Return a remedy if two channels have no row in common; else an empty text."""
    known = np.isfinite(channels[name])
    for other, values in channels.items():
        if other != name and not np.any(known & np.isfinite(values)):
            return (
                f"; this channel has no row in common with `{other}`: the two channels belong to "
                "different topics; interpolate one of them at the time stamps of the other first"
            )
    return ""


def _at(table: Table, error: UnusableError, channel: str, rows: Rows) -> str:
    row = None if error.row is None else int(rows[error.row])
    place = str(table.path) if row is None else table.place(row)
    hint = ""
    if channel == "`voltage`: ":
        hint = "; if the power stage was off in these rows, state this with an `enabled` channel"
    return f"{place}: {channel}{error}{hint}"


def _cut(whole: Recording, timing: Timing, stamps: Array | None) -> list[Recording]:
    """Return one recording per piece without gaps, each on one clock; several pieces are numbered
    from 1.
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
    """Return a recording whose channels have common times; if the time stamps are uneven but the
    samples are not, the times are made even.
    """
    if stamps is None:
        return _on_even_stamps(recording)
    channels, words = aligned(
        recording.channels, stamps, recording.averaged, recording.bench.gear_ratio
    )
    return (
        replace(recording, channels=channels, notes=(*recording.notes, words))
        if words
        else recording
    )


def _on_even_stamps(recording: Recording) -> Recording:
    angle = next((recording.channels[n] for n in ANGLES if n in recording.channels), None)
    found = None if angle is None else even_stamps(recording.time, angle)
    if found is None:
        return recording
    grid, jitter = found
    period = float(np.median(np.diff(grid)))
    note = (
        f"time stamps jitter by {jitter:.2g} s rms ({100.0 * jitter / period:.0f} % of the period) "
        "around evenly taken samples: the even times are used"
    )
    channels = {**recording.channels, "time": grid}
    others = tuple(n for n in recording.notes if not n.startswith(UNEVEN))
    return replace(recording, channels=channels, notes=(*others, note))


def _is_constant(values: Array) -> bool:
    return bool(np.all(values == values[0]))


def _stem(file: Path) -> str:
    return (file.with_suffix("") if file.suffix.lower() == ".gz" else file).stem
