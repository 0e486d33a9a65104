"""Places the axes of a figure between margins that follow from its labels.

The constrained layout of the plotting library measures every text several times, which takes as
long as drawing. This module measures only the widths of the tick labels beside each axes and the
heights of legends, once; all other margins follow from font sizes.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

_POINT = 1.0 / 72.0
_EDGE, _LINE, _PAD, _TICKS = 3.0 * _POINT, 13.0 * _POINT, 4.0 * _POINT, 17.0 * _POINT
"""Margin at the edge of the figure, height of a line of text, gap between an axis and its label,
and height of ticks with their labels, inches."""
_TICK = 7.0 * _POINT
"""Length of a tick and gap to its label, inches."""
_RIGHT = 12.0 * _POINT
"""Room for half of the last tick label on the right, inches."""
_FREE = 9.0 * _POINT
"""Room above axes that have no legend above them, inches."""


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
    """Return the room for title and legend above axes, inches; a legend inside the axes counts as
    above the axes.
    """
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
