"""Builds recordings in SI units from one file and the entry of this file in the campaign."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from glob import has_magic
from itertools import pairwise
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.model.parameters import LINEAR
from identification.prepare import coarser_than_velocity
from identification.recording import Array, Bench, Dataset, Recording
from rig.common.errors import InputError
from rig.common.places import is_file, is_folder, usable
from rig.common.provenance import sha256_file
from rig.common.timing import instant
from rig.config.campaign import Campaign, load_campaign, matching_files
from rig.config.campaign_sections import ANGLE_TIME, RecordingSection, WindowSection
from rig.config.configuration import Document, Loc
from rig.runs.alignment import aligned
from rig.sources.channels import read_channels
from rig.sources.columns import unit_row_doubts
from rig.sources.formats import FORMATS, open_table, unknown_format
from rig.sources.plausible import findings
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
from rig.sources.table import Table, format_of

File = tuple[Path, int, RecordingSection]
"""A file of a campaign, and number and content of its entry."""


def _starts(
    files: Sequence[File], document: Document[Campaign], problems: list[str]
) -> list[float | None]:
    """Return the start time of each file in the session, s, or None if the campaign states none;
    all windows of a file have one start time.

    Start times in seconds are used as stated. The earliest ISO time becomes zero.
    """
    counts = Counter(index for _, index, _ in files)
    for index, count in counts.items():
        if document.value.recordings[index].start is not None and count > 1:
            problems.append(
                document.problem(
                    ("recordings", index, "start"),
                    f"one `start` for {count} files; list each file in a separate entry with "
                    "its own `start`",
                )
            )
    stated = [section.start for _, _, section in files]
    times = {start: instant(start) for start in stated if isinstance(start, str)}
    return [
        (times[start] - min(times.values())).total_seconds() if isinstance(start, str) else start
        for start in stated
    ]


def _overlaps(placed: Sequence[tuple[Recording, int]], document: Document[Campaign]) -> list[str]:
    """Return a problem for each recording that begins before the unit's preceding one ends."""
    problems = []
    order = sorted(placed, key=lambda item: (item[0].unit, item[0].span))
    for (one, _), (other, index) in pairwise(order):
        if other.unit == one.unit and other.span[0] <= one.span[1]:
            problems.append(
                document.problem(
                    ("recordings", index, "start"),
                    f"{other.name} begins at {other.span[0]:.6g} s of the session, before "
                    f"{one.name} ends at {one.span[1]:.6g} s; correct the start times (a start "
                    "time belongs to the first row of a file, also if the file has a window)",
                )
            )
    return problems


Rows = NDArray[np.intp]
LEAST_JITTER = 0.005
"""Rms deviation of the stamps from an even grid, in periods, below which stamps count as even."""
MOST_OFF = 0.25
"""Greatest mean deviation of neighbouring stamps from the grid, in periods, as by a lost sample."""
WINDOW = 101  # number of neighbouring stamps over which the deviation from the grid is averaged
SMOOTHER = 0.8
"""Ratio of the angle's roughness on the grid to its roughness at the stamps below which the grid
counts as right.

Quantisation and noise contribute equally to both roughnesses. If quantisation and noise hide the
jitter of the stamps, the jitter has little effect on results.
"""
FAST, MOST = 0.25, 0.99
"""A sample is compared if its travel is at least this share of this quantile of all travels."""
NEIGHBOURS = (-2, -1, 1, 2)


def even_stamps(time: Array, angle: Array) -> tuple[Array, float] | None:
    """Return the times of evenly taken samples and the rms jitter of their stamps, s, shape (n,).

    The result is None if stamps are even, no grid fits them, or the samples are uneven.
    """
    found = _grid(time)
    if found is None:
        return None
    grid, index = found
    jitter = float(np.std(time - grid))
    consecutive = (np.diff(index) == 1) & (np.diff(time) > 0.0)
    runs = consecutive[:-3] & consecutive[1:-2] & consecutive[2:-1] & consecutive[3:]
    rows = np.flatnonzero(runs) + 2
    if jitter < LEAST_JITTER * float(np.median(np.diff(grid))) or not rows.size:
        return None
    travel = np.abs(angle[rows + 2] - angle[rows - 2])
    rows = rows[travel >= FAST * np.quantile(travel, MOST)]
    on_grid, at_stamps = (_roughness(t, angle, rows) for t in (grid, time))
    return (grid, jitter) if on_grid < SMOOTHER * at_stamps else None


