"""Draws the figure at the top of a report: identified friction, and the motion of the machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identification.numerics.arrays import Array
from identification.plots.fit import draw_stribeck
from identification.plots.style import BLUE, GREY, VERMILION, stacked, thinned
from identification.recording import Recording
from identification.result import Identification

_WIDTH = 4.4
"""Width of the figure, inches: its text is legible on a screen of 390 pixels."""


def result(
    identified: Identification,
    moments: Mapping[str, float | None],
    recordings: Sequence[Recording],
) -> Figure:
    """Draw friction against speed. Below, draw tracking error, current (or torque) and temperature
    of all recordings, one after the other in time, as far as these channels were recorded.

    Args:
        identified: The fit.
        moments: Recording to its contact moment F_P L1, N m, or None if the contact moment varies.
        recordings: The recordings that were identified.
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
        _courses(axis, recordings, traces)
        axis.set_ylabel(label)
    if below:
        below[-1].set_xlabel("time of the recordings, one after the other (s)")
    return made


def _tracking_error(recording: Recording, scale: float) -> Array | None:
    command, angle = (recording.channels.get(name) for name in ("command", "angle"))
    return None if command is None or angle is None else np.asarray(scale * (command - angle))


def _courses(axis: Axes, recordings: Sequence[Recording], traces: Sequence[Array | None]) -> None:
    begun = 0.0
    for recording, trace in zip(recordings, traces, strict=True):
        few = thinned(len(recording.time))
        time = begun + recording.time[few] - recording.time[0]
        if trace is not None:
            colour = BLUE if recording.stage == "unloaded" else VERMILION
            axis.plot(time, trace[few], color=colour, linewidth=0.8)
        begun = float(time[-1])
        axis.axvline(begun, color=GREY, linewidth=0.5)
