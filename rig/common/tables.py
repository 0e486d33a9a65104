"""Formats numbers and intervals for terminal and pages; aligned text tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

_GAP = "  "
_LEVELS: Final = "▁▂▃▄▅▆▇█"
CHANGED: Final = "changed"
"""Finding on a constant whose difference exceeds its uncertainty, in every table."""
NO_CHANGE: Final = "no change"  # finding on a constant whose difference is within its uncertainty


def table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> str:
    """Return a table with aligned columns, a rule under the header and no trailing blanks.

    ``right``: indices of the columns aligned to the right (numbers).
    """
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise ValueError(f"row {number} has {len(row)} cells; the header has {len(header)}")
    widths = [max(len(line[i]) for line in (header, *rows)) for i in range(len(header))]

    def aligned(cells: Sequence[str]) -> str:
        padded = (
            c.rjust(w) if i in right else c.ljust(w)
            for i, (c, w) in enumerate(zip(cells, widths, strict=True))
        )
        return _GAP.join(padded).rstrip()

    return "\n".join([aligned(header), _GAP.join("-" * w for w in widths), *map(aligned, rows)])


def number(value: float | None, digits: int = 5) -> str:
    """Return a number with ``digits`` significant digits, or a dash for None; zero has no sign."""
    return "-" if value is None else f"{value:z.{digits}g}"


def interval(low: float | None, high: float | None) -> str:
    """Return an interval in brackets, or a dash if there is no interval."""
    return "-" if low is None or high is None else f"[{low:z.4g}, {high:z.4g}]"


def percent(value: float | None) -> str:
    """Return a share in percent, three digits (all from 1000 up), or a dash for None."""
    if value is None:
        return "-"
    return f"{value:.0f} %" if abs(value) >= 1000.0 else f"{value:z.3g} %"


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
