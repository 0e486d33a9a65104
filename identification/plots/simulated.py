"""Draws the figures of a simulated response and its recording."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from identification.model.units import torque_word
from identification.plots.style import BLACK, BLUE, VERMILION, figure, legend_above, thinned
from identification.prepare import Prepared, joint_angle, torque_unit
from identification.simulate.closed_loop import Response
from identification.simulate.score import simulated_torque


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
