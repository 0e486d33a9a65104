"""Draws the figures of a diagnosis (mismatch by coordinate and time, curve, rivals) and of an
investigation: odds after each experiment, and a prediction against its recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from identification.diagnosis.result import Fit, IdentifiedEffect, Map, ResidualTrace
from identification.effects.model import Curve
from identification.numerics.arrays import Array
from identification.plots.style import (
    BLACK,
    BLUE,
    GREY,
    MEASURED,
    MODEL,
    ORANGE,
    SKY,
    VERMILION,
    ZERO,
    broken,
    continuing,
    figure,
    legend_above,
    thinned,
)

_OPENING_WIDTH = 4.4
"""Width of the first figure, inches: its text is legible on a screen of 390 pixels."""
_FEW_DECADES = 300.0  # ratio of a logarithmic axis below which the ticks at 2 and 5 have labels too
_COLUMNS = 2
_MOST_MAPS = 8
_LEAST_SHARE = 0.005  # share of the mismatch below which a coordinate is not drawn
_DRAWN = {
    "rad": (math.degrees(1.0), "deg"),
    "Pa": (1e-3, "kPa"),
    "m^2": (1e6, "mm^2"),
    "m^2/s": (1e6, "mm^2/s"),
}
"""Stored unit to conversion factor and displayed unit."""


def errors(fits: Sequence[Fit]) -> Figure:
    """Draw the error of each equation, relative to its noise floor, by the nominal and by the
    corrected model, on the fitted recordings and on the recordings set aside.

    Args:
        fits: Errors of each equation, at least one with a noise floor.
    """
    rows = [
        (f"{fit.equation}, {recordings}", before / fit.noise_floor_rms, after / fit.noise_floor_rms)
        for fit in fits
        for recordings, before, after in (
            ("fitted", fit.baseline_rms, fit.final_rms),
            ("set aside", fit.validate_baseline_rms, fit.validate_final_rms),
        )
        if before is not None and after is not None and fit.noise_floor_rms > 0.0
    ]
    made, (axis,) = figure(1, width=_OPENING_WIDTH, height=1.3 + 0.28 * len(rows))
    for row, (_, before, after) in enumerate(rows):
        axis.plot((before, after), (row, row), color=GREY, linewidth=1.2, zorder=2)
    for place, marker, color, label in ((1, "s", VERMILION, "before"), (2, "o", BLUE, "after")):
        errors = [row[place] for row in rows]
        axis.plot(errors, range(len(rows)), marker, color=color, label=label, zorder=3)
    axis.axvline(1.0, color=BLACK, linewidth=0.8, linestyle="--", label="noise floor")
    axis.set_xscale("log")
    low, high = axis.get_xlim()
    axis.set_xlim(min(low, 0.5), max(high, 2.0))
    low, high = axis.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
    axis.xaxis.set_major_locator(LogLocator(subs=subs))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    axis.set_ylim(len(rows) - 0.5, -0.5)
    axis.set_xlabel("error over the noise floor (1)")
    legend_above(axis, 3)
    return made


def maps(shown: Sequence[Map]) -> Figure:
    """Draw the mean mismatch against each coordinate: by the nominal model with a 90 % band for all
    bins at once, and by the corrected model. Coordinates are sorted by the share of the mismatch
    that they explain, the largest first.

    Args:
        shown: Maps of one equation, at least one; of those that explain anything, the eight with
            the largest shares are drawn, on one vertical scale.
    """
    ranked = sorted(shown, key=lambda m: -m.share)[:_MOST_MAPS]
    ranked = [m for m in ranked if m.share >= _LEAST_SHARE] or ranked[:1]
    columns = min(_COLUMNS, len(ranked))
    rows = -(-len(ranked) // columns)
    made, axes = figure(rows, columns, width=4.6 * columns, height=2.7 * rows + 0.5)
    for axis, one in zip(axes, ranked, strict=False):
        _map(axis, one)
    for axis in axes[len(ranked) :]:
        axis.set_visible(False)
    top = max(max(abs(edge) for edge in axis.get_ylim()) for axis in axes[: len(ranked)])
    for axis in axes[: len(ranked)]:
        axis.set_ylim(-1.05 * top, 1.05 * top)
    handles, labels = axes[0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    made.suptitle(f"Mismatch of the {ranked[0].equation} equation", fontsize=11)
    return made


def trace(one: ResidualTrace, noise_floor: float | None) -> Figure:
    """Draw the mismatch of one recording in time, by the nominal and by the corrected model, with
    the noise floor as a band.

    ``noise_floor``: rms of the noise floor, in the trace's unit, or None if unknown.
    """
    factor, unit = _shown_unit(one.unit)
    made, (axis,) = figure(1, width=9.0, height=3.2)
    few = thinned(len(one.time))
    time = one.time[few]
    for left_over, color, label in ((one.before, VERMILION, "before"), (one.after, BLUE, "after")):
        shown = broken(factor * left_over[few], continuing(time))
        axis.plot(time, shown, color=color, linewidth=0.9, label=label)
    if noise_floor is not None:
        band = factor * noise_floor
        label = f"noise floor {band:.2g} {unit}"
        axis.axhspan(-band, band, color=GREY, alpha=0.3, linewidth=0, zorder=3, label=label)
    axis.axhline(0.0, color=BLACK, linewidth=0.6)
    axis.set(xlabel="time (s)", ylabel=f"measured - model ({unit})")
    legend_above(axis, 3)
    return made


def curve(missing: Curve) -> Figure:
    """Draw the unmodelled torque against the coordinate that explains most of this torque."""
    along, unit = _shown_unit(missing.unit)
    factor, residual_unit = _shown_unit(missing.residual_unit)
    made, (axis,) = figure(1, width=7.0, height=3.2)
    axis.plot(along * missing.grid, factor * missing.value, color=VERMILION, linewidth=1.6)
    axis.axhline(0.0, color=BLACK, linewidth=0.6)
    axis.set_xlabel(_labelled(missing.coordinate, unit))
    sided = "\nagainst the motion" if missing.against_motion else ""
    axis.set_ylabel(f"missing {_quantity(missing)}{sided} ({residual_unit})")
    return made


def rivals(effect: IdentifiedEffect) -> Figure:
    """Draw the confidence of an effect and its rivals; bars not rejected are filled."""
    names = [effect.name, *(r.name for r in effect.rivals)]
    shares = [effect.confidence, *(r.confidence for r in effect.rivals)]
    open_ones = [True, *(r.why_not == "" for r in effect.rivals)]
    made, (axis,) = figure(1, width=7.0, height=1.1 + 0.34 * len(names))
    for row, (share, kept) in enumerate(zip(shares, open_ones, strict=True)):
        color = BLUE if row == 0 else SKY
        face = color if kept else "none"
        axis.barh(row, share, height=0.6, facecolor=face, edgecolor=color, linewidth=1.2)
        axis.text(
            share + 0.01, row, f"{share:.2g}{'' if kept else ', rejected'}", va="center", fontsize=8
        )
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlim(0.0, 1.15)
    axis.set_xlabel("confidence (1)")
    axis.grid(visible=False, axis="y")
    return made


def _map(axis: Axes, one: Map) -> None:
    along, unit = _shown_unit(one.unit)
    factor, residual_unit = _shown_unit(one.residual_unit)
    order = np.argsort(one.centre, kind="stable")
    x = along * one.centre[order]
    low, high, mean, after = (
        factor * series[order] for series in (one.low, one.high, one.mean, one.after)
    )
    band = axis.fill_between(x, low, high, color=VERMILION, alpha=0.22, linewidth=0)
    band.set_label("90 % band, all bins at once")
    axis.plot(x, mean, "o-", color=VERMILION, linewidth=1.5, markersize=3.0, label="before")
    axis.plot(x, after, "s--", color=BLUE, linewidth=1.3, markersize=2.5, label="after")
    axis.axhline(0.0, color=BLACK, linewidth=0.6)
    axis.set_xlabel(_labelled(one.coordinate, unit))
    axis.xaxis.set_major_locator(MaxNLocator(6, integer=one.coordinate.endswith("direction")))
    sided = "\nagainst the motion" if one.against_motion else ""
    axis.set_ylabel(f"mismatch{sided} ({residual_unit})")
    axis.set_title(f"{one.coordinate}: explains {100.0 * one.share:.3g} %", fontsize=9, loc="left")


def _shown_unit(unit: str) -> tuple[float, str]:
    """Return conversion factor and displayed unit."""
    return _DRAWN.get(unit, (1.0, unit))


def _labelled(coordinate: str, unit: str) -> str:
    return f"{coordinate} ({unit or '1'})"


def _quantity(missing: Curve) -> str:
    other = {"transmission": "angle", "voltage": "voltage", "pressure": "pressure"}
    return other.get(missing.equation, "force" if missing.residual_unit == "N" else "torque")


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
    made, (axis,) = figure(1, height=5.0)
    at = np.arange(len(experiments))
    beside = np.linspace(-0.1, 0.1, len(shown))  # equal curves stay visible
    for name, off in zip(shown, beside, strict=True):
        axis.plot(at + off, [after.get(name, 0.0) for after in each], marker="o", label=name)
    axis.set_xticks(at, experiments)
    axis.set_ylim(-0.02, 1.02)
    axis.set(xlabel="experiment", ylabel="probability (1)")
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
