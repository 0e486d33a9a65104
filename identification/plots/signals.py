"""Draws the signals of recordings: measured, fitted, predicted, simulated, and the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from identification.export.model import Predicted
from identification.model.parameters import torque_word, unit_on
from identification.plots.style import (
    BLACK,
    BLUE,
    ORANGE,
    VERMILION,
    broken,
    continuing,
    figure,
    legend_above,
    mosaic,
    moving,
    thinned,
)
from identification.prepare import Prepared, joint_angle, torque_unit
from identification.recording import Recording
from identification.result import Trace
from identification.simulate.closed_loop import Response, simulated_torque


def response(trace: Trace, recording: Recording, unit: str) -> Figure:
    """Draw angle and command, velocity, torque and fitted torque against time.

    Args:
        trace: The recording as fitted.
        recording: The recording itself, for its command.
        unit: Unit of its torque.
    """
    rotary = recording.bench.motion == "rotary"
    scale = np.rad2deg(1.0) if rotary else 1e3
    made, (top, middle, bottom) = figure(3, height=7.0, sharex=True, measured=False)
    few = thinned(len(trace.time))
    time = trace.time[few]
    if "command" in recording.channels:
        asked = thinned(len(recording.time))
        command = recording.channels["command"][asked] * scale
        top.plot(
            recording.time[asked],
            command,
            color=BLACK,
            linestyle="--",
            linewidth=0.9,
            zorder=3,
            label="command",
        )
    top.plot(time, trace.angle[few] * scale, color=BLUE, linewidth=1.6, label="measured")
    top.set_ylabel("joint angle (deg)" if rotary else "position (mm)")
    middle.plot(time, trace.velocity[few], color=BLUE, linewidth=1.0, label="measured")
    middle.set_ylabel(f"velocity ({unit_on(recording.bench.motion, 'rad/s')})")
    bottom.plot(time, trace.torque[few], color=BLUE, linewidth=2.0, alpha=0.55, label="measured")
    bottom.plot(
        time,
        broken(trace.torque_model, moving(trace))[few],
        color=VERMILION,
        linewidth=0.9,
        label="model, where it moves",
    )
    bottom.set_ylabel(f"{torque_word(recording.bench.motion)} ({unit})")
    bottom.set_xlabel("time (s)")
    for axis in (top, middle, bottom):
        legend_above(axis, 2)
    made.suptitle(f"{trace.recording}: response ({trace.role}, {trace.stage})", fontsize=11)
    return made


def residual(trace: Trace, motion: str, unit: str) -> Figure:
    """Draw the residual of the model against time and velocity, and its histogram; moving samples
    only.

    Args:
        trace: The recording as fitted.
        motion: ``rotary`` or ``linear``.
        unit: Unit of its torque.
    """
    made, (top, left, right) = mosaic("AA;BC", height=6.0)
    error = trace.torque - trace.torque_model
    few = thinned(len(error))
    used = moving(trace)
    shown = broken(error, used)[few]
    top.plot(trace.time[few], shown, color=BLUE, linewidth=0.8)
    top.set_xlabel("time (s)")
    left.plot(trace.velocity[few], shown, ".", color=BLUE, markersize=2.0, alpha=0.5)
    left.set_xlabel(f"velocity ({unit_on(motion, 'rad/s')})")
    kept = error[used]
    right.hist(kept, bins=60, color=BLUE)
    right.set_xlabel(f"measured - model ({unit})")
    right.set_ylabel("samples (1)")
    for axis in (left, right):
        axis.xaxis.set_major_locator(MaxNLocator(5))
    if kept.size:
        rms = float(np.sqrt(np.mean(kept**2)))
        for axis in (top, left):
            axis.axhspan(
                -rms, rms, color=ORANGE, alpha=0.25, linewidth=0, label=f"rms {rms:.3g} {unit}"
            )
            legend_above(axis, 1)
    for axis in (top, left):
        axis.axhline(0.0, color=BLACK, linewidth=0.8)
        axis.set_ylabel(f"measured - model ({unit})")
    word = torque_word(motion)
    made.suptitle(f"{trace.recording}: {word} residual ({trace.role}, {trace.stage})", fontsize=11)
    return made


def predicted(part: Predicted, unit: str) -> Figure:
    """Draw the measured side, the predicted side and the residual of one equation against time.

    Args:
        part: One equation of one recording.
        unit: Unit of the equation.
    """
    made, (top, bottom) = figure(2, height=5.0, sharex=True)
    few = thinned(len(part.time))
    time = part.time[few]
    joined = continuing(time)
    measured, model = (broken(side[few], joined) for side in (part.measured, part.model))
    top.plot(
        time, measured, color=BLUE, linewidth=2.0, alpha=0.55, label="measured, where it moves"
    )
    top.plot(time, model, color=VERMILION, linewidth=0.9, label="model")
    top.set_ylabel(f"{part.equation} ({unit})")
    bottom.plot(time, measured - model, color=BLUE, linewidth=0.8)
    if part.error.size:
        level = float(np.sqrt(np.mean(part.error**2)))
        bottom.axhspan(
            -level, level, color=ORANGE, alpha=0.25, linewidth=0, label=f"rms {level:.3g} {unit}"
        )
    bottom.axhline(0.0, color=BLACK, linewidth=0.8)
    bottom.set_ylabel(f"measured - model ({unit})")
    bottom.set_xlabel("time (s)")
    for axis in (top, bottom):
        legend_above(axis, 2)
    return made


def simulated(prepared: Prepared, response: Response) -> Figure:
    """Draw angle, angle error and drive torque against time, measured and simulated."""
    recording = prepared.recording
    rotary = recording.bench.motion == "rotary"
    large, small = (np.rad2deg(1.0), 1e3) if rotary else (1e3, 1e6)
    made, (top, middle, bottom) = figure(3, height=7.0, sharex=True)
    few = thinned(len(recording.time))
    time = recording.time[few]
    measured = joint_angle(recording)
    if measured is not None:
        top.plot(
            time, measured[few] * large, color=BLUE, linewidth=2.0, alpha=0.55, label="measured"
        )
        middle.plot(time, (response.angle - measured)[few] * small, color=BLACK, linewidth=0.8)
    top.plot(time, response.angle[few] * large, color=VERMILION, linewidth=0.9, label="simulated")
    top.set_ylabel("joint angle (deg)" if rotary else "position (mm)")
    middle.set_ylabel("simulated - measured\n" + ("(mrad)" if rotary else "(um)"))
    few = thinned(len(prepared.time))
    bottom.plot(
        prepared.time[few],
        prepared.drive_torque[few],
        color=BLUE,
        linewidth=2.0,
        alpha=0.55,
        label="measured",
    )
    torque = simulated_torque(prepared, response)
    bottom.plot(prepared.time[few], torque[few], color=VERMILION, linewidth=0.9, label="simulated")
    bottom.set_ylabel(f"{torque_word(recording.bench.motion)} ({torque_unit(recording)})")
    bottom.set_xlabel("time (s)")
    for axis in (top, bottom):
        legend_above(axis, 2)
    made.suptitle(
        f"{recording.name}: closed loop simulated from its first sample ({recording.role})",
        fontsize=11,
    )
    return made
