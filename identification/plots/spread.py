"""Draws the figure of an estimator's errors over many seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identification.plots.fit import LABELS
from identification.plots.style import BLACK, CYCLE, figure

_FLOOR_PERCENT = 1e-6


def spread(
    errors: Mapping[str, Mapping[str, Sequence[float]]],
    printed: Mapping[str, float],
    names: Sequence[str],
) -> Figure:
    """Draw the error of every parameter for every random seed, one colour per method, and the
    errors that the paper states.

    Args:
        errors: Method to parameter to its errors over the seeds, percent; infinite or NaN errors
            are left out, and errors below 1e-6 % are drawn at 1e-6 %.
        printed: Parameter to the error that the paper states, percent.
        names: Parameters, in the order to be shown.
    """
    made, (axis,) = figure(1, height=4.6)
    for k, (color, (method, by_name)) in enumerate(zip(CYCLE, errors.items(), strict=False)):
        label: str | None = f"{method} method, each seed"
        for column, name in enumerate(names):
            shown = np.array([e for e in by_name.get(name, ()) if np.isfinite(e)])
            place = (
                column + 0.24 * (k - 0.5 * (len(errors) - 1)) + np.linspace(-0.08, 0.08, len(shown))
            )
            axis.plot(
                place,
                np.maximum(shown, _FLOOR_PERCENT),
                "o",
                color=color,
                markersize=3.5,
                alpha=0.7,
                label=label,
            )
            label = None
    columns = [column for column, name in enumerate(names) if printed.get(name, 0.0) > 0.0]
    axis.plot(
        columns,
        [printed[names[c]] for c in columns],
        "_",
        color=BLACK,
        markersize=22,
        mew=2,
        label="printed",
    )
    axis.set_yscale("log")
    axis.set_ylabel("error of the identified value (%)")
    axis.set_xticks(range(len(names)), [LABELS.get(name, name) for name in names])
    axis.set_xlabel("parameter")
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axis.set_title("Errors over the seeds, literal bench without noise", fontsize=11)
    return made
