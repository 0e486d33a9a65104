"""Common style of all figures: size, colours, thinning, saving."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy.typing import NDArray

from identification.numerics.arrays import Array
from identification.plots.margins import arrange
from identification.result import Trace

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
MAX_POINTS = 5000
COMPRESSION = {"compress_level": 3}
"""Compression level of zlib; files are 8 % larger than at the default level, and are written in two
thirds of the time.
"""


_GAP = 5.0
"""Gap between two samples, in median time steps, above which no line joins the samples."""


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

    Args:
        rows: Number of rows.
        columns: Number of columns.
        width: Width, inches.
        height: Height, inches.
        sharex: Whether axes of a column have their horizontal axis in common.
        measured: Whether all texts are measured for the layout. If not, drawing takes half of the
            time, but axes must have no titles, and legends only above or inside the axes.
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
    """Return a figure with axes laid out like ``"AA;BC"``, in the order of their letters' first
    occurrence.
    """
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


def legend_above(axis: Axes, columns: int) -> Legend | None:
    """Add a legend above the axes, where it covers no data; if no line has a label, add no
    legend.
    """
    if not axis.get_legend_handles_labels()[0]:
        return None
    return axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.985), ncols=columns, fontsize=8, frameon=False
    )


def png(made: Figure, dpi: int = 110) -> bytes:
    """Return the figure as PNG without dates and versions, so that equal figures give equal
    bytes.
    """
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
