"""Integrates the position loop: a continuous P-D controller with limited output around a joint with
Stribeck friction and stiction.

J domega/dt = tau - F(omega), with the friction F of eq. 9 and 13. The speed follows the trapezoidal
rule, implicit in friction and solved by Newton's method; the controller uses the angle in the
middle of the step. A joint whose speed would change sign stops, and stays at rest while the torque
on the joint is within the static limit.
"""

from __future__ import annotations

import math

from identification.model.friction import friction
from identification.model.parameters import GEAR_DRIVE, INERTIA, OFFSET, STEADY, WEIGHT, ZERO
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

# Loop: output = clip(position_gain (command - angle) - velocity_gain speed, limit), times the
# signal `scale`, plus `added`; torque = per_output output - damping speed.
POSITION_GAIN, VELOCITY_GAIN, LIMIT, PER_OUTPUT, DAMPING = range(5)

_ITERATIONS = 20
_EXACT = 1e-12


@compiled
def next_speed(
    speed: float, torque: float, moment: float, gear: float, damping: float, h: float, body: Array
) -> float:
    """Return the speed after ``h`` seconds under ``torque``, N m, which excludes friction and
    damping.
    """
    inertia = body[INERTIA]
    side = 1.0 if speed > 0.0 else -1.0
    if speed == 0.0:
        side = 1.0 if torque > 0.0 else -1.0
        if abs(torque) <= friction(0.0, moment, gear, body)[0]:
            return 0.0
    start = abs(speed)
    before = friction(start, moment, gear, body)[0] + damping * start
    # g(v) = J/h (v - start) - side torque + (F(start) + F(v))/2 has a root above 0 unless the joint
    # stops.
    rest = inertia / h * start + side * torque - 0.5 * before
    if rest <= 0.5 * friction(0.0, moment, gear, body)[0]:
        return 0.0
    v = start
    for _ in range(_ITERATIONS):
        force, slope = friction(v, moment, gear, body)
        grade = max(inertia / h + 0.5 * (slope + damping), 0.25 * inertia / h)
        change = (rest - inertia / h * v - 0.5 * (force + damping * v)) / grade
        v = max(v + change, 0.0)
        if abs(change) <= _EXACT * (1.0 + v):
            break
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
