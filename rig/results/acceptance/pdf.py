"""Draws the certificate as a PDF of one page (A4, portrait) with the plotting library."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib.image
from matplotlib import rc_context
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyBboxPatch

from rig.results.acceptance.certificate import Certificate
from rig.results.document import Table

WIDTH_MM, HEIGHT_MM = 210.0, 297.0
_MARGIN = 15.0
_ROW_MM = 4.6
_POINTS_PER_MM = 72.0 / 25.4
_FONT_SHARE = 0.62
"""Ratio of the text size to the height of a row."""
_CHARACTER = 0.52
"""Ratio of the mean width of a character to the text size."""
_ABOVE = 0.2
"""Ratio of the space above the text of a row to the height of the row."""
_GAP = 2
"""Least number of characters between two columns."""
_DIGEST = 64
_GOOD, _BAD, _INK, _SOFT, _RULE = "#00713d", "#b00020", "#000000", "#444444", "#bbbbbb"
_BACK = {True: "#eef8f1", False: "#fdf0f0"}
_FIGURE_MM = 56.0


class _Sheet:
    """A page that is filled from the top, in mm.

    Args:
        row_mm: Height of a row of text.
    """

    def __init__(self, row_mm: float) -> None:
        self.figure = Figure(figsize=(WIDTH_MM / 25.4, HEIGHT_MM / 25.4))
        FigureCanvasPdf(self.figure)
        self.row_mm = row_mm
        self.y = _MARGIN

    @property
    def size(self) -> float:
        """Size of the text, points."""
        return _FONT_SHARE * self.row_mm * _POINTS_PER_MM

    def text(
        self, x: float, y: float, words: str, size: float, colour: str = _INK, **kept: Any
    ) -> None:
        """Write a line whose upper edge is ``y`` mm below the top."""
        place = (x / WIDTH_MM, 1.0 - y / HEIGHT_MM)
        # Without formulas, so that a dollar sign in a name is drawn as a dollar sign.
        self.figure.text(
            *place, words, fontsize=size, color=colour, va="top", parse_math=False, **kept
        )

    def rule(self, x: float, y: float, width: float) -> None:
        """Draw a horizontal line over the whole width."""
        ends = ([x / WIDTH_MM, (x + width) / WIDTH_MM], [1.0 - y / HEIGHT_MM] * 2)
        self.figure.add_artist(Line2D(*ends, color=_RULE, linewidth=0.5))

    def heading(self, x: float, y: float, words: str) -> float:
        """Write a heading; return the distance of its lower edge from the top, mm."""
        self.text(x, y + 0.4 * self.row_mm, words, 1.08 * self.size, weight="bold")
        return y + 1.6 * self.row_mm

    def table(self, x: float, y: float, width: float, cells: Table) -> float:
        """Draw a table; return the distance of its lower edge from the top, mm."""
        shares = _shares(cells)
        wraps = [self._wrapped(row, shares, width) for row in cells.rows]
        for lines, head in ((_one_line(cells.header), True), *((row, False) for row in wraps)):
            left = x
            for index, cell in enumerate(lines):
                at = left + (shares[index] * width - 2.0 if index in cells.right else 0.0)
                for number, line in enumerate(cell):
                    colour = _SOFT if head else _BAD if line in ("FAILED", "OVERDUE") else _INK
                    digest = len(line) == _DIGEST
                    self.text(
                        at,
                        y + (number + _ABOVE) * self.row_mm,
                        line,
                        0.78 * self.size if digest else 0.92 * self.size,
                        colour,
                        ha="right" if index in cells.right else "left",
                        weight="bold" if colour == _BAD else "normal",
                        family="monospace" if digest else "sans-serif",
                    )
                left += shares[index] * width
            y += self.row_mm * max(len(cell) for cell in lines)
            self.rule(x, y, width)
        return y

    def _wrapped(
        self, row: Sequence[str], shares: Sequence[float], width: float
    ) -> list[list[str]]:
        """Return the lines of each cell; long cells are wrapped to the width of their column."""
        per_mm = _POINTS_PER_MM / (_CHARACTER * 0.92 * self.size)
        return [
            [cell]
            if len(cell) == _DIGEST
            else textwrap.wrap(cell, max(6, int(share * width * per_mm) - _GAP)) or [""]
            for cell, share in zip(row, shares, strict=True)
        ]


def _one_line(header: Sequence[str]) -> list[list[str]]:
    return [[cell] for cell in header]


def _shares(cells: Table) -> list[float]:
    """Return the widths of the columns relative to the table's width, from the longest cell of each
    column.
    """
    longest = [
        _GAP + min(70, max(5, *(len(row[i]) for row in (cells.header, *cells.rows))))
        for i in range(len(cells.header))
    ]
    return [each / sum(longest) for each in longest]


def certificate_pdf(certificate: Certificate) -> bytes:
    """Return the certificate as a PDF of one page; longer content gets smaller text."""
    row_mm = _ROW_MM
    sheet = _drawn(certificate, row_mm)
    for _ in range(8):
        if sheet.y <= HEIGHT_MM - _MARGIN:
            break
        row_mm *= 0.97 * (HEIGHT_MM - _MARGIN) / sheet.y
        sheet = _drawn(certificate, row_mm)
    buffer = io.BytesIO()
    with rc_context({"pdf.fonttype": 42}):
        sheet.figure.savefig(
            buffer,
            format="pdf",
            metadata={
                "Title": f"{certificate.title}: {certificate.headline}",
                "Creator": "loadrig",
            },
        )
    return buffer.getvalue()


def _drawn(it: Certificate, row_mm: float) -> _Sheet:
    sheet = _Sheet(row_mm)
    x, width = _MARGIN, WIDTH_MM - 2.0 * _MARGIN
    half = 0.5 * width - 3.0
    sheet.text(x, sheet.y, it.title, 15.0, weight="bold")
    y = _top(sheet, it, x, sheet.y + 9.0, half)
    y = sheet.table(x, sheet.heading(x, y, "Limits"), width, it.checks)
    if it.course is not None:
        y = sheet.table(x, sheet.heading(x, y, "Course of the run"), width, it.course)
    ends = [y]
    if it.constants is not None:
        ends.append(sheet.table(x, sheet.heading(x, y, "Constants"), half, it.constants))
    right = x if it.constants is None else x + half + 6.0
    ends.append(sheet.table(right, sheet.heading(right, y, "Masses"), half, it.masses))
    y = max(ends)
    y = sheet.table(x, sheet.heading(x, y, "Devices"), width, it.devices)
    y = sheet.heading(x, y, "Calibrations")
    if it.calibrations is not None:
        y = sheet.table(x, y, width, it.calibrations)
    else:
        sheet.text(x, y, "The bench file names no calibrations.", 0.92 * sheet.size)
        y += sheet.row_mm
    y = sheet.table(x, sheet.heading(x, y, "Files"), width, it.digests)
    _foot(sheet, it, x, y + 0.5 * row_mm, half)
    return sheet


def _top(sheet: _Sheet, it: Certificate, x: float, y: float, half: float) -> float:
    """Draw verdict, facts and figure; return the distance of their lower edge from the top, mm."""
    colour = _GOOD if it.accepted else _BAD
    box = FancyBboxPatch(
        ((x + 1.0) / WIDTH_MM, 1.0 - (y + 9.0) / HEIGHT_MM),
        42.0 / WIDTH_MM,
        8.0 / HEIGHT_MM,
        boxstyle="round,pad=0.003",
        edgecolor=colour,
        facecolor=_BACK[it.accepted],
        linewidth=1.5,
    )
    sheet.figure.add_artist(box)
    sheet.text(x + 22.0, y + 2.8, it.headline, 14.0, colour, ha="center", weight="bold")
    line = y + 13.0
    for name, value in it.facts:
        sheet.text(x, line, name, 0.95 * sheet.size, _SOFT)
        for part in textwrap.wrap(value, 42) or [""]:
            sheet.text(x + 24.0, line, part, 0.95 * sheet.size)
            line += sheet.row_mm
    if it.figure is None:
        return line
    place = (
        (x + half + 6.0) / WIDTH_MM,
        1.0 - (y + _FIGURE_MM) / HEIGHT_MM,
        half / WIDTH_MM,
        _FIGURE_MM / HEIGHT_MM,
    )
    axes = sheet.figure.add_axes(place)
    axes.imshow(matplotlib.image.imread(io.BytesIO(it.figure.data), format="png"), aspect="equal")
    axes.set_axis_off()
    axes.set_anchor("N")
    return max(line, y + _FIGURE_MM)


def _foot(sheet: _Sheet, it: Certificate, x: float, y: float, half: float) -> None:
    rule = "A constant passes if its whole 90 % interval is within the limits."
    for words in (f"{it.made}.", rule):
        sheet.text(x, y, words, 0.8 * sheet.size, _SOFT)
        y += 0.85 * sheet.row_mm
    y += 3.0 * sheet.row_mm
    for left, words in ((x, "date"), (x + half + 6.0, "signature")):
        sheet.rule(left, y, half)
        sheet.text(left, y + 0.5, words, 0.85 * sheet.size, _SOFT)
    sheet.y = y + sheet.row_mm
