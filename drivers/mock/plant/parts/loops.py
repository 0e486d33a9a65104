"""State and control loops of the simulated drive, compiled."""

from __future__ import annotations

import math

from drivers.mock.plant.parts.compiled import Vector, inlined

# State vector.
(
    THETA,  # joint angle, rad
    OMEGA,  # joint speed, rad/s
    CURRENT,  # motor current, A
    VELOCITY_INTEGRAL,  # rad/s
    VOLTAGE_INTEGRAL,  # V
    VELOCITY_ESTIMATE,  # joint, rad/s
    MEASURED,  # joint angle that the drive measured last, rad
    TARGET,  # commanded joint angle, rad
    TARGET_STEP,  # rad per loop
    TARGET_LEFT,  # loops until the target is reached
    MODE,  # OFF, TRACK or BRAKE
    BRAKE_STEP,  # change of speed per loop while braking, rad/s
    SUM_CURRENT,  # A s since the last latch
    SUM_VOLTAGE,  # V s since the last latch
    SUM_NOISE,  # A, sum of the sensor noise since the last latch
    SUM_LOOPS,  # loops since the last latch
    FRICTION_WORK,  # J, dissipated since the start
    OFFSET,  # A, added to the current command of the loops
    FLICKER,  # rad at the joint, error of the drive's encoder in the next loop period
    STATE_SIZE,
) = range(20)
OFF, TRACK, BRAKE = 0.0, 1.0, 2.0

# Drive and motor vector.
(
    RESISTANCE,
    INDUCTANCE,
    TORQUE_PER_AMPERE,  # at the joint: Km i
    EMF_PER_SPEED,  # at the joint: Ke i
    LOOP_S,
    STEPS,
    POSITION_GAIN,
    VELOCITY_GAIN,  # 0: position P only
    VELOCITY_INTEGRAL_GAIN,
    VELOCITY_FILTER,  # share of the new difference that the speed filter takes in each loop period
    FEEDFORWARD,
    CURRENT_GAIN,
    CURRENT_INTEGRAL_GAIN,
    VOLTAGE_LIMIT,
    CURRENT_LIMIT,
    COUNT,  # joint angle of one motor count, rad; 0: exact sensor
    NOISE,  # A rms per loop sample
    DRIVE_SIZE,
) = range(18)


@inlined
def current_command(s: Vector, d: Vector) -> float:
    """Return the limited current command of position P and velocity PI controller, A."""
    measured = s[THETA] + s[FLICKER]
    if d[COUNT] > 0.0:
        measured = math.floor(measured / d[COUNT]) * d[COUNT]
    s[VELOCITY_ESTIMATE] += d[VELOCITY_FILTER] * (
        (measured - s[MEASURED]) / d[LOOP_S] - s[VELOCITY_ESTIMATE]
    )
    s[MEASURED] = measured
    if s[MODE] == BRAKE:
        s[TARGET_LEFT] = 1.0
        slower = abs(s[TARGET_STEP]) - s[BRAKE_STEP] * d[LOOP_S]
        s[TARGET_STEP] = math.copysign(max(slower, 0.0), s[TARGET_STEP])
    speed = 0.0
    if s[TARGET_LEFT] > 0.0:
        s[TARGET] += s[TARGET_STEP]
        s[TARGET_LEFT] -= 1.0
        speed = s[TARGET_STEP] / d[LOOP_S]
    error = s[TARGET] - measured
    limit = d[CURRENT_LIMIT]
    if d[VELOCITY_GAIN] == 0.0:
        return float(
            min(max(d[POSITION_GAIN] * error / d[TORQUE_PER_AMPERE] + s[OFFSET], -limit), limit)
        )
    velocity_error = d[POSITION_GAIN] * error + d[FEEDFORWARD] * speed - s[VELOCITY_ESTIMATE]
    integral = s[VELOCITY_INTEGRAL] + d[VELOCITY_INTEGRAL_GAIN] * d[LOOP_S] * velocity_error
    wanted = d[VELOCITY_GAIN] * (velocity_error + integral) / d[TORQUE_PER_AMPERE] + s[OFFSET]
    if (
        abs(wanted) <= limit or wanted * velocity_error < 0.0
    ):  # anti-windup: integrate only if the integral moves away from the limit
        s[VELOCITY_INTEGRAL] = integral
    return float(min(max(wanted, -limit), limit))


@inlined
def voltage_command(s: Vector, d: Vector, wanted: float, noise: float) -> float:
    """Return the limited voltage of the current controller for the next loop period, V."""
    error = wanted - (s[CURRENT] + noise)
    integral = s[VOLTAGE_INTEGRAL] + d[CURRENT_GAIN] * d[CURRENT_INTEGRAL_GAIN] * d[LOOP_S] * error
    voltage = d[CURRENT_GAIN] * error + integral
    limit = d[VOLTAGE_LIMIT]
    if abs(voltage) <= limit or voltage * error < 0.0:
        s[VOLTAGE_INTEGRAL] = integral
    return float(min(max(voltage, -limit), limit))
