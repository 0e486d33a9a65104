"""Draws the signals of recordings: measured, fitted, predicted, simulated, and the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from identification.effects.prediction import Simulation
from identification.model.parameters import torque_word, unit_on
from identification.plots.style import (
    BLUE,
    COMMAND,
    DOTS,
    MEASURED,
    MODEL,
    THIN,
    VERMILION,
    ZERO,
    broken,
    continuing,
    figure,
    legend_above,
    mosaic,
    moving,
    rms_band,
    thinned,
)
from identification.prepare import Prepared, joint_angle, torque_unit
from identification.recording import Recording
from identification.result import Trace
from identification.simulation.closed_loop import Response, simulated_torque
from identification.views.predicted import Predicted


def response(trace: Trace, recording: Recording, unit: str) -> Figure:
    """Draw angle and command, velocity, torque and fitted torque against time."""
    motion = recording.bench.motion
    scale, label = _angle(motion)
    made, (top, middle, bottom) = figure(3, height=7.0, sharex=True, measured=False)
    few = thinned(len(trace.time))
    time = trace.time[few]
    if "command" in recording.channels:
        asked = thinned(len(recording.time))
        command = recording.channels["command"][asked] * scale
        top.plot(recording.time[asked], command, label="command", **COMMAND)
    top.plot(time, trace.angle[few] * scale, label="measured", **{**THIN, "linewidth": 1.6})
    top.set_ylabel(label)
    middle.plot(time, trace.velocity[few], label="measured", **THIN)
    middle.set_ylabel(f"velocity ({unit_on(motion, 'rad/s')})")
    bottom.plot(time, trace.torque[few], label="measured", **MEASURED)
    model = broken(trace.torque_model, moving(trace))[few]
    bottom.plot(time, model, label="model, where it moves", **MODEL)
    bottom.set(ylabel=f"{torque_word(motion)} ({unit})", xlabel="time (s)")
    for axis in (top, middle, bottom):
        legend_above(axis, 2)
    made.suptitle(f"{trace.recording}: response ({trace.role}, {trace.stage})", fontsize=11)
    return made


def residual(trace: Trace, motion: str, unit: str) -> Figure:
    """Draw the model's residual over time and velocity, and its histogram; moving samples only."""
    made, (top, left, right) = mosaic("AA;BC", height=6.0)
    error, label = trace.torque - trace.torque_model, f"measured - model ({unit})"
    few, used = thinned(len(error)), moving(trace)
    shown = broken(error, used)[few]
    top.plot(trace.time[few], shown, **THIN)
    top.set_xlabel("time (s)")
    left.plot(trace.velocity[few], shown, color=BLUE, markersize=2.0, alpha=0.5, **DOTS)
    left.set_xlabel(f"velocity ({unit_on(motion, 'rad/s')})")
    kept = error[used]
    right.hist(kept, bins=60, color=BLUE)
    right.set(xlabel=label, ylabel="samples (1)")
    for axis in (left, right):
        axis.xaxis.set_major_locator(MaxNLocator(5))
    for axis in (top, left):
        if kept.size:
            rms_band(axis, kept, unit)
            legend_above(axis, 1)
        axis.axhline(0.0, **ZERO)
        axis.set_ylabel(label)
    word = torque_word(motion)
    made.suptitle(f"{trace.recording}: {word} residual ({trace.role}, {trace.stage})", fontsize=11)
    return made


def predicted(part: Predicted, unit: str, band: Simulation | None = None) -> Figure:
    """Draw the measured side, the predicted side and the residual of one equation against time.

    Args:
        part: One equation of one recording.
        unit: Unit of the equation.
        band: The same prediction with its 90 % band, which is drawn if given.
    """
    made, (top, bottom) = figure(2, height=5.0, sharex=True)
    few = thinned(len(part.time))
    if band is not None:
        ends = (band.low["torque"][few], band.high["torque"][few])
        top.fill_between(
            band.time[few], *ends, label="90 % band", color=VERMILION, alpha=0.22, linewidth=0
        )
    time = part.time[few]
    measured, model = (broken(side[few], continuing(time)) for side in (part.measured, part.model))
    top.plot(time, measured, label="measured, where it moves", **MEASURED)
    top.plot(time, model, label="model", **MODEL)
    top.set_ylabel(f"{part.equation} ({unit})")
    bottom.plot(time, measured - model, **THIN)
    if part.error.size:
        rms_band(bottom, part.error, unit)
    bottom.axhline(0.0, **ZERO)
    bottom.set(ylabel=f"measured - model ({unit})", xlabel="time (s)")
    for axis in (top, bottom):
        legend_above(axis, 3)
    return made


def simulated(prepared: Prepared, response: Response) -> Figure:
    """Draw angle, angle error and drive torque against time, measured and simulated."""
    recording = prepared.recording
    scale, label = _angle(recording.bench.motion)
    made, (top, middle, bottom) = figure(3, height=7.0, sharex=True)
    few = thinned(len(recording.time))
    time = recording.time[few]
    measured = joint_angle(recording)
    rotary = recording.bench.motion == "rotary"
    if measured is not None:
        top.plot(time, measured[few] * scale, label="measured", **MEASURED)
        error = (response.angle - measured)[few] * (1e3 if rotary else 1e6)
        middle.plot(time, error, **ZERO)
    top.plot(time, response.angle[few] * scale, label="simulated", **MODEL)
    top.set_ylabel(label)
    middle.set_ylabel("simulated - measured\n" + ("(mrad)" if rotary else "(um)"))
    few = thinned(len(prepared.time))
    time = prepared.time[few]
    bottom.plot(time, prepared.drive_torque[few], label="measured", **MEASURED)
    bottom.plot(time, simulated_torque(prepared, response)[few], label="simulated", **MODEL)
    bottom.set_ylabel(f"{torque_word(recording.bench.motion)} ({torque_unit(recording)})")
    bottom.set_xlabel("time (s)")
    for axis in (top, bottom):
        legend_above(axis, 2)
    title = f"{recording.name}: closed loop simulated from its first sample ({recording.role})"
    made.suptitle(title, fontsize=11)
    return made


def _angle(motion: str) -> tuple[float, str]:
    """Return the factor on an angle that is drawn, and the label of its axis."""
    return (np.rad2deg(1.0), "joint angle (deg)") if motion == "rotary" else (1e3, "position (mm)")
