"""Draws frequency responses: Bode, Nyquist, and the step that gains are expected to give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from identification.numerics.arrays import Array
from identification.plots.style import (
    BLACK,
    CYCLE,
    GREY,
    MODEL,
    ZERO,
    figure,
    legend_above,
    plain_numbers,
)
from identification.simulation.frequency_response import Complex, OpenLoop


class Curve(NamedTuple):
    """A response over its lines; ``measured`` as points on a line, else as a thin line."""

    name: str
    frequency_Hz: Array
    response: Complex
    measured: bool = True


def bode(curves: Sequence[Curve], unit: str) -> Figure:
    """Draw gain, dB over the unit, and phase, deg, against frequency."""
    made, (top, bottom) = figure(2, height=5.5, sharex=True)
    for number, curve in enumerate(curves):
        style = _style(number, curve.measured)
        gain = 20.0 * np.log10(np.abs(curve.response))
        phase = np.degrees(np.unwrap(np.angle(curve.response)))
        phase -= 360.0 * np.round((phase[0] + 90.0) / 360.0)
        top.plot(curve.frequency_Hz, gain, label=curve.name, **style)
        bottom.plot(curve.frequency_Hz, phase, **style)
    if not unit:
        top.axhline(0.0, **ZERO)
    bottom.axhline(-180.0, **ZERO)
    top.set_ylabel(f"gain (dB{unit})")
    bottom.set(ylabel="phase (deg)", xlabel="frequency (Hz)")
    for axis in (top, bottom):
        axis.set_xscale("log")
        plain_numbers(axis.xaxis, (1.0, 2.0, 5.0))
    legend_above(top, 3)
    return made


def nyquist(loops: Mapping[str, OpenLoop]) -> Figure:
    """Draw open loops in the complex plane around the critical point -1."""
    made, (axis,) = figure(1, width=5.5, height=5.5)
    for number, (name, loop) in enumerate(loops.items()):
        style = _style(number, True)
        axis.plot(loop.response.real, loop.response.imag, label=name, **style)
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 200))
    axis.plot(turn.real, turn.imag, color=GREY, linewidth=0.8, label="gain 1")
    axis.plot([-1.0], [0.0], color=BLACK, marker="x", markersize=9.0)
    axis.set_xlim(-2.5, 1.5)
    axis.set_ylim(-2.5, 1.5)
    axis.set_aspect("equal")
    axis.set(xlabel="real part (1)", ylabel="imaginary part (1)")
    legend_above(axis, 3)
    return made


def steps(time: Array, responses: Mapping[str, Array]) -> Figure:
    """Draw unit steps of closed position loops against time, s."""
    made, (axis,) = figure(1, height=3.2)
    for number, (name, values) in enumerate(responses.items()):
        axis.plot(time, values, label=name, **_style(number, False))
    axis.axhline(1.0, **ZERO)
    axis.set(xlabel="time (s)", ylabel="angle over step (1)")
    legend_above(axis, 3)
    return made


def _style(number: int, measured: bool) -> dict[str, Any]:
    colour = CYCLE[number % len(CYCLE)]
    if measured:
        return {"color": colour, "marker": ".", "linewidth": 1.0}
    return {**MODEL, "color": colour}