def _grid(time: Array) -> tuple[Array, Rows] | None:
    """Return the times on the line through the stamps, and sample numbers; None without a fit."""
    steps = np.diff(time)
    lost = np.maximum(np.round(steps / float(np.median(steps))), 1.0)
    # Jitter may look like a lost sample; therefore lost samples are assumed only if necessary.
    for counts in (np.ones(len(steps)), lost):
        index = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        period, origin = (float(v) for v in np.polyfit(index, time, 1))
        grid: Array = np.asarray(origin + period * index, dtype=np.float64)
        window = min(WINDOW, len(time) // 4)
        mean = np.convolve(time - grid, np.full(window, 1.0 / window), mode="valid")
        if float(np.max(np.abs(mean))) <= MOST_OFF * period:
            return grid, index
    return None


def _roughness(time: Array, angle: Array, rows: Rows) -> float:
    """Return the median distance, robust to near stamps, from the cubic through the neighbours."""
    apart = [time[rows + k] - time[rows] for k in NEIGHBOURS]
    predicted = np.zeros(len(rows))
    for j, k in enumerate(NEIGHBOURS):
        weight = np.ones(len(rows))
        for m, other in enumerate(apart):
            if m != j:
                weight *= other / (other - apart[j])
        predicted += weight * angle[rows + k]
    return float(np.median(np.abs(angle[rows] - predicted)))


ANGLES = ("motor_angle", "angle")
"""Channels by whose values uneven sampling is detected, the channel with finer steps first."""
SLOW = frozenset({"supply_voltage", "temperature", "pressure"})
"""Channels that are often logged at a lower rate; all missing samples of these are interpolated."""


def build(
    file: Path,
    section: RecordingSection,
    bench: Bench,
    document: Document[Campaign],
    index: int,
    start: float | None,
) -> list[Recording]:
    """Read one file, convert its channels to SI units, and make the allowed corrections.

    Args:
        file: The file.
        section: Its entry in the campaign.
        bench: Constants of the campaign's bench.
        document: The campaign.
        index: Number of the entry, from 0.
        start: Time of the file's first stamp in the session, s, or None if it is unknown.

    Returns:
        One recording per piece without gaps, with its corrections as notes.
    """
    unsure = document.value.bench.uncertainties()
    if section.moment_arm is not None:
        bench = replace(bench, moment_arm=float(section.moment_arm))
        unsure.pop("bench.moment_arm", None)
    with usable(file, "read"):
        table = open_table(file, section.read.beside(document.path.parent))
        channels, unread, found = read_channels(table, section, document, index)
        digest = sha256_file(file)
    finite = channels["time"][np.isfinite(channels["time"])]
    first = float(finite[0]) if finite.size else 0.0
    channels, skipped, cut = _windowed(file, channels, section)
    channels, timing, mended = _mend(
        table, channels, unread + skipped, stamped=section.rate is None
    )
    stamps = channels.pop(ANGLE_TIME, None)
    found += [*cut, *mended, *unit_row_doubts(table, section, bench.motion == LINEAR)]
    problems, doubts = findings(
        channels,
        bench.gear_ratio,
        driven_by_weight=section.known_load,
        has_lever=bench.moment_arm is not None,
    )
    if problems:
        raise InputError(f"{file}: {problem}" for problem in problems)
    doubts += [
        f"`{name}` is constant ({values[0]:.6g})"
        for name, values in channels.items()
        if name != "enabled" and np.all(values == values[0])
    ]
    notes = [*table.notes, *found, *doubts, *_load_notes(section, bench)]
    whole = Recording(
        name=(file.with_suffix("") if file.suffix.lower() == ".gz" else file).stem,
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
        unit=section.unit,
        averaged=frozenset(name for name, channel in section.channels.items() if channel.average),
        source=str(file),
        sha256=digest,
        notes=tuple(notes),
    )
    if words := coarser_than_velocity(whole):
        used = {n: v for n, v in whole.channels.items() if n not in ANGLES}
        whole, stamps = replace(whole, channels=used, notes=(*whole.notes, words)), None
    recordings = _cut(whole, timing, stamps)
    if start is None:
        return recordings
    begins = [start + float(recording.time[0]) - first for recording in recordings]
    return [
        replace(r, start=begin, notes=(*r.notes, f"begins {begin:.6g} s into the session"))
        for r, begin in zip(recordings, begins, strict=True)
    ]


def _windowed(
    file: Path, channels: dict[str, Array], section: RecordingSection
) -> tuple[dict[str, Array], int, list[str]]:
    """Return the channels within the window of the section, the number of rows before the window,
    and notes.

    All rows between the first and the last sample of the window are used, so that the later checks
    find missing time stamps and time that runs backwards.
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


def _without_other_topics(channels: dict[str, Array]) -> tuple[dict[str, Array], list[str], Rows]:
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
    """Return one recording per piece without gaps, each on one clock, numbered from 1."""
    if timing.pieces == ((0, len(whole.time)),):
        return [_on_one_clock(whole, stamps)]
    found = []
    for number, (start, stop) in enumerate(timing.pieces, start=1):
        channels = {name: values[start:stop] for name, values in whole.channels.items()}
        piece = replace(whole, name=f"{whole.name}[{number}]", channels=channels)
        found.append(_on_one_clock(piece, None if stamps is None else stamps[start:stop]))
    return found


def _on_one_clock(recording: Recording, stamps: Array | None) -> Recording:
    """Return a recording with common times, made even if the samples are."""
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


def load_source(path: Path, *, partial: bool = False, units: bool = False) -> Dataset:
    """Load a run folder or a campaign file; with ``units``, also recordings of several machines."""
    _require_visible(path)
    if is_file(path / "run.json"):
        # Imported here, because recordings of a campaign do not need the reader of run folders.
        from rig.runs.run import load_run

        return load_run(path, partial=partial)
    if is_folder(path):
        raise InputError(
            f"{path}: the folder has no run.json; give a run folder or a campaign file (.yaml)"
        )
    if path.suffix.lower() not in (".yaml", ".yml"):
        remedy = (
            "; describe recordings made elsewhere in a campaign file (.yaml)"
            if is_file(path)
            else ""
        )
        missing = "" if os.path.exists(path) else "no such file; "
        raise InputError(f"{path}: {missing}a source is a run folder or a campaign file{remedy}")
    if partial:
        raise InputError(
            f"{path}: --partial is allowed for a run folder only; a campaign file names the "
            "recordings to load"
        )
    document = load_campaign(path)
    campaign = document.value
    bench = campaign.bench.bench()
    problems: list[str] = []
    names = list(dict.fromkeys(r.unit for r in campaign.recordings))
    if len(names) > 1 and not units:
        raise InputError(
            f"{path}: the recordings are of {len(names)} units, {', '.join(names[:3])}, ...; only "
            "`rig identify` takes several units; give a campaign with the recordings of one"
        )
    recordings: list[Recording] = []
    entries: list[int] = []
    files = _expand(document, problems)
    starts = _starts(files, document, problems)
    for (file, index, section), start in zip(files, starts, strict=True):
        try:
            recordings += build(file, section, bench, document, index, start)
            entries += [index] * (len(recordings) - len(entries))
        except InputError as error:
            problems.extend(error.problems)
    recordings = list(_distinct_names(recordings))
    if not problems and any(start is not None for start in starts):
        problems += _overlaps(list(zip(recordings, entries, strict=True)), document)
    if problems:
        raise InputError(dict.fromkeys(problems))
    others = dict.fromkeys(document.other_files())
    for section in campaign.recordings:
        others |= dict.fromkeys(map(Path, section.read.beside(document.path.parent).dbc_files))
    tables = {str(file): sha256_file(file) for file in others}
    return Dataset(tuple(recordings), campaign.model.model(), tables)


def _require_visible(path: Path) -> None:
    """Reject a source that cannot be read, for example a folder without permission."""
    try:
        (path / "run.json").stat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be read: {reason}") from error


def _expand(document: Document[Campaign], problems: list[str]) -> list[File]:
    """Expand file names and patterns, and report missing files, unknown formats and duplicates."""
    files: list[File] = []
    fitted: dict[tuple[str, str], list[RecordingSection]] = {}
    for index, section in enumerate(document.value.recordings):
        seen: set[Path] = set()
        for loc, file in _files(document, index, section, problems):
            if file in seen:
                continue
            seen.add(file)
            key = (os.path.realpath(file), repr(sorted(section.channels.items())))
            for other in fitted.setdefault(key, []):
                if not _load_apart(section.window, other.window):
                    again = "twice" if other.role == section.role else "both to fit and to validate"
                    problems.append(
                        document.problem(
                            loc,
                            f"{file} is used {again}; keep one entry for the file, or give each "
                            "entry its own `window`",
                        )
                    )
                    break
            fitted[key].append(section)
            files.append((file, index, section))
    return files


def _load_apart(one: WindowSection | None, other: WindowSection | None) -> bool:
    """Return whether two windows of a file have no sample in common."""
    if one is None or other is None:
        return False
    (a, b), (c, d) = (
        (-inf if w.begin is None else w.begin, inf if w.to is None else w.to) for w in (one, other)
    )
    return b <= c or d <= a


def _files(
    document: Document[Campaign], index: int, section: RecordingSection, problems: list[str]
) -> Iterator[tuple[Loc, Path]]:
    folder = document.path.parent
    for position, pattern in enumerate(section.patterns):
        loc: Loc = ("recordings", index, "file")
        if not isinstance(section.file, str):
            loc = (*loc, position)
        matches = matching_files(folder, pattern)
        if not matches:
            what = "no file matches this pattern" if has_magic(pattern) else "no such file"
            problems.append(document.problem(loc, f"{what} in {folder}"))
        for file in matches:
            if is_folder(file):
                problems.append(
                    document.problem(
                        loc, f"{file} is a folder; give files, or add /* to the pattern"
                    )
                )
            elif format_of(file) not in FORMATS:
                problems.append(document.problem(loc, f"{file.name}: {unknown_format(file)}"))
            else:
                yield loc, file


def _distinct_names(recordings: list[Recording]) -> Iterator[Recording]:
    names = distinct_names(
        [r.name for r in recordings], [Path(r.source).parent.name for r in recordings]
    )
    for recording, name in zip(recordings, names, strict=True):
        yield recording if name == recording.name else replace(recording, name=name)


def distinct_names(names: list[str], folders: list[str]) -> list[str]:
    """Add the folder to duplicate names, then number the names that are still equal."""
    count, used = Counter(names), Counter[str]()
    found = []
    for name, folder in zip(names, folders, strict=True):
        made = f"{folder}/{name}" if count[name] > 1 else name
        used[made] += 1
        found.append(f"{made} ({used[made]})" if used[made] > 1 else made)
    return found
