"""Draws curves over time as HTML with inline SVG. This module is independent of runs.

The curves scale with the page, while all text is HTML, so that text has the same size in a chart of
any width, also on paper. A picture of fixed size would be unreadable on a telephone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

Flags = NDArray[np.bool_]
MOST_BINS = 8192
"""Smallest number of bins after a reduction, which exceeds the number of columns of a screen."""


class Bins(NamedTuple):
    """Groups of neighbouring samples.

    Attributes:
        start: Time of each bin's first sample, s, shape (n,).
        stop: Time of each bin's last sample, s, shape (n,).
        low: Least value of each channel, shape (n, channels); NaN without a value.
        high: Greatest value of each channel, shape (n, channels).
        broken: Whether samples are missing before the bin, so that no line joins it to the bin
            before it.
    """

    start: Array
    stop: Array
    low: Array
    high: Array
    broken: Flags

    def part(self, first: float, last: float) -> Bins:
        """Return the bins between two times, s."""
        keep = (self.stop >= first) & (self.start <= last)
        return Bins(
            self.start[keep], self.stop[keep], self.low[keep], self.high[keep], self.broken[keep]
        )


def of_samples(time: Array, values: Array, broken: Flags) -> Bins:
    """Return samples as bins of one sample each. ``values`` has shape (n, channels)."""
    return Bins(time, time, values, values, broken)


def joined(parts: Sequence[Bins]) -> Bins:
    """Return consecutive sets of bins as one."""
    return Bins(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def merged(bins: Bins, starts: NDArray[np.intp]) -> Bins:
    """Return the bins merged into groups that begin at the indices ``starts``, the first of which
    is 0.
    """
    if not len(bins.start):
        return bins
    ends = np.append(starts[1:], len(bins.start)) - 1
    return Bins(
        bins.start[starts],
        bins.stop[ends],
        np.fmin.reduceat(bins.low, starts, axis=0),
        np.fmax.reduceat(bins.high, starts, axis=0),
        bins.broken[starts],
    )


def in_columns(bins: Bins, position: Array, columns: int) -> Bins:
    """Return the bins after merging those in the same column of a drawing.

    Args:
        bins: The bins to draw.
        position: Where each bin begins, 0 at the left edge and 1 at the right, not falling, shape
            (n,).
        columns: Number of columns of the drawing.
    """
    if not len(bins.start):
        return bins
    column = np.floor(position * columns)
    begins = np.append(True, np.diff(column) > 0.0) | bins.broken
    return merged(bins, np.flatnonzero(begins))


class Envelope:
    """Reduces samples in order to a limited number of bins of about the same width.

    Bins begin at multiples of the width, counted in samples. A recording with more gaps than bins
    keeps one bin for the samples between two gaps.

    Args:
        most: Half of the largest number of bins.
    """

    def __init__(self, most: int = MOST_BINS) -> None:
        self._most = most
        self._width = 1
        self._seen = 0
        self._parts: list[tuple[Bins, NDArray[np.intp]]] = []
        self._count = 0

    def add(self, bins: Bins) -> None:
        """Add the next samples, as bins of one sample each."""
        index = np.arange(self._seen, self._seen + len(bins.start))
        self._seen += len(index)
        self._parts.append(self._reduced(bins, index))
        self._count += len(self._parts[-1][1])
        while self._count > 2 * self._most:
            before = self._count
            self._width *= 2
            self._join()
            if self._count == before:
                self._most *= 2

    def bins(self) -> Bins | None:
        """Return the reduced samples, or None if no samples were added."""
        if not self._count:
            return None
        self._join()
        return self._parts[0][0]

    def _join(self) -> None:
        bins = joined([part for part, _ in self._parts])
        reduced = self._reduced(bins, np.concatenate([index for _, index in self._parts]))
        self._parts, self._count = [reduced], len(reduced[1])

    def _reduced(self, bins: Bins, index: NDArray[np.intp]) -> tuple[Bins, NDArray[np.intp]]:
        """Return the bins merged to the present width; ``index`` is the number of the first sample
        of each bin.
        """
        begins = np.diff(index // self._width, prepend=-1) > 0
        starts = np.flatnonzero(begins | bins.broken)
        return merged(bins, starts), index[starts]


_NICE = (1.0, 2.0, 5.0, 10.0)


class TimeAxis:
    """Maps a time to a position on the page. Long pauses with the drive off are shortened.

    Args:
        powered: Time intervals drawn to scale, s, in order.
        clock: Name of the clock of these times; empty for no name on the axis.

    Attributes:
        clock: Name of the clock.
    """

    _PAUSE = 0.02
    """Width of a shortened pause."""

    def __init__(self, powered: Sequence[tuple[float, float]], clock: str = "") -> None:
        self.clock = clock
        joined = [powered[0]]
        longest = 0.02 * sum(stop - start for start, stop in powered)
        for start, stop in powered[1:]:
            if start - joined[-1][1] > longest:
                joined.append((start, stop))
            else:
                joined[-1] = (joined[-1][0], stop)
        self.pauses = [(before[1], after[0]) for before, after in pairwise(joined)]
        pause = min(self._PAUSE, 0.2 / max(len(self.pauses), 1))
        total = max(sum(stop - start for start, stop in joined), 1e-9)
        scale = (1.0 - pause * len(self.pauses)) / total
        times, places, at = [], [], 0.0
        for start, stop in joined:
            times += [start, stop]
            places += [at, at + scale * (stop - start)]
            at = places[-1] + pause
        self._times, self._places, self._joined, self._total = times, places, joined, total

    @property
    def ends(self) -> tuple[float, float]:
        """First and last time, s."""
        return self._times[0], self._times[-1]

    def place(self, time: Array) -> Array:
        """Return the positions of times, 0 at the left edge and 1 at the right."""
        return np.asarray(np.interp(time, self._times, self._places))

    def at(self, time: float) -> float:
        """Return the position of one time."""
        return float(self.place(np.array([time]))[0])

    def ticks(self) -> Iterator[tuple[float, str]]:
        """Yield positions and labels of the ticks, spaced widely enough for a telephone."""
        step = nice(self._total / 5.0)
        last = -1.0
        for start, stop in self._joined:
            for k in range(math.ceil(start / step - 1e-9), math.floor(stop / step + 1e-9) + 1):
                place = self.at(k * step)
                if place - last >= 0.12:
                    yield place, tick_label(k * step, step)
                    last = place


def nice(rough: float) -> float:
    """Return the next number that is 1, 2 or 5 times a power of ten."""
    if not rough > 0.0 or not math.isfinite(rough):
        return 1.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(power * nice for nice in _NICE if power * nice >= rough * (1.0 - 1e-9))


def tick_label(value: float, step: float) -> str:
    """Return the label of a tick, with the digits needed for the tick spacing."""
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:z.{digits}f}" if digits < 7 and abs(value) < 1e7 else f"{value:.3g}"


COLUMNS = 1000
"""Number of columns of a curve; each shows the minimum and maximum of its samples."""
_SIZE = 1000.0
"""Width and height of a drawing in units of its SVG."""
_COLOURS = ("#0072B2", "#D55E00", "#009E73")
"""Colours by Okabe and Ito, which colour-blind readers can distinguish; every curve also has its
own dash pattern.
"""
_DASHES = ("", "7 4", "2 3")
_BORDERS = ("solid", "dashed", "dotted")
_FEW = 150
"""Number of samples up to which a dot marks each sample."""
_MARGIN = 0.06
_LEAST_LABELLED = 0.25
"""Least share of the chart's width that a constant part of a limit needs for a label."""
_LEAST_NAMED = 1.5
"""Width in percent above which a time interval is labelled with its name."""
STYLE = (
    ".chart{margin:.5rem 0 1rem;break-inside:avoid}.chart figcaption{line-height:1.35}"
    ".chart .read{color:#555;font-size:.85rem}.chart .beyond{color:#a30000;font-weight:600}"
    ".name{white-space:nowrap}"
    ".key{display:inline-block;width:1.6em;height:0;border-top:3px;vertical-align:.25em;margin:0 "
    ".2em 0 .7em}"
    ".plot{display:grid;grid-template-columns:4.6rem 1fr;font-size:.78rem;line-height:1}"
    ".plot>*{position:relative}.plot .at{position:absolute;white-space:nowrap}"
    ".plot .area{height:8.5rem}.tall .plot .area{height:15rem}"
    ".plot svg{position:absolute;width:100%;height:100%;overflow:hidden}"
    ".plot svg *{vector-effect:non-scaling-stroke;fill:none}.plot svg .s0{fill:#eef3f8}.plot svg "
    ".s1{fill:#dfe9f2}"
    ".plot svg .s2{fill:#f7e0d3}.plot svg .s3{fill:#e4e4e4}"
    # A name wider than its interval wraps to a second line, which is hidden, instead of being cut.
    ".plot .names{height:1.05rem;font-size:.75rem}"
    ".plot .names .at{overflow:hidden;top:0;height:100%;line-height:1.05rem;"
    "box-sizing:border-box;border-left:1px solid #888;white-space:normal}"
    ".plot .names .at::before{content:'';display:inline-block;width:.15rem}"
    ".plot .names i{display:inline-block;white-space:nowrap;font-style:normal}"
    ".plot .times{height:1.15rem}.plot .times .at{top:.2rem;transform:translateX(-50%)}"
    ".plot .clock{padding:.2rem .35rem 0 0;font-size:.68rem;color:#555;text-align:right}"
    ".plot .ys .at{right:.35rem;transform:translateY(50%)}"
    ".plot .bound{color:#a30000;background:#ffffffc0;padding:0 .15rem}"
    ".plot .mark{top:.15rem;color:#000;font-weight:600;background:#ffffffd0;padding:.1rem .2rem}"
    # The colours of the drawings are attributes, which a rule of the page replaces on dark paper.
    "@media screen and (prefers-color-scheme:dark){"
    ".chart .read,.plot .clock{color:#b4b4b4}.chart .beyond,.plot .bound{color:#ff8a8a}"
    ".plot .bound{background:#16181bc0}.plot .mark{color:#fff;background:#16181bd0}"
    ".plot svg .s0{fill:#1d252d}.plot svg .s1{fill:#24303b}.plot svg .s2{fill:#4a2f20}"
    ".plot svg .s3{fill:#303236}.plot svg [stroke='#00000018']{stroke:#ffffff24}"
    ".plot svg [stroke='#000']{stroke:#fff}.plot svg [stroke='#a30000']{stroke:#ff8a8a}"
    ".plot svg [stroke='#0072B2']{stroke:#5bb8f0}.plot svg [stroke='#D55E00']{stroke:#ff9a52}"
    ".plot svg [stroke='#009E73']{stroke:#3fd9a0}"
    ".key[style*='#0072B2']{border-color:#5bb8f0!important}"
    ".key[style*='#D55E00']{border-color:#ff9a52!important}"
    ".key[style*='#009E73']{border-color:#3fd9a0!important}"
    ".key[style*='#a30000']{border-color:#ff8a8a!important}}"
    "@media print{.plot .area{height:2.6cm}.tall .plot .area{height:4.5cm}"
    ".plot,.key{-webkit-print-color-adjust:exact;print-color-adjust:exact}}"
)


