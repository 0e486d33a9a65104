"""Draws the figures of the flow regulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from identification.numerics.arrays import Array
from identification.plots.style import (
    BLACK,
    BLUE,
    COMMAND,
    GREY,
    THIN,
    VERMILION,
    figure,
    legend_above,
    thinned,
)

__all__ = ["Figure", "areas", "closed_loop", "speeds", "sweep", "tracking", "uniform"]

_MM2 = 1e6


def tracking(time: Array, command: Array, angle: Array, error: Array) -> Figure:
    """Draw the angle and its command, rad, and the error between them, rad, over time, s."""
    made, (top, bottom) = figure(2, height=6.0, sharex=True)
    few = thinned(len(time))
    top.plot(time[few], np.rad2deg(command[few]), label="command", **COMMAND)
    top.plot(time[few], np.rad2deg(angle[few]), color=VERMILION, linewidth=1.5, label="angle")
    bottom.plot(time[few], 1e3 * error[few], color=VERMILION, linewidth=1.2)
    top.set_ylabel("joint angle (deg)")
    bottom.set(ylabel="command - angle (mrad)", xlabel="time (s)")
    legend_above(top, 2)
    return made


def speeds(panels: Sequence[tuple[str, Array, Array, Array]]) -> Figure:
    """Draw joint speeds; a panel has title, time (s), commanded and measured speed (rad/s)."""
    made, axes = figure(len(panels), height=1.0 + 2.6 * len(panels), sharex=True)
    for axis, (name, time, commanded, measured) in zip(axes, panels, strict=True):
        few = thinned(len(time), 20000)
        speed = np.rad2deg(measured[few])
        axis.plot(time[few], speed, color=VERMILION, linewidth=1.0, label="measured")
        axis.plot(time[few], np.rad2deg(commanded[few]), label="command", **COMMAND)
        axis.set_title(name, fontsize=10, loc="left")
        axis.set_ylabel("joint speed (deg/s)")
        axis.set_yscale("symlog", linthresh=2.0)
        ticks = (-100, -10, -2, -1, 0, 1, 2, 10, 100)
        axis.set_yticks(ticks, map(str, ticks))
    axes[-1].set_xlabel("time (s)")
    legend_above(axes[0], 2)
    return made


def areas(angle_deg: Array, impacted: Array, throat: Array, clear_deg: float) -> Figure:
    """Draw the impacted and the effective throat area, m^2, against the valve angle (Fig. 3)."""
    made, (axis,) = figure(1, height=4.4)
    axis.plot(angle_deg, _MM2 * impacted, color=BLUE, label="impacted area $A_s$")
    axis.plot(angle_deg, _MM2 * throat, color=VERMILION, label="effective throat area $A_t$")
    whole = _MM2 * (impacted + throat)
    axis.plot(angle_deg, whole, color=GREY, linestyle="--", linewidth=1.0, label="$A_s + A_t$")
    clear = f"plate clear, {clear_deg:.2f} deg"
    axis.axvline(clear_deg, color=BLACK, linestyle=":", linewidth=1.0, label=clear)
    axis.set(xlabel="valve angle (deg)", ylabel="area (mm$^2$)")
    legend_above(axis, 4)
    return made


def uniform(
    speed: Array,
    panels: Sequence[tuple[str, Array, Mapping[str, Sequence[tuple[float, float, bool]]]]],
) -> Figure:
    """Draw the points of the conventional method (eq. 14) and the true friction.

    Args:
        speed: Speed of the curves, rad/s, shape (n,).
        panels: Title, true friction in N m at ``speed``, and name to points (speed, friction,
            whether the motion was uniform).
    """
    made, axes = figure(1, len(panels), width=9.5, height=4.8)
    for axis, (title, truth, groups) in zip(axes, panels, strict=True):
        axis.plot(speed, truth, color=BLACK, linewidth=1.2, label="true friction")
        styles = ((BLUE, "o"), (VERMILION, "s"))
        for (color, marker), (name, points) in zip(styles, groups.items(), strict=False):
            for filled, face, more in ((True, color, ""), (False, "none", ", stick-slip")):
                if chosen := [(v, m) for v, m, even in points if even is filled]:
                    drawn = axis.plot(*zip(*chosen, strict=True), marker, color=color)
                    drawn[0].set(markerfacecolor=face, label=f"{name}{more}")
        axis.set_xscale("log")
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_xlabel("commanded speed (rad/s)")
        axis.set_ylim(bottom=0.0)
    axes[0].set_ylabel("mean torque in the direction of motion (N m)")
    handles: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    place: dict[str, Any] = {"loc": "outside upper center", "ncols": 5}
    made.legend(list(handles.values()), list(handles), fontsize=8, frameon=False, **place)
    return made


def closed_loop(
    time: Array,
    flow: Mapping[str, Array],
    pressure: Mapping[str, Array],
    angle: Mapping[str, Array],
    current: Array,
    force: Array,
) -> Figure:
    """Draw flow (kg/s), pressure (MPa), angle (rad), current (A) and force (N)."""
    made, (top, second, third, last) = figure(4, height=9.5, sharex=True)
    few = thinned(len(time))
    for axis, pair, scale, label in (
        (top, flow, 1.0, "gas flow (kg/s)"),
        (second, pressure, 1.0, "pressure (MPa)"),
        (third, angle, np.rad2deg(1.0), "valve angle (deg)"),
    ):
        (asked_name, asked), (answer_name, answer) = pair.items()
        axis.plot(time[few], scale * answer[few], color=BLUE, linewidth=1.2, label=answer_name)
        axis.plot(time[few], scale * asked[few], label=asked_name, **COMMAND)
        axis.set_ylabel(label)
        legend_above(axis, 2)
    last.plot(time[few], current[few], color=BLUE, linewidth=0.8, label="motor current")
    last.set(ylabel="motor current (A)", xlabel="time (s)")
    right = last.twinx()
    right.plot(time[few], 1e-3 * force[few], color=VERMILION, linewidth=1.2, label="contact force")
    right.set_ylabel("contact force (kN)")
    right.spines["top"].set_visible(False)
    right.get_lines()[0].set_label("contact force (right)")
    legend_above(last, 2, [*last.get_lines(), *right.get_lines()])
    return made


def sweep(panels: Sequence[tuple[str, Array, Array, Array, Array, Array]]) -> Figure:
    """Draw current, pressure and area against the valve angle, a column for each speed (Fig. 4).

    Args:
        panels: Title, angle (deg), current (A, or NaN if the motion is not uniform), pressure,
            steady pressure (MPa) and impacted area (mm^2).
    """
    made, axes = figure(3, len(panels), width=9.5, height=7.5, sharex=True)
    for column, (title, angle, current, pressure, steady, area) in enumerate(panels):
        top, middle, bottom = axes[column :: len(panels)]
        top.plot(angle, current, **THIN)
        top.set_title(title, fontsize=10, loc="left")
        top.set_ylim(bottom=0.0)
        middle.plot(angle, pressure, color=BLUE, linewidth=1.2, label="measured")
        middle.plot(angle, steady, label="steady at this angle", **COMMAND)
        middle.set_ylim(bottom=0.0)
        bottom.plot(angle, area, color=BLUE, linewidth=1.2)
        bottom.set_xlabel("valve angle (deg)")
        legend_above(middle, 2)
    for row, label in enumerate(("motor current (A)", "pressure (MPa)", "impacted area (mm$^2$)")):
        axes[row * len(panels)].set_ylabel(label)
    return made
