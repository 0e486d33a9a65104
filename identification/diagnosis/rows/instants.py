"""Describes what samples at instants leave unknown about the mean of voltage and current over a
sample period, to which the voltage equation applies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from identification.recording import Array
from identification.signals import central_difference, resample
from identification.views.view import View


def voltage_change(view: View) -> Array:
    """Return the change of the voltage over one sample period, V, shape (n,); zero for an averaged
    channel.

    A drive holds its voltage for one cycle, which may be before or after the time stamp. Unless the
    channel is declared as averaged, start and duration of this cycle are unknown; therefore the
    delay of the voltage is a parameter of the voltage equation.
    """
    assert view.voltage is not None
    if "voltage" in view.recording.averaged:
        return np.zeros(len(view.time))
    return central_difference(np.where(np.isnan(view.voltage), 0.0, view.voltage), 1.0)


def command_ripple(view: View) -> Array:
    """Return the acceleration of the command, rad/s^2 or m/s^2, shape (n,); zero without a command,
    or if voltage and current are averaged.

    A loop that receives a command at intervals changes the current in steps. With feed-forward the
    steps are in proportion to the acceleration of the command. If log and loop are synchronised,
    all samples are taken at one phase of the steps, so that their difference from the mean over a
    sample period is in proportion to this acceleration.
    """
    recording = view.recording
    command = recording.channels.get("command")
    if command is None or {"voltage", "current"} <= recording.averaged:
        return np.zeros(len(view.time))
    speed = central_difference(resample(recording.time, command, view.time), view.step)
    return central_difference(speed, view.step)


INSTANTS: Mapping[str, Callable[[View], Array]] = {
    "hold": voltage_change,
    "ripple": command_ripple,
}
"""Parameters that samples at instants add to the voltage equation, each with the function that
computes its column.
"""


def between_samples(views: Sequence[View]) -> float:
    """Return the error of the voltage equation, V, that voltages and currents between the samples
    may cause; 0 for averaged channels.

    A control loop that is faster than the log changes voltage and current between two samples. If
    log and loop are synchronised, every sample is taken at one phase of the loop's cycle, so that
    the error depends on the motion and no filter averages it. This error is not white noise, but
    the deviation of an instant within a sample period times the rate of change of the voltage, or
    of the voltage across the resistance.

    Args:
        views: Recordings with voltage and current.
    """
    voltages = [v.voltage for v in views if "voltage" not in v.recording.averaged]
    drops = [
        v.current * (v.recording.bench.resistance or 0.0)
        for v in views
        if v.current is not None and "current" not in v.recording.averaged
    ]
    return math.hypot(_instant(voltages), _instant(drops))


def _instant(channels: Sequence[Array | None]) -> float:
    """Return the rms error of using samples in place of means over their periods, from the changes
    between the samples.
    """
    changes = [np.diff(c[np.isfinite(c)]) for c in channels if c is not None]
    every = np.concatenate([np.zeros(1), *changes])
    return float(np.sqrt(np.mean(every**2) / 12.0))
