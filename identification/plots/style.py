"""Common style of all figures: size, colours, thinning, saving."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from identification.numerics.arrays import Array
from identification.result import Trace

_POINT = 1.0 / 72.0
_EDGE, _LINE, _PAD, _TICKS = 3.0 * _POINT, 13.0 * _POINT, 4.0 * _POINT, 17.0 * _POINT
"""Margin at the edge of the figure, height of a line of text, gap between an axis and its label,
and height of ticks with their labels, inches."""
_TICK = 7.0 * _POINT  # length of a tick and gap to its label, inches
_RIGHT = 12.0 * _POINT  # room for half of the last tick label on the right, inches
_FREE = 9.0 * _POINT  # room above axes that have no legend above them, inches


def arrange(made: Figure) -> None:
    """Place the axes of a figure that are laid out in one grid; their labels are aligned."""
    axes = made.axes
    places = [cast(SubplotSpec, axis.get_subplotspec()) for axis in axes]
    widths = [_tick_width(made, axis) for axis in axes]
    rows, columns = places[0].get_gridspec().get_geometry()
    left, top, bottom = np.zeros(columns), np.zeros(rows), np.zeros(rows)
    for axis, place, width in zip(axes, places, widths, strict=True):
        beside = width + _PAD + (_LINE if axis.get_ylabel() else 0.0) + _EDGE
        left[place.colspan.start] = max(left[place.colspan.start], beside)
        above, below = _above(made, axis), _below(axis)
        top[place.rowspan.start] = max(top[place.rowspan.start], above)
        bottom[place.rowspan.stop - 1] = max(bottom[place.rowspan.stop - 1], below)
    width, height = made.get_size_inches()
    title = _LINE + _PAD if made.get_suptitle() else 0.0
    ratios = np.asarray(places[0].get_gridspec().get_height_ratios() or np.ones(rows), dtype=float)
    inner = (width - float(np.sum(left)) - columns * _RIGHT) / columns
    shares = ratios / np.sum(ratios) * (height - title - float(np.sum(top) + np.sum(bottom)))
    starts = np.cumsum(left) + (inner + _RIGHT) * np.arange(columns)
    tops = height - title - np.cumsum(top) - np.cumsum(shares + bottom) + shares + bottom
    for axis, place in zip(axes, places, strict=True):
        first, last = place.colspan.start, place.colspan.stop - 1
        upper, lower = place.rowspan.start, place.rowspan.stop - 1
        size = starts[last] + inner - starts[first], tops[upper] - tops[lower] + shares[lower]
        corner = starts[first], tops[lower] - shares[lower]
        scale = np.array([width, height])
        axis.set_position((*(corner / scale), *(size / scale)))
        aside = left[first] - _LINE - _EDGE
        axis.yaxis.set_label_coords(-aside / size[0], 0.5)
        axis.xaxis.set_label_coords(0.5, -(_TICKS + _PAD) / size[1])
    if made.get_suptitle():
        made.suptitle(made.get_suptitle(), fontsize=11, y=1.0 - _EDGE / height, va="top")


def _tick_width(made: Figure, axis: Axes) -> float:
    """Return the width of the ticks and tick labels on the left of axes, inches."""
    renderer = _renderer(made)
    low, high = sorted(axis.get_ylim())
    labels = [
        label.get_window_extent(renderer).width
        for label in axis.get_yticklabels()
        if low <= label.get_position()[1] <= high
    ]
    return max(labels, default=0.0) / made.dpi + _TICK


def _above(made: Figure, axis: Axes) -> float:
    """Return the room for title and legend above axes, inches."""
    legend = axis.get_legend()
    size = (
        0.0
        if legend is None
        else legend.get_window_extent(_renderer(made)).height / made.dpi + _EDGE
    )
    return max(_FREE, size) + (_LINE + _PAD if axis.get_title() else 0.0)


def _renderer(made: Figure) -> Any:
    """Return the renderer of the figure's canvas, a ``FigureCanvasAgg``."""
    return cast(Any, made.canvas).get_renderer()


def _below(axis: Axes) -> float:
    """Return the room for tick labels and label below axes, inches."""
    named = _LINE + _PAD if axis.get_xlabel() else 0.0
    shown = axis.xaxis.get_tick_params(which="major").get("labelbottom", True)
    return named + (_TICKS if shown else _EDGE) + _EDGE


__all__ = ["Figure"]  # for callers that must not import matplotlib themselves

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
)
BLACK, GREY = "#222222", "#8A8A8A"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""Okabe and Ito's palette, which colour-blind readers can distinguish."""
MEASURED: Mapping[str, Any] = {"color": BLUE, "linewidth": 2.0, "alpha": 0.55}
MODEL: Mapping[str, Any] = {"color": VERMILION, "linewidth": 0.9}
THIN: Mapping[str, Any] = {"color": BLUE, "linewidth": 1.0}
COMMAND: Mapping[str, Any] = {"color": BLACK, "linestyle": "--", "linewidth": 1.0, "zorder": 3}
ZERO: Mapping[str, Any] = {"color": BLACK, "linewidth": 0.8}
DOTS: Mapping[str, Any] = {"linestyle": "none", "marker": "."}
"""Lines of measured signals, of models, of other signals, of commands, and at zero; dots."""
MAX_POINTS = 5000
COMPRESSION = {"compress_level": 3}
"""Compression of zlib: files are 8 % larger, and written in two thirds of the time."""


