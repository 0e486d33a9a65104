"""Draws an investigation: the odds of the hypotheses after each experiment, and a prediction
against the recording that it predicted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identification.numerics.arrays import Array
from identification.plots.style import (
    MEASURED,
    MODEL,
    ORANGE,
    ZERO,
    broken,
    continuing,
    figure,
    legend_above,
    thinned,
)

FEW = 6
"""Number of hypotheses that are drawn, the most likely ones of any experiment."""


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
    made, (axis,) = figure(1, height=5.0)
    at = np.arange(len(experiments))
    beside = np.linspace(-0.1, 0.1, len(shown))  # equal curves stay visible
    for name, off in zip(shown, beside, strict=True):
        axis.plot(at + off, [after.get(name, 0.0) for after in each], marker="o", label=name)
    axis.set_xticks(at, experiments)
    axis.set_ylim(-0.02, 1.02)
    axis.set_xlabel("experiment")
    axis.set_ylabel("probability (1)")
    legend_above(axis, 3)
    return made


def sealed(traces: Mapping[str, tuple[Array, Array, Array, Array]], unit: str) -> Figure:
    """Draw a prediction with its band and the measured torque, and their difference with the band,
    one column for each recording.

    Args:
        traces: Name of each recording to time, s, in steady motion only, predicted torque, half
            width of the band, and measured torque at the same times, each of shape (n,).
        unit: Unit of the torque.
    """
    made, axes = figure(2, len(traces), width=max(8.0, 5.0 * len(traces)), height=5.5, sharex=True)
    for column, (name, trace) in enumerate(traces.items()):
        top, bottom = axes[column :: len(traces)]
        few = thinned(len(trace[0]))
        t, half = trace[0][few], trace[2][few]
        follows = continuing(t)
        predicted, measured = (broken(trace[k][few], follows) for k in (1, 3))
        top.plot(t, measured, label="measured", **MEASURED)
        top.plot(t, predicted, label="predicted before the run", **MODEL)
        top.set_title(name)
        bottom.fill_between(
            t, -half, half, color=ORANGE, alpha=0.4, label="band", linewidth=0.0, zorder=3
        )
        bottom.plot(t, measured - predicted, label="measured - predicted", **MEASURED)
        bottom.axhline(0.0, **ZERO)
        bottom.set_xlabel("time (s)")
        top.set_ylabel(f"torque ({unit})")
        bottom.set_ylabel(f"difference ({unit})")
    handles = [*top.lines, *bottom.collections, bottom.lines[0]]
    made.legend(handles=handles, loc="outside lower center", ncols=4)
    return made
