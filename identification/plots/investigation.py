"""Draws an investigation: the odds of the hypotheses after each experiment, and a prediction
against the recording that it predicted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identification.numerics.arrays import Array
from identification.plots.style import BLUE, MEASURED, MODEL, ZERO, figure, legend_above, thinned

FEW = 6  # number of hypotheses that are drawn, the most likely ones of any experiment


def odds(experiments: Sequence[str], each: Sequence[Mapping[str, float]]) -> Figure:
    """Draw the probability of each hypothesis after each experiment.

    Args:
        experiments: Names of the experiments, in order.
        each: Name of each hypothesis to its probability, after each experiment.
    """
    greatest: dict[str, float] = {}
    for after in each:
        for name, p in after.items():
            greatest[name] = max(p, greatest.get(name, 0.0))
    shown = sorted(greatest, key=lambda name: -greatest[name])[:FEW]
    made, (axis,) = figure(1, height=4.0)
    at = np.arange(len(experiments))
    for name in shown:
        axis.plot(at, [after.get(name, 0.0) for after in each], marker="o", label=name)
    axis.set_xticks(at, experiments)
    axis.set_ylim(-0.02, 1.02)
    axis.set_xlabel("experiment")
    axis.set_ylabel("probability (1)")
    legend_above(axis, 3)
    return made


def sealed(time: Array, predicted: Array, half_width: Array, measured: Array, unit: str) -> Figure:
    """Draw a prediction with its band and the measured torque, and their difference with the band.

    Args:
        time: s, shape (n,), in steady motion only.
        predicted: Predicted torque, shape (n,).
        half_width: Half width of the band, shape (n,).
        measured: Measured torque at the same times, shape (n,).
        unit: Unit of the torque.
    """
    made, (top, bottom) = figure(2, height=5.5, sharex=True)
    few = thinned(len(time))
    t = time[few]
    top.plot(t, measured[few], label="measured", **MEASURED)
    top.plot(t, predicted[few], label="predicted before the run", **MODEL)
    top.set_ylabel(f"torque ({unit})")
    legend_above(top, 2)
    off = (measured - predicted)[few]
    bottom.fill_between(
        t, -half_width[few], half_width[few], color=BLUE, alpha=0.2, label="band", linewidth=0.0
    )
    bottom.plot(t, off, label="measured - predicted", **MEASURED)
    bottom.axhline(0.0, **ZERO)
    bottom.set_ylabel(f"difference ({unit})")
    bottom.set_xlabel("time (s)")
    legend_above(bottom, 2)
    return made
