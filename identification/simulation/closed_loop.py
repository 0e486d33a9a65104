"""Simulates a fitted model in the recording's position loop, or driven by the recorded torque."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.model.friction import friction
from identification.model.parameters import GEAR_DRIVE, INERTIA, OFFSET, STEADY, WEIGHT, ZERO, pack
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled
from identification.prepare import (
    POSITION_BANDWIDTH,
    Prepared,
    contact_moment,
    joint_angle,
    uniform_grid,
)
from identification.recording import Bench, Controller, Recording, RecordingError
from identification.signals import resample, smooth

# Loop: output = clip(position_gain (command - angle) - velocity_gain speed, limit), times the
# signal `scale`, plus `added`; torque = per_output output - damping speed.
POSITION_GAIN, VELOCITY_GAIN, LIMIT, PER_OUTPUT, DAMPING = range(5)

_ITERATIONS = 20
_EXACT = 1e-12


@compiled
def next_speed(
    speed: float, torque: float, moment: float, gear: float, damping: float, h: float, body: Array
) -> float:
    """Return the speed after ``h`` s under ``torque``, N m, less friction and damping."""
    inertia = body[INERTIA]
    side = 1.0 if speed > 0.0 else -1.0
    static = friction(0.0, moment, gear, body)[0]
    if speed == 0.0:
        side = 1.0 if torque > 0.0 else -1.0
        if abs(torque) <= static:
            return 0.0
    start = abs(speed)
    force, slope = friction(start, moment, gear, body)
    before = force + damping * start
    # g(v) = J/h (v - start) - side torque + (F(start) + F(v))/2 has a root above 0 unless the joint
    # stops.
    rest = inertia / h * start + side * torque - 0.5 * before
    if rest <= 0.5 * static:
        return 0.0
    v = start
    for _ in range(_ITERATIONS):
        grade = max(inertia / h + 0.5 * (slope + damping), 0.25 * inertia / h)
        change = (rest - inertia / h * v - 0.5 * (force + damping * v)) / grade
        v = max(v + change, 0.0)
        if abs(change) <= _EXACT * (1.0 + v):
            break
        force, slope = friction(v, moment, gear, body)
    return side * v


@compiled
def closed_loop(
    time: Array,
    command: Array,
    scale: Array,
    added: Array,
    moment: Array,
    body: Array,
    loop: Array,
    step: float,
    angle: Array,
    speed: Array,
    torque: Array,
) -> None:
    """Fill ``angle``, ``speed`` and the drive's ``torque`` at ``time``; the first samples of angle
    and speed are the initial state.

    Args:
        time: s, shape (n,), increasing, not necessarily evenly.
        command: rad, shape (n,); linear between samples.
        scale: Factor on the controller's output, shape (n,): supply voltage, or 1; held between
            samples.
        added: Signal added to the scaled output, shape (n,); held between samples.
        moment: F_P L1, N m, shape (n,); held between samples.
        body: Vector of :mod:`identification.model.parameters`; its inertia includes that of the
            loads.
        loop: Parameters of controller and drive, shape (5,).
        step: Greatest integration step, s.
        angle: rad, shape (n,).
        speed: rad/s, shape (n,).
        torque: N m, shape (n,).
    """
    q, w = angle[0], speed[0]
    for k in range(len(time)):
        span = time[k + 1] - time[k] if k + 1 < len(time) else step
        count = max(math.ceil(span / step - 1e-9), 1)
        h = span / count
        for j in range(count):
            share = (j + 0.5) / count
            wanted = command[k]
            if k + 1 < len(time):
                wanted += share * (command[k + 1] - command[k])
            middle = q + 0.5 * h * w
            output = loop[POSITION_GAIN] * (wanted - middle) - loop[VELOCITY_GAIN] * w
            output = min(max(output, -loop[LIMIT]), loop[LIMIT]) * scale[k] + added[k]
            drive = loop[PER_OUTPUT] * output
            if j == 0:
                torque[k] = drive - loop[DAMPING] * w
                if k + 1 == len(time):
                    return
            hanging = body[STEADY] - body[WEIGHT] * math.sin(middle - body[ZERO])
            gear = abs(hanging - body[GEAR_DRIVE] * (drive - loop[DAMPING] * w))
            w_next = next_speed(
                w, drive + hanging - body[OFFSET], moment[k], gear, loop[DAMPING], h, body
            )
            q += 0.5 * h * (w + w_next)
            w = w_next
        angle[k + 1] = q
        speed[k + 1] = w


STEP_S = 2.5e-4
"""Greatest integration step; the integration error is far below the noise of recordings.
"""

OPEN_LOOP = np.array([0.0, 0.0, math.inf, 1.0, 0.0])
"""No controller: ``Inputs.added`` is the torque that drives the joint, N m."""


@dataclass(frozen=True)
class Response:
    """A simulated response, shape (n,), SI, at the joint."""

    time: Array  # s
    angle: Array  # rad
    velocity: Array  # rad/s
    torque: Array  # torque of the drive, N m


@dataclass(frozen=True)
class Inputs:
    """Inputs of the loop, shape (n,)."""

    time: Array  # s, increasing
    command: Array  # rad
    # Factor on the controller's output: the supply voltage if the output is a duty cycle, else 1.
    scale: Array
    added: Array  # signal added to the scaled output, in the output's unit
    moment: Array  # F_P L1, N m


def body_of(values: Mapping[str, float], recording: Recording, alpha: float) -> Array:
    """Return the parameter vector of the joint with the recording's known loads."""
    body = pack(values, alpha)
    body[INERTIA] += recording.known_inertia
    body[STEADY] = recording.steady_torque
    if recording.pendulum is not None:
        body[WEIGHT] = recording.pendulum.moment(recording.bench.gravity)
        body[ZERO] = recording.pendulum.zero
    if not body[INERTIA] > 0.0:
        raise RecordingError(
            f"{recording.name}: a joint with an inertia of {body[INERTIA]:g} cannot be simulated; "
            "state J under model.fixed"
        )
    return body


