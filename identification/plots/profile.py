"""Draws the figures of uncertainty: likelihood profiles, and search ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from identification.estimate.profile import LEVEL
from identification.numerics.arrays import Array
from identification.plots.fit import LABELS
from identification.plots.style import BLACK, BLUE, GREY, VERMILION, figure, plain_numbers
from identification.result import Parameter, Profile, Starts

_COLUMNS = 3
_TOP = 3.0
"""Greatest deviance shown, relative to the deviance at the ends of the 90 % range."""


def profiles(curves: Sequence[Profile], parameters: Sequence[Parameter]) -> Figure:
    """Return a figure with a panel for each profile: deviance against the parameter, its 90 %
    range, and the interval.

    Args:
        curves: One or more profile likelihoods.
        parameters: The estimates with their intervals, in any order.
    """
    rows = math.ceil(len(curves) / _COLUMNS)
    made, axes = figure(rows, _COLUMNS, width=9.5, height=0.6 + 2.5 * rows)
    by_name = {p.name: p for p in parameters}
    for axis, curve in zip(axes, curves, strict=False):
        axis.plot(curve.values, curve.deviance, "o", color=BLUE, markersize=3.5)
        axis.plot(*_smooth(curve), color=BLUE, linewidth=1.2)
        axis.axhline(LEVEL, color=GREY, linewidth=0.9, linestyle="--")
        for end in (curve.low, curve.high):
            if end is not None:
                axis.axvline(end, color=BLUE, linewidth=0.9, linestyle=":")
        p = by_name[curve.name]
        if p.low is not None and p.high is not None:
            axis.plot(
                [p.low, p.high], [0.0, 0.0], color=VERMILION, linewidth=4.0, solid_capstyle="butt"
            )
        axis.set_ylim(-0.3, _TOP * LEVEL)
        axis.ticklabel_format(axis="x", useOffset=False)
        axis.tick_params(labelsize=7)
        axis.locator_params(axis="x", nbins=4)
        unit = curve.unit.replace("^2", "$^2$")
        axis.set_xlabel(f"{LABELS.get(curve.name, curve.name)} ({unit})", fontsize=9)
        axis.set_ylabel("deviance (1)", fontsize=8)
    for axis in axes[len(curves) :]:
        axis.remove()
    made.suptitle(
        "Likelihood profiles (blue, 90 % range dotted) and 90 % intervals (red)", fontsize=11
    )
    return made


def waterfall(starts: Sequence[Starts]) -> Figure:
    """Return a figure of the search ends of each search, sorted from the best: the final cost less
    the least final cost, on a logarithmic scale.
    """
    made, axes = figure(1, len(starts), width=4.5 * len(starts), height=3.2, measured=False)
    for axis, search in zip(axes, starts, strict=True):
        ends = np.sort(np.array(search.ends))
        solved = search.absolute
        shown = ends if solved else ends - ends[0]
        limit = search.reached if solved else search.reached - float(ends[0])
        axis.plot(
            np.arange(1, len(ends) + 1),
            np.maximum(shown, 0.01 * limit),
            "o-",
            color=BLACK,
            markersize=5,
        )
        axis.axhline(limit, color=GREY, linewidth=0.9, linestyle="--")
        axis.set_yscale("log")
        plain_numbers(axis.yaxis, (1.0,))
        axis.set_xlim(0.5, len(ends) + 0.5)
        axis.set_xticks(range(1, len(ends) + 1))
        axis.set_xlabel("start, best first (1)")
        axis.set_ylabel(f"{search.cost}{'' if solved else ' above the least'} (1)", fontsize=8)
        axis.set_title(f"{search.stage}: {search.best} of {len(ends)}", fontsize=9)
    made.suptitle("Where the starts ended", fontsize=11)
    return made


def _smooth(curve: Profile) -> tuple[Array, Array]:
    """Return the curve interpolated between its points; the square root of the deviance is
    linear.
    """
    values = np.linspace(curve.values[0], curve.values[-1], 200)
    side = np.sign(np.arange(len(curve.values)) - int(np.argmin(curve.deviance)))
    root = np.interp(values, curve.values, side * np.sqrt(np.maximum(curve.deviance, 0.0)))
    return values, np.asarray(root**2)