@dataclass(frozen=True)
class Curve:
    """One curve: ``bins`` of one channel, shape (n, 1)."""

    name: str
    bins: Bins


@dataclass(frozen=True)
class Bound:
    """A limit over time: start times, s, and values.

    ``upper`` is true for an upper limit and false for a lower limit.
    """

    steps: Sequence[tuple[float, float]]
    upper: bool = True


@dataclass(frozen=True)
class Shade:
    """A named time interval; ``kind`` is 0 or 1 alternately for phases, 2 for braking, 3 for no
    power.
    """

    start: float
    stop: float
    name: str
    kind: int


@dataclass(frozen=True)
class Mark:
    """A marked point in time, s."""

    time: float
    name: str


@dataclass(frozen=True)
class Chart:
    """One drawing.

    Attributes:
        title: Title of the drawing.
        unit: Unit of every value.
        curves: Curves, at most three.
        bounds: Plotted limits.
        reading: Text with extremes and limits.
        beyond: Whether a limit was broken.
        categories: Names of the values 0, 1, ... if they are categories.
        tall: Whether it is the most important chart, drawn taller.
        least: Smallest range of the value axis.
    """

    title: str
    unit: str
    curves: Sequence[Curve]
    bounds: Sequence[Bound] = ()
    reading: str = ""
    beyond: bool = False
    categories: Sequence[str] = ()
    tall: bool = False
    least: float = 0.0


