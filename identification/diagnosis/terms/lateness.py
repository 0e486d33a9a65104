"""Delayed samples in recordings whose voltage was not measured, but computed from the samples by
the control law.

A voltage that is computed by the control law, U = U_s clip(kp (command - angle)), contains the
recorded angle, so that it has the delay of the angle and needs no shift. But the command in this
voltage is not delayed: for an angle delayed by tau, the motor's voltage was U_s clip(kp (command(t
- tau) - angle)), and the error of the recorded voltage is about U_s kp tau dcommand/dt. A shift of
the whole voltage would correct this voltage only by tau times the rate of the tracking error, which
is several times less than the rate of the command.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.memory import delayed_series
from identification.prepare import drive_torque
from identification.recording import Array, Recording

AS_COMPUTED = 1e-3
"""Greatest difference of a recorded voltage from the voltage of the control law, relative to the
greatest voltage, at which the recorded voltage counts as computed.
"""
NEEDED = ("command", "angle", "voltage", "supply_voltage")
MEASURED = ("torque", "current")


def voltage_is_computed(recording: Recording) -> bool:
    """Whether the torque of a recording is computed from a voltage that was itself computed from
    the samples by the control law.
    """
    channels, loop = recording.channels, recording.controller
    if (
        loop is None
        or loop.output != "duty"
        or loop.velocity_gain
        or any(name in channels for name in MEASURED)
    ):
        return False
    if not all(name in channels for name in NEEDED):
        return False
    volts = channels["voltage"]
    known = np.isfinite(volts)
    if not known.any():
        return False
    greatest = float(np.max(np.abs(volts[known])))
    return float(np.max(np.abs(volts - _law(recording, 0.0))[known])) <= AS_COMPUTED * greatest


def command_delay_error(view: View, late_s: float) -> Array:
    """Return the error of the torque because the command in its voltage is not delayed like the
    angle, N m, shape (m,).
    """
    recording = view.recording
    volts = np.where(np.isfinite(recording.channels["voltage"]), _law(recording, late_s), np.nan)
    together = replace(recording, channels={**recording.channels, "voltage": volts})
    here, there = (drive_torque(r, view.time, view.velocity) for r in (recording, together))
    return np.asarray(here - there)


def delayed_view(view: View, late_s: float) -> View:
    """Return a view whose motion is delayed like the samples of the torque, for effects that depend
    on the angle.

    The view is not delayed if the torque is computed from a computed voltage. The last result is
    cached, because most trial parameters use one delay.
    """
    known = view.behind.get(late_s)
    if known is None:
        known = view if voltage_is_computed(view.recording) else _moved(view, late_s)
        view.behind.clear()
        view.behind[late_s] = known
    return known


def _moved(view: View, late_s: float) -> View:
    def late(series: Array) -> Array:
        return delayed_series(series, view.step, late_s)

    return replace(
        view,
        angle=late(view.angle),
        velocity=late(view.velocity),
        acceleration=late(view.acceleration),
        known=late(view.known),
        hanging=late(view.hanging),
        moment=late(view.moment),
        sense=np.clip(late(view.sense), -1.0, 1.0),
        motor=late(view.motor),
        motor_speed=late(view.motor_speed),
    )


def _law(recording: Recording, late_s: float) -> Array:
    """Return the voltage of the control law for a command delayed by ``late_s``, V, shape (m,)."""
    channels, loop = recording.channels, recording.controller
    assert loop is not None
    command = np.interp(recording.time - late_s, recording.time, channels["command"])
    duty = loop.position_gain * (command - channels["angle"])
    if loop.limit is not None:
        duty = np.clip(duty, -loop.limit, loop.limit)
    return np.asarray(channels["supply_voltage"] * duty)