def loop_of(controller: Controller, bench: Bench, name: str) -> Array:
    """Return the kernel's parameters of controller and drive, shape (5,); ``name`` is that of the
    recording, for messages.

    An output of kind ``duty`` or ``voltage`` sets the armature voltage U: torque = Km i (U - Ke i
    omega)/R, with the inductance neglected.
    """
    per_output, damping = 1.0, 0.0
    if controller.output != "torque":
        if (
            bench.resistance is None
            or bench.back_emf_constant is None
            or bench.torque_constant is None
        ):
            raise RecordingError(
                f"{name}: a controller with output {controller.output!r} needs "
                f"bench.resistance, "
                "bench.back_emf_constant and bench.torque_constant"
            )
        per_output = bench.ampere_torque / bench.resistance
        damping = per_output * bench.back_emf_constant * bench.gear_ratio
    limit = math.inf if controller.limit is None else controller.limit
    return np.array(
        [controller.position_gain, controller.velocity_gain, limit, per_output, damping]
    )


def moment_of(recording: Recording) -> Array:
    """Return the contact moment at the recorded angle, or without one at 0, N m, shape (n,)."""
    angle = joint_angle(recording)
    place = np.zeros(len(recording.time)) if angle is None else angle
    return contact_moment(recording, recording.time, place)


def inputs_of(recording: Recording) -> Inputs:
    """Return the inputs of the loop, from a recording."""
    controller, channels = recording.controller, recording.channels
    if controller is None or "command" not in channels:
        raise RecordingError(
            f"{recording.name}: a simulation needs a `command` channel and the `controller` that "
            "follows the command"
        )
    n = len(recording.time)
    scale = np.ones(n)
    if controller.output == "duty":
        if "supply_voltage" not in channels:
            raise RecordingError(
                f"{recording.name}: a controller with output 'duty' needs a `supply_voltage` "
                f"channel"
            )
        scale = channels["supply_voltage"]
        known = np.isfinite(scale)
        if not np.any(known):
            raise RecordingError(f"{recording.name}: `supply_voltage` has no value")
        scale = np.interp(recording.time, recording.time[known], scale[known])
    return Inputs(
        time=recording.time,
        command=channels["command"],
        scale=scale,
        added=scale * channels.get("feedforward", np.zeros(n)),
        moment=moment_of(recording),
    )


def simulate(
    body: Array, loop: Array, inputs: Inputs, angle: float, velocity: float, step: float = STEP_S
) -> Response:
    """Simulate a position loop around a joint with set-valued friction, from an initial state.

    Args:
        body: Parameters of the joint, from :func:`body_of`.
        loop: Parameters of the loop, from :func:`loop_of`, or :data:`OPEN_LOOP`.
        inputs: Inputs of the loop.
        angle: Angle at the first time stamp, rad.
        velocity: Velocity at the first time stamp, rad/s.
        step: Greatest integration step, s.
    """
    n = len(inputs.time)
    angles, speeds, torques = np.zeros(n), np.zeros(n), np.zeros(n)
    angles[0], speeds[0] = angle, velocity
    time, command, scale, added, moment = map(np.ascontiguousarray, vars(inputs).values())
    closed_loop(time, command, scale, added, moment, body, loop, step, angles, speeds, torques)
    return Response(inputs.time, angles, speeds, torques)


