"""Figures of several runs: parameters side by side, and parameters over a history."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from identification.plots.style import BLACK, BLUE, CYCLE, GREY, VERMILION, Figure, figure
from rig.runs.catalogue.entry import Constant

_COLUMNS = 3
_LEAD_WIDTH = 5.2
"""Width of a figure that a page opens with, inches, at which it can be read on a telephone."""


def side_by_side(names: Sequence[str], runs: Mapping[str, Mapping[str, Constant]]) -> Figure:
    """Draw the parameters of several runs in percent of the first run's values, with 90 %
    intervals.
    """
    height = 0.45 * len(names) + 0.2 * len(runs) + 1.0
    made, (axis,) = figure(1, width=_LEAD_WIDTH, height=height)
    first = next(iter(runs.values()))
    offset = 0.6 / len(runs)
    for number, (run, constants) in enumerate(runs.items()):
        places, values, below, above = [], [], [], []
        for row, name in enumerate(names):
            base, each = first[name].value, constants.get(name)
            if not base or each is None or each.value is None:
                continue
            low = each.value if each.low is None else each.low
            high = each.value if each.high is None else each.high
            places.append(row + (number - 0.5 * (len(runs) - 1)) * offset)
            values.append(100.0 * (each.value / base - 1.0))
            ends = sorted(100.0 * (end / base - 1.0) for end in (low, high))
            below.append(max(0.0, values[-1] - ends[0]))
            above.append(max(0.0, ends[1] - values[-1]))
        colour = CYCLE[number % len(CYCLE)]
        axis.errorbar(
            values, places, xerr=(below, above), fmt="o", color=colour, capsize=3, label=run
        )
    axis.axvline(0.0, color=GREY, linewidth=0.8)
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlabel("difference from the first run (%), 90 % intervals")
    axis.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return made


def courses(
    histories: Mapping[str, Mapping[int, Constant]], alarms: Mapping[str, int | None]
) -> Figure:
    """Draw each parameter over the runs with its intervals; detected changes are red.

    Args:
        histories: Index of a run and value of the constant in that run, in the order of time, by
            the name of the constant.
        alarms: Names of the constants that changed; for a step, the number of the first value
            after the step, for a drift None.
    """
    rows = math.ceil(len(histories) / _COLUMNS)
    size = (_LEAD_WIDTH, 3.4) if len(histories) == 1 else (10.0, 2.3 * rows)
    made, axes = figure(rows, min(_COLUMNS, len(histories)), width=size[0], height=size[1])
    for axis, (name, history) in zip(axes, histories.items(), strict=False):
        places = [index + 1 for index in history]
        constants = list(history.values())
        values = [math.nan if each.value is None else each.value for each in constants]
        halves = [each.half_width or 0.0 for each in constants]
        colour = VERMILION if name in alarms else BLUE
        axis.errorbar(places, values, yerr=halves, fmt="o", color=colour, capsize=2, markersize=4)
        start = alarms.get(name)
        if start is not None:
            axis.axvline(places[start] - 0.5, color=BLACK, linestyle="--", linewidth=0.9)
        words = "" if name not in alarms else ": DRIFT" if start is None else ": STEP"
        axis.set_title(f"{name} ({constants[0].unit}){words}", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.locator_params(axis="x", integer=True)
    for axis in axes[len(histories) :]:
        axis.set_axis_off()
    made.supxlabel("run", fontsize=9)
    return made
