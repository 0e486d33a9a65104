"""Simulates a fitted model in the position loop of its recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.contact_force import contact_moment
from identification.model.parameters import INERTIA, STEADY, WEIGHT, ZERO, pack
from identification.numerics.arrays import Array
from identification.prepare import joint_angle
from identification.recording import Controller, Recording, RecordingError
from identification.simulate import closed_loop_kernel as kernel

STEP_S = 2.5e-4
"""Greatest integration step; the integration error is far below the noise of recordings.
"""

OPEN_LOOP = np.array([0.0, 0.0, math.inf, 1.0, 0.0])
"""No controller: ``Inputs.added`` is the torque that drives the joint, N m."""


@dataclass(frozen=True)
class Response:
    """A simulated response, shape (n,), SI, at the joint.

    Attributes:
        time: s.
        angle: rad.
        velocity: rad/s.
        torque: Torque of the drive, N m.
    """

    time: Array
    angle: Array
    velocity: Array
    torque: Array


@dataclass(frozen=True)
class Inputs:
    """Inputs of the loop, shape (n,).

    Attributes:
        time: s, increasing.
        command: rad.
        scale: Factor on the controller's output: the supply voltage if the output is a duty cycle,
            else 1.
        added: Signal added to the scaled output, in the output's unit.
        moment: F_P L1, N m.
    """

    time: Array
    command: Array
    scale: Array
    added: Array
    moment: Array


def body_of(values: Mapping[str, float], recording: Recording, alpha: float) -> Array:
    """Return the parameter vector (:mod:`identification.model.parameters`) of the joint with the
    recording's known loads.

    Raises:
        RecordingError: The inertia is zero.
    """
    body = pack(values, alpha)
    body[INERTIA] += recording.known_inertia
    body[STEADY] = recording.steady_torque
    if recording.pendulum is not None:
        pendulum = recording.pendulum
        body[WEIGHT] = pendulum.mass * recording.bench.gravity * pendulum.length
        body[ZERO] = pendulum.zero
    if not body[INERTIA] > 0.0:
        raise RecordingError(
            f"{recording.name}: a joint with an inertia of {body[INERTIA]:g} cannot be simulated; "
            "state J under model.fixed"
        )
    return body


def loop_of(controller: Controller, recording: Recording) -> Array:
    """Return the kernel's parameters of controller and drive, shape (5,).

    An output of kind ``duty`` or ``voltage`` sets the armature voltage U: torque = Km i (U - Ke i
    omega)/R, with the inductance neglected.

    Raises:
        RecordingError: A constant of the motor is missing.
    """
    per_output, damping = 1.0, 0.0
    if controller.output != "torque":
        bench = recording.bench
        if (
            bench.resistance is None
            or bench.back_emf_constant is None
            or bench.torque_constant is None
        ):
            raise RecordingError(
                f"{recording.name}: a controller with output {controller.output!r} needs "
                f"bench.resistance, "
                "bench.back_emf_constant and bench.torque_constant"
            )
        per_output = bench.ampere_torque / bench.resistance
        damping = per_output * bench.back_emf_constant * bench.gear_ratio
    limit = math.inf if controller.limit is None else controller.limit
    return np.array(
        [controller.position_gain, controller.velocity_gain, limit, per_output, damping]
    )


def inputs_of(recording: Recording) -> Inputs:
    """Return the inputs of the loop, from a recording.

    Raises:
        RecordingError: The recording has no controller or no command, or the output of its
            controller is a duty cycle and no supply voltage was recorded.
    """
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
    angle = joint_angle(recording)
    return Inputs(
        time=recording.time,
        command=channels["command"],
        scale=scale,
        added=channels.get("feedforward", np.zeros(n)),
        moment=contact_moment(recording, recording.time, np.zeros(n) if angle is None else angle),
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
    time, command, scale, added, moment = (
        np.ascontiguousarray(column)
        for column in (inputs.time, inputs.command, inputs.scale, inputs.added, inputs.moment)
    )
    kernel.closed_loop(
        time, command, scale, added, moment, body, loop, step, angles, speeds, torques
    )
    return Response(inputs.time, angles, speeds, torques)


def replay(
    recording: Recording, values: Mapping[str, float], alpha: float, step: float = STEP_S
) -> Response:
    """Simulate a recording with the fitted ``values`` and the command of the recording, from rest
    at the first recorded angle.

    After the first sample only the command, the supply voltage and the declared loads are used.

    Raises:
        RecordingError: A channel, a constant or the controller that the simulation needs is
            missing.
    """
    inputs = inputs_of(recording)
    assert recording.controller is not None  # otherwise `inputs_of` raises
    measured = joint_angle(recording)
    if measured is None:
        raise RecordingError(
            f"{recording.name}: the recording has no angle channel, and a simulation starts from "
            "the measured angle; add a channel `angle` or `motor_angle`"
        )
    loop = loop_of(recording.controller, recording)
    return simulate(body_of(values, recording, alpha), loop, inputs, float(measured[0]), 0.0, step)