def driven_inputs(recording: Recording) -> Inputs:
    """Return the inputs without a controller: the recorded torque, or that of the recorded current,
    drives the joint.

    Raises:
        RecordingError: The recording has neither torque nor current.
    """
    name = next((c for c in ("torque", "current") if c in recording.channels), None)
    if name is None:
        raise RecordingError(
            f"{recording.name}: a simulation needs a `command` channel with the `controller` that "
            "follows it, or a `torque` or `current` channel"
        )
    drive = recording.channels[name] * (recording.bench.ampere_torque if name == "current" else 1)
    if name in recording.averaged:
        drive = np.append(drive[1:], drive[-1:])  # the mean over the period that ends at a sample
    n = len(recording.time)
    return Inputs(recording.time, np.zeros(n), np.ones(n), drive, moment_of(recording))


def replay(
    recording: Recording,
    values: Mapping[str, float],
    alpha: float,
    step: float = STEP_S,
    *,
    driven: bool = False,
    disturbance: Array | float = 0.0,
) -> Response:
    """Simulate a recording with the fitted ``values``, from rest at its first angle, or without an
    angle at its first command; driven without a command, at 0.

    After the first sample only the command, the supply voltage and the declared loads are used, or
    if ``driven`` the recorded torque. ``disturbance`` is a further torque on the joint, N m, shape
    (n,), which is not in the drive's torque.

    Raises:
        RecordingError: A channel, a constant or the controller that the simulation needs is
            missing.
    """
    inputs, loop = (driven_inputs if driven else inputs_of)(recording), OPEN_LOOP
    if not driven and recording.controller is not None:
        loop = loop_of(recording.controller, recording.bench, recording.name)
    measured = joint_angle(recording)
    start = float((inputs.command if measured is None else measured)[0])
    fed = replace(inputs, added=inputs.added + disturbance / loop[PER_OUTPUT])
    found = simulate(body_of(values, recording, alpha), loop, fed, start, 0.0, step)
    return replace(found, torque=found.torque - disturbance)


@dataclass(frozen=True)
class Sums:
    """Sums of squares over all samples, also at rest, from which rms errors are computed."""

    # Sum of squares of simulated less measured drive torque at the bandwidth.
    torque_error: float = 0.0
    torque: float = 0.0  # sum of squares of the measured drive torque at the bandwidth
    torque_samples: int = 0  # number of torque samples
    # Sum of squares of simulated less measured angle at the recording's time stamps.
    angle_error: float = 0.0
    angle_samples: int = 0  # number of angle samples
    # Sum of absolute errors of the angle at the recording's time stamps.
    angle_absolute: float = 0.0

    @property
    def torque_rms(self) -> float:
        """Rms torque error, N m (N)."""
        return math.sqrt(self.torque_error / max(self.torque_samples, 1))

    @property
    def torque_relative(self) -> float:
        """Norm of the torque error over the norm of the torque."""
        return math.sqrt(self.torque_error / self.torque) if self.torque > 0.0 else 0.0

    @property
    def angle_rms(self) -> float:
        """Rms angle error, rad (m)."""
        return math.sqrt(self.angle_error / max(self.angle_samples, 1))

    @property
    def angle_mae(self) -> float:
        """Mean absolute angle error, rad (m)."""
        return self.angle_absolute / max(self.angle_samples, 1)


def pooled(parts: Iterable[Sums]) -> Sums:
    """Return the sums over several recordings."""
    total = vars(Sums())
    for part in parts:
        total = {name: value + vars(part)[name] for name, value in total.items()}
    return Sums(**total)


def compare(prepared: Prepared, response: Response) -> Sums:
    """Return the sums of squared errors of a simulated response against its recording.

    Simulated and measured torque are filtered to the same bandwidth before they are compared.
    """
    error = simulated_torque(prepared, response) - prepared.drive_torque
    return replace(
        compare_angle(prepared.recording, response),
        torque_error=float(error @ error),
        torque=float(prepared.drive_torque @ prepared.drive_torque),
        torque_samples=len(error),
    )


def compare_angle(recording: Recording, response: Response) -> Sums:
    """Return the sums of the angle alone of a simulated response against its recording."""
    angle = joint_angle(recording)
    if angle is None:
        raise RecordingError(
            f"{recording.name}: the recording has no angle channel, "
            "with which the simulated angle is compared; add a channel `angle` or `motor_angle`"
        )
    off = response.angle - angle
    return Sums(
        angle_error=float(off @ off),
        angle_samples=len(off),
        angle_absolute=float(np.sum(np.abs(off))),
    )


def simulated_torque(prepared: Prepared, response: Response) -> Array:
    """Return the simulated drive torque after the filter of the fit, N m, at ``prepared.time``."""
    recording = prepared.recording
    series = resample(recording.time, response.torque, uniform_grid(recording))
    if prepared.filter.half:
        series = smooth(series, 1.0 / recording.period, POSITION_BANDWIDTH * prepared.bandwidth_Hz)
    return np.asarray(prepared.filter(series))
