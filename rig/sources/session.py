"""Gives the recordings of a campaign a common session time, from start times or their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from identification.recording import Recording
from rig.common.errors import InputError
from rig.common.instants import instant
from rig.config.campaign import Campaign
from rig.config.campaign_sections import RecordingSection
from rig.config.configuration import Document


@dataclass(frozen=True)
class Read:
    """The recordings of one file, and the time span of the file.

    Attributes:
        recordings: One recording per piece without gaps.
        first: First time stamp of the whole file, s.
        last: Last time stamp of the whole file, s.
        section: Entry of the file in the campaign.
        index: Position of the entry in ``recordings``.
    """

    recordings: tuple[Recording, ...]
    first: float
    last: float
    section: RecordingSection
    index: int


def on_session_clock(files: Sequence[Read], document: Document[Campaign]) -> list[Recording]:
    """Return the recordings of all files, with start times in the session if the campaign states
    them.

    Start times in seconds are used as stated. The earliest ISO time becomes zero. Files with a
    stated order follow one another without a pause.

    Raises:
        InputError: Several files have equal start times or orders, or recordings overlap.
    """
    problems: list[str] = []
    starts = _starts(files, document, problems)
    placed: list[tuple[Recording, int]] = []
    for file, start in zip(files, starts, strict=True):
        for recording in file.recordings:
            if start is not None:
                begin = start + float(recording.time[0]) - file.first
                note = f"begins {begin:.6g} s into the session"
                if file.section.order is not None:
                    note += "; only the order is known, so that pauses count as zero"
                recording = replace(recording, start=begin, notes=(*recording.notes, note))
            placed.append((recording, file.index))
    if any(start is not None for start in starts) and not problems:
        problems += _overlaps(placed, document)
    if problems:
        raise InputError(dict.fromkeys(problems))
    return [recording for recording, _ in placed]


def _starts(
    files: Sequence[Read], document: Document[Campaign], problems: list[str]
) -> list[float | None]:
    """Return the start time of each file, s; all windows of a file have one start time."""
    for name in ("start", "order"):
        for index in dict.fromkeys(f.index for f in files):
            same = [f for f in files if f.index == index]
            if getattr(same[0].section, name) is not None and len(same) > 1:
                problems.append(
                    document.problem(
                        ("recordings", index, name),
                        f"one `{name}` for {len(same)} files; list each file in a separate entry "
                        f"with its own `{name}`",
                    )
                )
    times = [instant(s) for f in files if isinstance(s := f.section.start, str)]
    epoch = min(times, default=None)
    found: list[float | None] = []
    for file in files:
        start = file.section.start
        if isinstance(start, str) and epoch is not None:
            found.append((instant(start) - epoch).total_seconds())
        else:
            found.append(None if isinstance(start, str) else start)
    ordered = sorted(
        (n for n, f in enumerate(files) if f.section.order is not None),
        key=lambda n: (files[n].section.order or 0, n),
    )
    clock = 0.0
    for n in ordered:
        found[n] = clock
        # One period is added, so that the first sample of the next file comes after the last sample
        # of this file.
        clock += files[n].last - files[n].first + files[n].recordings[0].period
    return found


def _overlaps(placed: Sequence[tuple[Recording, int]], document: Document[Campaign]) -> list[str]:
    """Return a problem for each recording that begins before the end of the preceding recording."""
    problems = []
    for (one, _), (other, index) in pairwise(sorted(placed, key=lambda item: item[0].span)):
        if other.span[0] <= one.span[1]:
            problems.append(
                document.problem(
                    ("recordings", index, "start"),
                    f"{other.name} begins at {other.span[0]:.6g} s of the session, before "
                    f"{one.name} ends at {one.span[1]:.6g} s; correct the start times (a start "
                    "time belongs to the first row of a file, also if the file has a window)",
                )
            )
    return problems
