"""Draws the power map: effects in rows, values of the axes in columns."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from PIL import Image

from benchmarks.power.axes import AXES, BASE
from benchmarks.power.table import Key, Spread
from identification.effects import EFFECTS

matplotlib.use("Agg")
from matplotlib import pyplot as plt

EDGES = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, math.inf)
LABELS = ("under 1", "1 to 3", "3 to 10", "10 to 30", "30 to 100", "100 to 300", "over 300")
COLOURS = ("#08306b", "#2171b5", "#6baed6", "#c6dbef", "#fee391", "#fe9929", "#cc4c02")
DARK = (0, 1, 6)
"""Colours on which the number is white."""
NOT_SHOWN = "#d9d9d9"
HEADS = {
    "rate": "rate of the log",
    "bits": "joint's encoder",
    "encoders": "encoders",
    "loads": "loads",
    "excitation": "excitation",
    "voltage": "voltage",
}
GAP = 0.6
"""Space between two axes, in columns."""


def draw(cells: dict[str, dict[Key, Spread]], machines: int, path: Path) -> None:
    """Draw the medians over machines."""
    effects, places = list(cells), _places()
    figure, axes = plt.subplots(figsize=(15.5, 13.5), layout="constrained")
    norm, colours = BoundaryNorm(range(len(COLOURS) + 1), len(COLOURS)), ListedColormap(COLOURS)
    for row, effect in enumerate(effects):
        for key, x in places.items():
            middle = cells[effect][key].middle
            if not math.isfinite(middle):
                colour, text, ink = NOT_SHOWN, "\u2013", "#555555"
            else:
                step = int(np.searchsorted(EDGES, middle, side="right")) - 1
                colour, text = colours(norm(step)), number(100.0 * middle)
                ink = "white" if step in DARK else "black"
            axes.add_patch(plt.Rectangle((x, row), 1.0, 1.0, facecolor=colour, edgecolor="white"))
            weight = "bold" if BASE[key[0]] == key[1] else "normal"
            place = (x + 0.5, row + 0.52)
            axes.text(*place, text, ha="center", va="center", fontsize=7, color=ink, weight=weight)
    _label(axes, effects, places)
    handles = [plt.Rectangle((0, 0), 1, 1, color=c) for c in (*COLOURS, NOT_SHOWN)]
    axes.legend(
        handles,
        (*LABELS, "not shown"),
        title="Least size that the recordings can show, in % of the middle size that the proofs "
        f"inject (median of {machines} machines; bold: base world)",
        loc="upper center",
        bbox_to_anchor=(0.42, -0.01),
        ncols=8,
        frameon=False,
        fontsize=9,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": ""})
    plt.close(figure)
    # Few colours: a fifth of the size.
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


def number(percent: float) -> str:
    """Return a share in percent with two digits at most."""
    if percent >= 9.5:
        return f"{percent:.0f}" if percent < 9995 else "10k+"
    return f"{percent:.1f}" if percent >= 0.095 else f"{percent:.2f}" if percent >= 0.01 else "<.01"


def _places() -> dict[Key, float]:
    """Return the left edge of each column."""
    places, x = {}, 0.0
    for axis, values in AXES.items():
        for value in values:
            places[(axis, value)] = x
            x += 1.0
        x += GAP
    return places


def _label(axes: plt.Axes, effects: list[str], places: dict[Key, float]) -> None:
    """Write effects, groups, values and axes around the map."""
    right = max(places.values()) + 1.0
    axes.set(xlim=(0.0, right), ylim=(len(effects), 0.0))
    axes.set_yticks([k + 0.5 for k in range(len(effects))], effects, fontsize=9)
    axes.set_xticks([x + 0.5 for x in places.values()], [value for _, value in places])
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    plt.setp(axes.get_xticklabels(), rotation=60, ha="left", rotation_mode="anchor", fontsize=9)
    for axis, values in AXES.items():
        middle = places[(axis, values[0])] + len(values) / 2.0
        axes.text(middle, -4.1, HEADS[axis], ha="center", fontsize=11, weight="bold")
    for side in axes.spines.values():
        side.set_visible(False)
    groups = [EFFECTS[e].group for e in effects]
    for k in range(1, len(groups)):
        if groups[k] != groups[k - 1]:
            axes.axhline(k, color="black", linewidth=0.8)
    for group in dict.fromkeys(groups):
        rows = [k for k, g in enumerate(groups) if g == group]
        middle = (rows[0] + rows[-1] + 1) / 2.0
        axes.text(right + 0.3, middle, group, rotation=270, va="center", fontsize=10)