def draw(
    chart: Chart, axis: TimeAxis, shades: Sequence[Shade] = (), mark: Mark | None = None
) -> str:
    """Return a chart as HTML."""
    low, high = _range(chart)
    height = high - low

    def up(value: float) -> float:
        return 100.0 * (value - low) / height

    on_left = mark is None or axis.at(mark.time) > 0.5
    parts = [
        f'<figure class="chart{" tall" if chart.tall else ""}">',
        *_caption(chart),
        '<div class="plot"><div></div><div class="names">',
        *_names(shades, axis),
        '</div><div class="ys">',
        *(
            f'<span class="at" style="bottom:{up(v):.2f}%">{escape(t)}</span>'
            for v, t in _levels(chart, low, high)
        ),
        '</div><div class="area">',
        *_svg(chart, axis, shades, mark, low, high),
        *(
            label
            for bound in chart.bounds
            for label in _bound_labels(bound, chart, axis, up, on_left)
        ),
        *([] if mark is None else [_mark_label(mark, axis)]),
        f'</div><div class="clock">{escape(axis.clock)}</div><div class="times">',
        *(
            f'<span class="at" style="left:{100.0 * x:.2f}%">{text} s</span>'
            for x, text in axis.ticks()
        ),
        "</div></div></figure>",
    ]
    return "".join(parts)


