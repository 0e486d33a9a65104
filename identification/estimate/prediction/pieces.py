"""Divides recordings into pieces, and predicts the angle of each piece from a measured state (M49).

If the controller of the position loop is known, it keeps the simulated angle near the command, and
the whole recording is one piece. With a measured voltage or torque as the only input, the
prediction drifts; therefore a piece then has about the length between two reversals of the motion,
and starts from the measured angle and velocity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from identification.contact_force import contact_moment
from identification.numerics.arrays import Array
from identification.prepare import Prepared, joint_angle, uniform_grid
from identification.recording import Bench, Recording, RecordingError
from identification.simulate.closed_loop import Inputs, body_of, inputs_of, loop_of, simulate

STEP_S = 2e-3
"""Greatest integration step in a search, s; a recording with a shorter sample period has one step
per sample.
"""
LEAST_SAMPLES = 20
"""Least number of samples in a piece."""


@dataclass(frozen=True)
class Motor:
    """Ratios of motor constants to the declared constants.

    Attributes:
        torque_constant: Ratio of Km and of Ke; both are the same constant in SI units.
        resistance: Ratio of R.
    """

    torque_constant: float = 1.0
    resistance: float = 1.0

    def bench(self, declared: Bench) -> Bench:
        """Return the constants of a bench with these motor constants."""
        km, ke, r = declared.torque_constant, declared.back_emf_constant, declared.resistance
        return replace(
            declared,
            torque_constant=None if km is None else km * self.torque_constant,
            back_emf_constant=None if ke is None else ke * self.torque_constant,
            resistance=None if r is None else r * self.resistance,
        )


@dataclass(frozen=True)
class Piece:
    """One prediction of the angle, from a measured initial state.

    Attributes:
        recording: The recording that contains the piece.
        inputs: Inputs of the simulation, shape (n,).
        angle: Measured angle, rad, shape (n,); the first value is the initial state.
        velocity: Initial velocity, rad/s.
        volts: Whether ``inputs.added`` is the motor voltage; has no effect if there is a
            controller.
    """

    recording: Recording
    inputs: Inputs
    angle: Array
    velocity: float
    volts: bool

    def predict(
        self, values: Mapping[str, float], motor: Motor, lateness: float, alpha: float
    ) -> Array:
        """Return the simulated angle, rad, shape (n,).

        Args:
            values: Parameters by name, SI.
            motor: Motor constants.
            lateness: Delay with which a logged command acts, s.
            alpha: Stribeck exponent.
        """
        bench = motor.bench(self.recording.bench)
        inputs = self.inputs
        if lateness:
            command = np.interp(inputs.time - lateness, inputs.time, inputs.command)
            inputs = replace(inputs, command=command)
        loop = self._loop(bench)
        body = body_of(values, self.recording, alpha)
        return simulate(body, loop, inputs, float(self.angle[0]), self.velocity, STEP_S).angle

    def _loop(self, bench: Bench) -> Array:
        controller = self.recording.controller
        if controller is not None and "command" in self.recording.channels:
            return loop_of(controller, replace(self.recording, bench=bench))
        if not self.volts:
            return np.array([0.0, 0.0, math.inf, 1.0, 0.0])
        assert bench.resistance is not None
        assert bench.back_emf_constant is not None
        per_volt = bench.ampere_torque / bench.resistance
        return np.array(
            [0.0, 0.0, math.inf, per_volt, per_volt * bench.back_emf_constant * bench.gear_ratio]
        )


def pieces_of(prepared: Prepared, horizon: float | None = None) -> list[Piece]:
    """Return the pieces of a recording.

    Args:
        prepared: The recording; without a controller its velocity gives the initial states.
        horizon: Length of a piece, s. With None, the piece is the whole recording if the controller
            is known; otherwise the length is :func:`open_horizon`.

    Raises:
        RecordingError: The recording has no angle, or no input for a simulation.
    """
    recording = prepared.recording
    angle = joint_angle(recording)
    if angle is None:
        raise RecordingError(
            f"{recording.name}: the recording has no angle channel, and a prediction starts from "
            "the measured angle; add a channel `angle` or `motor_angle`"
        )
    looped = recording.controller is not None and "command" in recording.channels
    inputs, volts = (inputs_of(recording), False) if looped else _open_inputs(recording)
    if horizon is None:
        horizon = math.inf if looped else open_horizon(prepared)
    speed = np.interp(recording.time, uniform_grid(recording), prepared.raw_velocity)
    ends = _ends(recording.time, horizon)
    pieces = []
    for first, last in pairwise(ends):
        span = slice(first, last)
        part = Inputs(
            inputs.time[span],
            inputs.command[span],
            inputs.scale[span],
            inputs.added[span],
            inputs.moment[span],
        )
        if not np.all(np.isfinite(part.added)):
            continue
        start = 0.0 if looped and first == 0 else float(speed[first])
        pieces.append(Piece(recording, part, angle[span], start, volts))
    return pieces


def open_horizon(prepared: Prepared) -> float:
    """Return the mean time between reversals of the velocity, s. With pieces of this length,
    friction changes its sign about once in a piece.
    """
    moving = prepared.velocity[prepared.used]
    turns = int(np.sum(np.sign(moving[1:]) * np.sign(moving[:-1]) < 0.0))
    time = prepared.recording.time
    return float(time[-1] - time[0]) / (turns + 1)


def _ends(time: Array, horizon: float) -> Sequence[int]:
    """Return the index of the first sample of each piece, followed by the total number of
    samples.
    """
    whole = float(time[-1] - time[0])
    count = 1 if not math.isfinite(horizon) else max(round(whole / horizon), 1)
    count = max(min(count, len(time) // LEAST_SAMPLES), 1)
    edges = time[0] + whole * np.arange(1, count) / count
    return [0, *(int(k) for k in np.searchsorted(time, edges)), len(time)]


def _open_inputs(recording: Recording) -> tuple[Inputs, bool]:
    """Return the measured torque or voltage of the drive as inputs, NaN while the power stage is
    off, and whether the input is a voltage.

    Raises:
        RecordingError: No torque, current or voltage channel.
    """
    channels, bench, time = recording.channels, recording.bench, recording.time
    if "torque" in channels:
        added, volts = channels["torque"], False
    elif "current" in channels:
        added, volts = channels["current"] * bench.ampere_torque, False
    elif "voltage" in channels and bench.resistance is not None:
        added, volts = channels["voltage"], True
        if "enabled" in channels:
            added = np.where(channels["enabled"] < 0.5, np.nan, added)
    else:
        raise RecordingError(
            f"{recording.name}: the recording has no input for a simulation; add a torque, "
            "current or voltage channel, or a `command` channel and the `controller` section"
        )
    angle = joint_angle(recording)
    still, ones = np.zeros(len(time)), np.ones(len(time))
    moment = contact_moment(recording, time, still if angle is None else angle)
    return Inputs(time, still, ones, added, moment), volts
