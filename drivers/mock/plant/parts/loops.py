"""Compiled integration of the nominal simulated machine: control loops, motor (eq. 1), friction."""

from __future__ import annotations

import math

from drivers.mock.plant.parts.compiled import Vector, compiled, inlined
from drivers.mock.plant.parts.friction import friction, step_velocity

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
    """Compute position P and velocity PI controller once; return the limited current command with
    the added current, A.
    """
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
    """Compute the PI controller of the current once; return the limited voltage for the next loop
    period, V.
    """
    error = wanted - (s[CURRENT] + noise)
    integral = s[VOLTAGE_INTEGRAL] + d[CURRENT_GAIN] * d[CURRENT_INTEGRAL_GAIN] * d[LOOP_S] * error
    voltage = d[CURRENT_GAIN] * error + integral
    limit = d[VOLTAGE_LIMIT]
    if abs(voltage) <= limit or voltage * error < 0.0:
        s[VOLTAGE_INTEGRAL] = integral
    return float(min(max(voltage, -limit), limit))


@inlined
def integrate(s: Vector, d: Vector, p: Vector, voltage: float, powered: bool, decay: float) -> None:
    """Integrate eq. 1 over one loop period at constant voltage.

    The method is Strang splitting: half a step of the current (exact for a given speed), a step of
    the speed (trapezoidal, implicit in friction), half a step of the current. The mean torque on
    the shaft is exactly Km i times the logged mean current. ``decay`` is exp(-R h / 2 L).
    """
    h = d[LOOP_S] / d[STEPS]
    omega = s[OMEGA]
    theta = s[THETA]
    current = s[CURRENT]
    charge = 0.0
    held, _ = friction(abs(omega), p)
    for _ in range(int(d[STEPS])):
        if powered:
            settled = (voltage - d[EMF_PER_SPEED] * omega) / d[RESISTANCE]
            current = settled + (current - settled) * decay
        new, impulse, held = step_velocity(omega, held, d[TORQUE_PER_AMPERE] * current, h, p)
        charge += current
        mean = 0.5 * (omega + new)
        theta += h * mean
        s[FRICTION_WORK] += impulse * abs(mean)
        omega = new
        if powered:
            settled = (voltage - d[EMF_PER_SPEED] * omega) / d[RESISTANCE]
            current = settled + (current - settled) * decay
    s[THETA] = theta
    s[OMEGA] = omega
    s[CURRENT] = current
    s[SUM_CURRENT] += charge * h


@compiled
def advance(loops: int, s: Vector, d: Vector, p: Vector, noise: Vector, path: Vector) -> None:
    """Advance ``loops`` drive-loop periods.

    ``noise`` contains ``loops`` samples of unit rms; ``path`` contains ``loops`` commanded joint
    angles; if it is empty, the drive interpolates to its target.
    """
    decay = math.exp(-0.5 * d[RESISTANCE] * d[LOOP_S] / d[STEPS] / d[INDUCTANCE])
    for k in range(loops):
        voltage = 0.0
        powered = s[MODE] != OFF
        error = d[NOISE] * noise[k]
        if len(path) > 0:
            s[TARGET_STEP] = path[k] - s[TARGET]
            s[TARGET_LEFT] = 1.0
        wanted = current_command(s, d)
        if powered:
            voltage = voltage_command(s, d, wanted, error)
        else:
            s[CURRENT] = 0.0
            s[VELOCITY_INTEGRAL] = 0.0
            s[VOLTAGE_INTEGRAL] = 0.0
        integrate(s, d, p, voltage, powered, decay)
        s[SUM_VOLTAGE] += voltage * d[LOOP_S]
        s[SUM_NOISE] += error
        s[SUM_LOOPS] += 1.0
