"""Draws the figure of a prediction: measured and predicted signal, and the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from identification.export.model import Predicted
from identification.plots.style import (
    BLACK,
    BLUE,
    ORANGE,
    VERMILION,
    broken,
    continuing,
    figure,
    legend_above,
    thinned,
)


def predicted(part: Predicted, unit: str) -> Figure:
    """Draw the measured side, the predicted side and the residual of one equation against time.

    Args:
        part: One equation of one recording.
        unit: Unit of the equation.
    """
    made, (top, bottom) = figure(2, height=5.0, sharex=True)
    few = thinned(len(part.time))
    time = part.time[few]
    joined = continuing(time)
    measured, model = (broken(side[few], joined) for side in (part.measured, part.model))
    top.plot(
        time, measured, color=BLUE, linewidth=2.0, alpha=0.55, label="measured, where it moves"
    )
    top.plot(time, model, color=VERMILION, linewidth=0.9, label="model")
    top.set_ylabel(f"{part.equation} ({unit})")
    bottom.plot(time, measured - model, color=BLUE, linewidth=0.8)
    if part.error.size:
        level = float(np.sqrt(np.mean(part.error**2)))
        bottom.axhspan(
            -level, level, color=ORANGE, alpha=0.25, linewidth=0, label=f"rms {level:.3g} {unit}"
        )
    bottom.axhline(0.0, color=BLACK, linewidth=0.8)
    bottom.set_ylabel(f"measured - model ({unit})")
    bottom.set_xlabel("time (s)")
    for axis in (top, bottom):
        legend_above(axis, 2)
    return made
