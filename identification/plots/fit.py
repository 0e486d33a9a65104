"""Draws the figures of a fit: friction against speed, convergence, intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identification.estimate.uncertainty import LEVEL
from identification.model.friction import load_coefficient, system_friction
from identification.model.parameters import torque_word, unit_on
from identification.numerics.arrays import Array
from identification.plots.style import (
    BLACK,
    BLUE,
    CYCLE,
    DOTS,
    GREY,
    VERMILION,
    broken,
    figure,
    legend_above,
    moving,
    plain_numbers,
    stacked,
    thinned,
)
from identification.recording import Recording
from identification.result import Convergence, Identification, Parameter, Profile, Starts, Trace

_POINTS_PER_LOAD = 1500
_LEAST_PERCENT = 1e-6  # deviations below this percentage are rounding errors
_FEW_TIMES = 3.0  # a cost that falls by less than this factor is drawn on a linear scale
_LINEAR_PERCENT = (
    10.0  # %: if any deviation exceeds this value, deviations above it are on a logarithmic scale
)
_VARYING = math.inf  # contact moment of a load that varies
LABELS = {
    "Mc": r"$M_c$",
    "Ms": r"$M_s$",
    "omega_sf": r"$\omega_{sf}$",
    "sigma_2": r"$\sigma_2$",
    "J": r"$J$",
    "mu_c": r"$\mu_c$",
    "mu_s": r"$\mu_s$",
    "omega_sL": r"$\omega_{sL}$",
    "mu_2": r"$\mu_2$",
}
_STAGE_TITLES = {"unloaded": "system load", "loaded": "working load"}


def stribeck(result: Identification, moments: Mapping[str, float | None]) -> Figure:
    """Draw friction torque against speed, measured and fitted, one colour per load (eq. 9 and 13).

    ``moments``: recording to its contact moment F_P L1, N m, or None if the contact moment varies;
    then no curve is drawn.
    """
    made, (axis,) = figure(1, height=5.0, measured=False)
    draw_stribeck(axis, result, moments)
    made.suptitle(f"Friction against speed, {result.method} method", fontsize=11)
    return made


def draw_stribeck(
    axis: Axes, result: Identification, moments: Mapping[str, float | None], columns: int = 3
) -> None:
    """Draw the figure of :func:`stribeck` into given axes, with a legend of ``columns`` columns."""
    unit = result.torque_unit
    label: str | None = "fitted"
    values = result.values
    by_load: dict[float, list[Trace]] = {}
    for trace in result.traces:
        known = moments.get(trace.recording, 0.0)
        by_load.setdefault(_VARYING if known is None else round(known, 6), []).append(trace)
    for color, (moment, traces) in zip(CYCLE * len(by_load), sorted(by_load.items()), strict=False):
        names = {0.0: "unloaded", _VARYING: "hot firing"}
        name = names.get(moment, f"$F_P L_1$ = {moment:.4g} {unit_on(result.motion, 'N m')}")
        speeds = np.concatenate([t.velocity[moving(t)] for t in traces])
        torques = np.concatenate([t.friction[moving(t)] for t in traces])
        few = thinned(len(speeds), _POINTS_PER_LOAD)
        dots = axis.plot(speeds[few], torques[few], color=color, markersize=5.0, **DOTS)
        dots[0].set(alpha=0.3, label=f"measured, {name}")
        top = float(np.max(np.abs(speeds), initial=0.0))
        curve = None
        if top > 0.0 and moment != _VARYING:
            curve = _curve(np.linspace(top / 2000.0, top, 2000), moment, values, result.alpha)
        if curve is not None:
            axis.plot(*curve, color=BLACK, linewidth=1.1, label=label)
        else:
            # Some friction parameters are not identifiable by themselves; the fitted friction at
            # the samples is drawn instead of a curve.
            friction = (t.torque_model - (t.torque - t.friction) for t in traces)
            model = np.concatenate([f[moving(t)] for f, t in zip(friction, traces, strict=True)])
            axis.plot(speeds[few], model[few], color=BLACK, markersize=1.5, label=label, **DOTS)
        label = None
    axis.set_xlabel(f"velocity ({unit_on(result.motion, 'rad/s')})")
    axis.set_ylabel(f"friction {torque_word(result.motion)} ({unit})")
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.axvline(0.0, color=GREY, linewidth=0.8)
    legend = legend_above(axis, columns)
    for handle in legend.legend_handles if legend else ():
        if handle is not None:
            handle.set_alpha(1.0)


def convergence(stage: Convergence, truth: Mapping[str, float] | None = None) -> Figure:
    """Draw the deviation of the best parameters, and the cost, over the course of the search (Fig.
    12 and 13).

    ``truth``: true values from which deviations are measured, or None for the final values.
    """
    made, (upper, lower) = figure(2, height=6.0, sharex=True, measured=False)
    cost, count = ("cost", "evaluation") if stage.target is None else ("fitness", "generation")
    costs = stage.cost_history if stage.cost_history is not None else np.array([stage.cost])
    for color, (name, history) in zip(CYCLE, stage.parameter_history.items(), strict=False):
        reference = (truth or {}).get(name, float(history[-1]))
        deviation = (
            np.abs(history - reference) / abs(reference) * 100.0
            if reference
            else np.full(len(history), np.nan)
        )
        shown = broken(deviation, deviation > _LEAST_PERCENT)
        upper.plot(_generations(history), shown, color=color, label=LABELS.get(name, name))
    upper.set_yscale("log")
    plain_numbers(upper.yaxis)
    upper.set_ylabel(f"deviation from the {'true' if truth else 'final'} value (%)")
    legend_above(upper, 6)
    lower.plot(_generations(costs), costs, color=BLUE, label=f"best {cost}")
    if stage.target is not None:
        label = f"target {stage.target:g} {stage.cost_unit}"
        lower.axhline(stage.target, color=VERMILION, linestyle="--", label=label)
    floor = min(float(np.min(costs)), stage.target or math.inf)
    if 0.0 < _FEW_TIMES * floor < float(np.max(costs)):
        lower.set_yscale("log")
        plain_numbers(lower.yaxis)
    else:
        lower.set_ylim(0.0, 1.1 * float(np.max(costs)) or 1.0)
    lower.set(ylabel=f"{cost} ({stage.cost_unit})", xlabel=f"{count} (1)")
    legend_above(lower, 2)
    made.suptitle(f"Convergence: {_STAGE_TITLES.get(stage.stage, stage.stage)}", fontsize=11)
    return made


def intervals(
    results: Sequence[Identification], truth: Mapping[str, float] | None = None
) -> Figure:
    """Draw the 90 % intervals in percent of the first result, or of the true values."""
    names = list(results[0].parameters)
    made, (axis,) = figure(1, height=1.4 + 0.42 * len(names), measured=False)
    for k, (color, result) in enumerate(zip(CYCLE, results, strict=False)):
        _interval_row(
            axis, result, names, results[0], truth, color, 0.22 * (k - 0.5 * (len(results) - 1))
        )
    axis.axvline(0.0, color=GREY, linewidth=0.9, linestyle="--")
    units = [results[0].parameters[name].unit.replace("^2", "$^2$") for name in names]
    axis.set_yticks(
        range(len(names)), [f"{LABELS.get(n, n)} ({u})" for n, u in zip(names, units, strict=True)]
    )
    axis.set_ylim(len(names) - 0.4, -0.6)
    axis.set_xlabel(
        "deviation from the true value (%)"
        if truth
        else f"deviation from {results[0].method}'s value (%)"
    )
    if max(abs(edge) for edge in axis.get_xlim()) > 4.0 * _LINEAR_PERCENT:
        axis.set_xscale("symlog", linthresh=_LINEAR_PERCENT)
    axis.margins(x=0.08)
    legend_above(axis, len(results))
    made.suptitle("Parameters with 90 % intervals", fontsize=11)
    return made


def _interval_row(
    axis: Axes,
    result: Identification,
    names: Sequence[str],
    first: Identification,
    truth: Mapping[str, float] | None,
    color: str,
    shift: float,
) -> None:
    label: str | None = result.method
    for row, name in enumerate(names):
        parameter = result.parameters.get(name)
        reference = (truth or first.values).get(name)
        if parameter is None or parameter.value is None or not reference:
            axis.text(0.0, row + shift, "  not identifiable", color=color, fontsize=8, va="center")
            continue
        scale = 100.0 / reference
        center = (parameter.value - reference) * scale
        low = center if parameter.low is None else (parameter.low - reference) * scale
        high = center if parameter.high is None else (parameter.high - reference) * scale
        axis.plot([low, high], [row + shift] * 2, color=color, linewidth=2.2, solid_capstyle="butt")
        axis.plot([center], [row + shift], "o", color=color, markersize=5, label=label)
        label = None


def _curve(
    speed: Array, moment: float, values: Mapping[str, float], alpha: float
) -> tuple[Array, Array] | None:
    """Return fitted friction at both signs of ``speed``, or None if a parameter is missing."""
    needed = {"Mc", "Ms", "omega_sf", "sigma_2"} | (
        {"mu_c", "mu_s", "omega_sL", "mu_2"} if moment else set()
    )
    if not needed <= values.keys():
        return None
    both = np.concatenate([-speed[::-1], [np.nan], speed])
    torque = system_friction(both, values, alpha) + values.get("offset", 0.0)
    if moment:
        torque = torque + moment * load_coefficient(both, values, alpha)
    return both, torque


def _generations(history: Array) -> Array:
    return np.arange(1.0, len(history) + 1.0)


_COLUMNS = 3
_TOP = 3.0  # greatest deviance shown, relative to the deviance at the ends of the 90 % range


def profiles(curves: Sequence[Profile], parameters: Sequence[Parameter]) -> Figure:
    """Return a figure with a panel for each profile: deviance against the parameter, its 90 %
    range, and the interval.

    ``parameters``: the estimates with their intervals, in any order.
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
            axis.hlines(0.0, p.low, p.high, color=VERMILION, linewidth=4.0)
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
    """Draw the sorted final costs of each search, less the least, on a logarithmic scale."""
    made, axes = figure(1, len(starts), width=4.5 * len(starts), height=3.2, measured=False)
    for axis, search in zip(axes, starts, strict=True):
        ends = np.sort(np.array(search.ends))
        solved = search.absolute
        shown = ends if solved else ends - ends[0]
        limit = search.reached if solved else search.reached - float(ends[0])
        places = np.arange(1, len(ends) + 1)
        axis.plot(places, np.maximum(shown, 0.01 * limit), "o-", color=BLACK, markersize=5)
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
    """Return the curve between its points; the root of the deviance is linear."""
    values = np.linspace(curve.values[0], curve.values[-1], 200)
    side = np.sign(np.arange(len(curve.values)) - int(np.argmin(curve.deviance)))
    root = np.interp(values, curve.values, side * np.sqrt(np.maximum(curve.deviance, 0.0)))
    return values, np.asarray(root**2)


