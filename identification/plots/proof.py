"""Draws the figures of a blind proof: rates of detection by strength, and confusion of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from identification.plots.style import CYCLE, figure

Band = tuple[float, float, float]
"""A share with the lower and upper end of its interval."""


def power_curve(labels: Sequence[str], curves: Mapping[str, Sequence[Band]]) -> Figure:
    """Draw the shares of trials with a right name, with intervals, against bands of strength.

    Args:
        labels: Labels of the bands.
        curves: Name to one share with its interval for each band.
    """
    made, (axis,) = figure(1, height=4.2)
    for k, (color, (name, bands)) in enumerate(zip(CYCLE, curves.items(), strict=False)):
        share, low, high = np.array(bands, dtype=np.float64).reshape(-1, 3).T
        place = np.arange(len(labels)) + 0.1 * (k - 0.5 * (len(curves) - 1))
        bars = (np.maximum(share - low, 0.0), np.maximum(high - share, 0.0))
        axis.errorbar(place, share, bars, fmt="o-", color=color, capsize=3, label=name)
    axis.set_ylim(-0.03, 1.03)
    axis.set_xticks(range(len(labels)), labels)
    axis.set_xlabel("change of the strongest channel over its noise")
    axis.set_ylabel("share of trials")
    axis.legend(fontsize=8)
    return made


def confusion_matrix(table: Mapping[str, Mapping[str, int]]) -> Figure:
    """Draw the confusion of injected and identified effects, as shares of a row.

    Args:
        table: Injected effect -> first identified effect -> count.
    """
    given = sorted(
        {name for row in table.values() for name in row}, key=lambda name: (name not in table, name)
    )
    shares = np.zeros((len(table), len(given)))
    for i, row in enumerate(table.values()):
        for name, times in row.items():
            shares[i, given.index(name)] = times / sum(row.values())
    made, (axis,) = figure(1, width=10.0, height=9.0)
    axis.grid(False)
    image = axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axis.set_xticks(range(len(given)), given, rotation=90, fontsize=6)
    axis.set_yticks(range(len(table)), list(table), fontsize=6)
    axis.set_xlabel("called")
    axis.set_ylabel("true")
    made.colorbar(image, ax=axis, shrink=0.6, label="share of the trials")
    return made