_GAP = 5.0  # gap between two samples, in median time steps, above which no line joins the samples


def figure(
    rows: int,
    columns: int = 1,
    *,
    width: float = 8.0,
    height: float = 5.0,
    sharex: bool = False,
    measured: bool = True,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with its axes, row by row; no global state of matplotlib is changed.

    ``sharex``: whether axes of a column have their horizontal axis in common. ``measured``: whether
    all texts are measured for the layout. If not, drawing takes half of the time, but axes must
    have no titles, and legends only above or inside the axes.
    """
    made = _canvas(width, height, "constrained" if measured else None)
    grid = made.subplots(rows, columns, squeeze=False, sharex=sharex)
    return made, _dress([axis for row in grid for axis in row])


def stacked(heights: Sequence[float], *, width: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with axes one below the other, of these heights, inches."""
    made = _canvas(width, 1.05 * sum(heights) + 0.4, None)
    grid = made.subplots(len(heights), 1, squeeze=False, height_ratios=list(heights))
    return made, _dress([axis for row in grid for axis in row])


def mosaic(layout: str, *, width: float = 8.0, height: float = 5.0) -> tuple[Figure, list[Axes]]:
    """Return a figure with axes laid out like ``"AA;BC"``, in order of their letters."""
    made = _canvas(width, height, None)
    return made, _dress(list(made.subplot_mosaic(layout).values()))


def _canvas(width: float, height: float, layout: Literal["constrained"] | None) -> Figure:
    made = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(made)
    return made


def _dress(axes: list[Axes]) -> list[Axes]:
    for axis in axes:
        axis.grid(True, color="#E2E2E2", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
    return axes


def thinned(samples: int, limit: int = MAX_POINTS) -> slice:
    """Return the slice of every k-th sample that keeps at most ``limit`` of ``samples``."""
    return slice(None, None, max(1, -(-samples // limit)))


def moving(trace: Trace) -> NDArray[np.bool_]:
    """Return which samples of a trace the fit used, shape (n,)."""
    return np.asarray(trace.used > 0.5)


def broken(values: Array, keep: NDArray[np.bool_]) -> Array:
    """Return the values with NaN where ``keep`` is false, so that a line breaks there."""
    return np.where(keep, values, np.nan)


def continuing(time: Array) -> NDArray[np.bool_]:
    """Return which samples follow their predecessor without a gap, shape (n,); samples at rest may
    have been omitted.

    A line that is broken at all other samples does not connect samples across a gap.
    """
    steps = np.diff(time, prepend=time[:1])
    return (
        np.asarray(steps <= _GAP * np.median(steps[1:]))
        if time.size > 1
        else np.ones(time.size, dtype=bool)
    )


def legend_above(axis: Axes, columns: int, lines: Sequence[Artist] | None = None) -> Legend | None:
    """Add a legend of ``lines``, by default those of the axes with a label, above the axes, where
    it covers no data; without such a line add no legend.
    """
    handles = axis.get_legend_handles_labels()[0] if lines is None else lines
    if not handles:
        return None
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.985), "ncols": columns}
    return axis.legend(handles=handles, fontsize=8, frameon=False, **place)


def rms_band(axis: Axes, error: Array, unit: str) -> None:
    """Shade the rms of an error on both sides of zero."""
    rms = float(np.sqrt(np.mean(error**2)))
    label = f"rms {rms:.3g} {unit}"
    axis.axhspan(-rms, rms, color=ORANGE, alpha=0.25, linewidth=0, label=label)


def png(made: Figure, dpi: int = 110) -> bytes:
    """Return the figure as PNG; equal figures give equal bytes."""
    # Figure.savefig would draw the figure twice, the first time only for the layout.
    made.set_dpi(dpi)
    engine = made.get_layout_engine()
    if engine is None:
        arrange(made)
    else:
        engine.execute(made)
        made.set_layout_engine("none")
    canvas: Any = made.canvas  # matplotlib states no types of print_png
    buffer = io.BytesIO()
    canvas.print_png(buffer, metadata={"Software": None}, pil_kwargs=COMPRESSION)
    if engine is not None:
        made.set_layout_engine(engine)
    return buffer.getvalue()


def plain_numbers(axis: Axis, in_a_decade: Sequence[float] = (1.0, 3.0)) -> None:
    """Label the ticks of a logarithmic axis at the multiples ``in_a_decade`` of each power of ten
    by plain numbers, which are drawn in a fraction of the time of powers of ten.
    """
    axis.set_major_locator(LogLocator(subs=in_a_decade))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