_WIDTH = 4.4  # width of the figure, inches: its text is legible on a screen of 390 pixels


def result(
    identified: Identification, moments: Mapping[str, float | None], recordings: Sequence[Recording]
) -> Figure:
    """Draw friction against speed. Below, draw tracking error, current (or torque) and temperature
    of all recordings, one after the other in time, as far as these channels were recorded.

    ``moments``: recording to its contact moment F_P L1, N m, or None if the contact moment varies.
    """
    rotary = recordings[0].bench.motion == "rotary"
    scale, unit = (np.rad2deg(1.0), "deg") if rotary else (1e3, "mm")
    rows = [
        (f"tracking error ({unit})", [_tracking_error(each, scale) for each in recordings]),
        ("current (A)", [each.channels.get("current") for each in recordings]),
        ("temperature (C)", [each.channels.get("temperature") for each in recordings]),
    ]
    shown = [(label, traces) for label, traces in rows if any(t is not None for t in traces)]
    heights = [3.2, *(1.2 for _ in shown)]
    made, (top, *below) = stacked(heights, width=_WIDTH)
    draw_stribeck(top, identified, moments, columns=2)
    for axis, (label, traces) in zip(below, shown, strict=True):
        begun = 0.0
        for recording, trace in zip(recordings, traces, strict=True):
            few = thinned(len(recording.time))
            time = begun + recording.time[few] - recording.time[0]
            if trace is not None:
                colour = BLUE if recording.stage == "unloaded" else VERMILION
                axis.plot(time, trace[few], color=colour, linewidth=0.8)
            begun = float(time[-1])
            axis.axvline(begun, color=GREY, linewidth=0.5)
        axis.set_ylabel(label)
    if below:
        below[-1].set_xlabel("time of the recordings, one after the other (s)")
    return made


def _tracking_error(recording: Recording, scale: float) -> Array | None:
    command, angle = (recording.channels.get(name) for name in ("command", "angle"))
    return None if command is None or angle is None else np.asarray(scale * (command - angle))


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
            drawn = axis.plot(place, np.maximum(shown, _FLOOR_PERCENT), "o", color=color)
            drawn[0].set(markersize=3.5, alpha=0.7, label=label)
            label = None
    columns = [column for column, name in enumerate(names) if printed.get(name, 0.0) > 0.0]
    stated = [printed[names[c]] for c in columns]
    axis.plot(columns, stated, "_", color=BLACK, markersize=22, mew=2, label="printed")
    axis.set(yscale="log", ylabel="error of the identified value (%)")
    axis.set_xticks(range(len(names)), [LABELS.get(name, name) for name in names])
    axis.set_xlabel("parameter")
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axis.set_title("Errors over the seeds, literal bench without noise", fontsize=11)
    return made