def _caption(chart: Chart) -> Iterator[str]:
    unit = f" <span>[{escape(chart.unit)}]</span>" if chart.unit else ""
    yield f"<figcaption><b>{escape(chart.title)}</b>{unit}"
    for index, curve in enumerate(chart.curves):
        line = f"{_BORDERS[index]} {_COLOURS[index]}"
        yield (
            f' <span class="name"><span class="key" style="border-top:3px '
            f'{line}"></span>{escape(curve.name)}</span>'
        )
    if chart.bounds:
        yield (
            ' <span class="name"><span class="key" style="border-top:2px dashed '
            '#a30000"></span>limit</span>'
        )
    if chart.reading:
        reading = f"{chart.reading}: BEYOND THE LIMIT" if chart.beyond else chart.reading
        yield f'<br><span class="read{" beyond" if chart.beyond else ""}">{escape(reading)}</span>'
    yield "</figcaption>"


def _range(chart: Chart) -> tuple[float, float]:
    """Return the lower and upper edge of a chart."""
    if chart.categories:
        return -0.3, len(chart.categories) - 0.7
    values = [value for bound in chart.bounds for _, value in bound.steps]
    for curve in chart.curves:
        finite = (
            curve.bins.low[np.isfinite(curve.bins.low)],
            curve.bins.high[np.isfinite(curve.bins.high)],
        )
        if len(finite[0]) and len(finite[1]):
            values += [float(finite[0].min()), float(finite[1].max())]
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    if not high - low > max(chart.least, 1e-9 * max(abs(low), abs(high))):
        half = max(0.05 * abs(high), 0.5 * chart.least, 1e-6)
        low, high = low - half, high + half
    # Room above for the name of the mark.
    return low - _MARGIN * (high - low), high + (0.1 if chart.tall else 0.17) * (high - low)


def _levels(chart: Chart, low: float, high: float) -> Iterator[tuple[float, str]]:
    """Yield the values with a grid line, and the labels of the lines."""
    if chart.categories:
        yield from ((float(index), name) for index, name in enumerate(chart.categories))
        return
    step = nice((high - low) / (6.0 if chart.tall else 4.0))
    for k in range(math.ceil(low / step), math.floor(high / step) + 1):
        yield k * step, tick_label(k * step, step)


def _names(shades: Sequence[Shade], axis: TimeAxis) -> Iterator[str]:
    for shade in shades:
        left, right = 100.0 * axis.at(shade.start), 100.0 * axis.at(shade.stop)
        if shade.name and right - left > _LEAST_NAMED:
            name = escape(shade.name)
            style = f"left:{left:.2f}%;width:{right - left:.2f}%"
            yield f'<span class="at" style="{style}" title="{name}"><i>{name}</i></span>'


def _bound_labels(
    bound: Bound, chart: Chart, axis: TimeAxis, up: Callable[[float], float], on_left: bool
) -> Iterator[str]:
    """Yield the labels of the constant parts of a limit, on the permitted side of the limit and at
    the left or right end of each part; short parts have no label.
    """
    below = "transform:translateY(100%);" if bound.upper else ""
    for left, right, value in _stairs(bound, axis):
        if right - left >= _LEAST_LABELLED:
            side = (
                f"left:{100.0 * left + 0.5:.2f}%"
                if on_left
                else f"right:{100.5 - 100.0 * right:.2f}%"
            )
            text = escape(f"limit {value:.4g} {chart.unit}")
            yield (
                f'<span class="at bound" '
                f'style="{below}{side};bottom:{up(value):.2f}%">{text}</span>'
            )


def _mark_label(mark: Mark, axis: TimeAxis) -> str:
    place = axis.at(mark.time)
    side = f"right:{100.0 * (1.0 - place):.2f}%" if place > 0.5 else f"left:{100.0 * place:.2f}%"
    return f'<span class="at mark" style="{side}">{escape(mark.name)}</span>'


