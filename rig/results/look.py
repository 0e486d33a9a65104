"""Output of ``rig look``: the content of a log as text and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rig.common.provenance import utc_now, versions
from rig.common.tables import table
from rig.sources.look import Clock, Column, Look

LOOK_SCHEMA = "loadrig.look/1"
_LEVELS = "▁▂▃▄▅▆▇█"


def described(look: Look) -> str:
    """Return the terminal text: notes, the clock, and one row per column with a small picture."""
    rows = max((column.samples for column in look.columns), default=0)
    parts = [f"{look.name}: {look.format}, {len(look.columns)} columns, {rows} rows"]
    parts += [f"  {note}" for note in look.notes]
    parts += [f"  {_clock_words(look)}"]
    cells = [_row(column) for column in look.columns]
    parts += [f"  doubt: {words}" for words in look.doubts]
    parts += [table(("column", "unit", "may be", "least", "greatest", "course", "notes"), cells)]
    return "\n".join(parts)


def _clock_words(look: Look) -> str:
    clock = look.clock
    if clock is None:
        return (
            "no column is recognised as time: name the column of time in the campaign file or, if "
            "there is none, give `rate`"
        )
    name = look.columns[clock.column].name or clock.column
    words = [f"time is {name}"]
    if clock.period > 0:
        words.append(f"{1.0 / clock.period:.6g} Hz (median period {clock.period:.4g} s)")
    if clock.high - clock.low > 0.05 * abs(clock.period):
        words.append(f"uneven: 90 % of the steps from {clock.low:.4g} to {clock.high:.4g} s")
    words.append(f"{clock.gaps} gaps, the longest step {clock.longest:.4g} s")
    words += [f"{clock.backwards} steps backwards"] if clock.backwards else []
    words += [f"{clock.repeated} repeated"] if clock.repeated else []
    return ", ".join(words)


def _row(column: Column) -> tuple[str, ...]:
    notes = [column.problem] if column.problem else []
    if column.missing:
        notes.append(f"{column.missing} missing")
    if column.samples and column.low == column.high:
        notes.append("constant")
    if column.step:
        notes.append(f"steps of {column.step:.4g}")
    if column.flicker:
        notes.append(f"flickers in {100 * column.flicker:.0f} % of the samples")
    if column.wrap:
        notes.append(column.wrap)
    may = column.channel + (f" x {column.scale:.6g}" if column.scale != 1.0 else "")
    low, high = ("" if math.isnan(value) else f"{value:.6g}" for value in (column.low, column.high))
    name = column.name or str(column.index)
    return (name, column.unit, may, low, high, picture(column.strip), "; ".join(notes))


def picture(strip: Sequence[float]) -> str:
    """Return values as bars of eight heights; a blank stands for a missing value."""
    known = [value for value in strip if math.isfinite(value)]
    if not known:
        return ""
    low, span = min(known), max(known) - min(known)
    return "".join(
        _LEVELS[min(7, int(8 * (value - low) / span)) if span else 0]
        if math.isfinite(value)
        else " "
        for value in strip
    )


def look_record(looks: Sequence[Look]) -> dict[str, Any]:
    """Return the record of ``rig look --json``."""
    known = versions()
    return {
        "schema": LOOK_SCHEMA,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
        "logs": [_log_record(look) for look in looks],
    }


def _log_record(look: Look) -> dict[str, Any]:
    return {
        "name": look.name,
        "format": look.format,
        "notes": list(look.notes),
        "doubts": list(look.doubts),
        "clock": None if look.clock is None else _clock_record(look.clock),
        "columns": [_column_record(column) for column in look.columns],
    }


def _clock_record(clock: Clock) -> dict[str, Any]:
    return {
        "column": clock.column,
        "scale": clock.scale,
        "period_s": clock.period,
        "low_s": clock.low,
        "high_s": clock.high,
        "gaps": clock.gaps,
        "longest_s": clock.longest,
        "backwards": clock.backwards,
        "repeated": clock.repeated,
    }


def _column_record(column: Column) -> dict[str, Any]:
    return {
        "name": column.name,
        "index": column.index,
        "channel": column.channel,
        "unit": column.unit,
        "scale": column.scale,
        "samples": column.samples,
        "missing": column.missing,
        "least": column.low,
        "greatest": column.high,
        "step": column.step,
        "flicker": column.flicker,
        "wrap": column.wrap,
        "problem": column.problem,
        "course": list(column.strip),
    }
