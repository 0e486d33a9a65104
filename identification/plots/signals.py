"""Figures of one recording: what it did, how well the fit explains it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from identification.estimate.result import Trace
from identification.plots.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    broken,
    figure,
    legend_above,
    mosaic,
    moving,
    thinned,
)
from identification.recording import Recording


def response(trace: Trace, recording: Recording) -> Figure:
    """Angle and command, velocity, torque and fitted torque against time.

    Args:
        trace: The recording as fitted.
        recording: The recording itself, for its command.
    """
    rotary = recording.bench.motion == "rotary"
    scale = np.rad2deg(1.0) if rotary else 1e3
    made, (top, middle, bottom) = figure(3, height=7.0, sharex=True)
    few = thinned(len(trace.time))
    time = trace.time[few]
    if "command" in recording.channels:
        asked = thinned(len(recording.time))
        command = recording.channels["command"][asked] * scale
        top.plot(recording.time[asked], command, color=GREY, linestyle="--", linewidth=1.4, label="command")
    top.plot(time, trace.angle[few] * scale, color=BLUE, linewidth=1.2, label="measured")
    top.set_ylabel("joint angle (deg)" if rotary else "position (mm)")
    middle.plot(time, trace.velocity[few], color=BLUE, linewidth=1.0, label="measured")
    middle.set_ylabel("velocity (rad/s)" if rotary else "velocity (m/s)")
    bottom.plot(time, trace.torque[few], color=BLUE, linewidth=1.0, label="measured")
    bottom.plot(
        time,
        broken(trace.torque_model, moving(trace))[few],
        color=VERMILION,
        linewidth=1.2,
        label="model, where it moves",
    )
    bottom.set_ylabel("torque (N m)" if rotary else "force (N)")
    bottom.set_xlabel("time (s)")
    for axis in (top, middle, bottom):
        legend_above(axis, 2)
    made.suptitle(f"{trace.recording}: response ({trace.role}, {trace.stage})", fontsize=11)
    return made


def residual(trace: Trace, motion: str) -> Figure:
    """What the model leaves over: against time, against velocity, and how it is spread; moving samples only."""
    rotary = motion == "rotary"
    unit = "N m" if rotary else "N"
    made, (top, left, right) = mosaic("AA;BC", height=6.0)
    error = trace.torque - trace.torque_model
    few = thinned(len(error))
    used = moving(trace)
    shown = broken(error, used)[few]
    top.plot(trace.time[few], shown, color=BLUE, linewidth=0.8)
    top.set_xlabel("time (s)")
    left.plot(trace.velocity[few], shown, ".", color=BLUE, markersize=2.0, alpha=0.5)
    left.set_xlabel("velocity (rad/s)" if rotary else "velocity (m/s)")
    kept = error[used]
    right.hist(kept, bins=60, color=BLUE)
    right.set_xlabel(f"measured - model ({unit})")
    right.set_ylabel("samples (1)")
    if kept.size:
        rms = float(np.sqrt(np.mean(kept**2)))
        for axis in (top, left):
            axis.axhspan(-rms, rms, color=ORANGE, alpha=0.25, linewidth=0, label=f"rms {rms:.3g} {unit}")
            legend_above(axis, 1)
    for axis in (top, left):
        axis.axhline(0.0, color=BLACK, linewidth=0.8)
        axis.set_ylabel(f"measured - model ({unit})")
    made.suptitle(f"{trace.recording}: torque residual ({trace.role}, {trace.stage})", fontsize=11)
    return made