def _svg(
    chart: Chart,
    axis: TimeAxis,
    shades: Sequence[Shade],
    mark: Mark | None,
    low: float,
    high: float,
) -> Iterator[str]:
    def y(value: float) -> float:
        return _SIZE * (high - value) / (high - low)

    yield f'<svg viewBox="0 0 {_SIZE:g} {_SIZE:g}" preserveAspectRatio="none" aria-hidden="true">'
    for shade in shades:
        left, right = _SIZE * axis.at(shade.start), _SIZE * axis.at(shade.stop)
        if right > left:
            yield (
                f'<rect class="s{shade.kind}" x="{left:.1f}" width="{right - left:.1f}" '
                f'height="{_SIZE:g}"/>'
            )
    yield '<g stroke="#00000018" stroke-width="1">'
    yield "".join(
        f'<path d="M0 {y(value):.1f}H{_SIZE:g}"/>' for value, _ in _levels(chart, low, high)
    )
    yield "".join(f'<path d="M{_SIZE * x:.1f} 0V{_SIZE:g}"/>' for x, _ in axis.ticks())
    yield f'</g><rect width="{_SIZE:g}" height="{_SIZE:g}" stroke="#999"/>'
    for bound in chart.bounds:
        path = "".join(
            f"M{_SIZE * a:.1f} {y(value):.1f}H{_SIZE * b:.1f}"
            for a, b, value in _stairs(bound, axis)
        )
        yield f'<path d="{path}" stroke="#a30000" stroke-width="1.5" stroke-dasharray="5 4"/>'
    for index, curve in enumerate(chart.curves):
        path, dots = _path(curve, axis, low, high)
        dash = f' stroke-dasharray="{_DASHES[index]}"' if _DASHES[index] else ""
        yield (
            f'<path d="{path}" stroke="{_COLOURS[index]}" stroke-width="1.6" '
            f'stroke-linejoin="round"{dash}/>'
        )
        if dots:
            yield (
                f'<path d="{dots}" stroke="{_COLOURS[index]}" stroke-width="5" '
                f'stroke-linecap="round"/>'
            )
    if mark is not None:
        yield (
            f'<path d="M{_SIZE * axis.at(mark.time):.1f} 0V{_SIZE:g}" stroke="#000" '
            f'stroke-width="1.5"/>'
        )
    yield "</svg>"


def _stairs(bound: Bound, axis: TimeAxis) -> Iterator[tuple[float, float, float]]:
    """Yield start, end and value of each constant part of a limit within the page."""
    begins, ends = axis.ends
    for (start, value), stop in zip(
        bound.steps, [*(s for s, _ in bound.steps[1:]), ends], strict=True
    ):
        if max(start, begins) < min(stop, ends):
            yield axis.at(max(start, begins)), axis.at(min(stop, ends)), value


def _path(curve: Curve, axis: TimeAxis, low: float, high: float) -> tuple[str, str]:
    """Return the path of a curve and, if the curve has few samples, the path of dots at the
    samples.
    """
    bins = in_columns(curve.bins, axis.place(curve.bins.start), COLUMNS)
    x = _SIZE * axis.place(0.5 * (bins.start + bins.stop))
    tops, bottoms = (_SIZE * (high - side[:, 0]) / (high - low) for side in (bins.high, bins.low))
    words: list[str] = []
    previous = math.nan
    for at, top, bottom, broken in zip(
        x.tolist(), tops.tolist(), bottoms.tolist(), bins.broken.tolist(), strict=True
    ):
        if not (math.isfinite(top) and math.isfinite(bottom)):
            previous = math.nan
            continue
        verb = "M" if broken or previous != previous else "L"
        if bottom - top < 1.0:
            words.append(f"{verb}{at:.1f} {top:.1f}")
            previous = top
            continue
        # Start at the end nearer to the previous point.
        first, second = (
            (top, bottom) if abs(top - previous) < abs(bottom - previous) else (bottom, top)
        )
        words.append(f"{verb}{at:.1f} {first:.1f}V{second:.1f}")
        previous = second
    if len(curve.bins.start) > _FEW:
        return "".join(words), ""
    dots = (
        f"M{a:.1f} {t:.1f}h0"
        for a, t in zip(x.tolist(), tops.tolist(), strict=True)
        if math.isfinite(t)
    )
    return "".join(words), "".join(dots)
