"""Compiled integration of a machine with injected effects.

Without effects the results equal those of the nominal kernel.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.friction import (
    WORK_SIZE,
    device_torque,
    level,
    remember,
    renew,
    step_bristles,
    step_slipping,
)
from drivers.mock.plant.effects.motor import (
    COPPER_PER_K,
    MAGNET_PER_K,
    cogging,
    dead_time_voltage,
    flux_factor,
    saturated,
    winding,
)
from drivers.mock.plant.effects.outside import (
    OUTSIDE_END,
    TRAVEL_LENGTH,
    TRAVEL_TORQUE,
    outside_torque,
)
from drivers.mock.plant.effects.sensing import Histories, sense
from drivers.mock.plant.effects.shaft import deflection, give_way, mesh_error, shaft_torque
from drivers.mock.plant.effects.state import (
    BRISTLES,
    EXTERNAL,
    GEAR,
    HEAT,
    JOINT,
    NOMINAL_SUPPLY,
    OUTSIDE_TORQUE,
    PLAY,
    ROTOR_INERTIA,
    ROTOR_SPEED,
    RUN,
    SHAFT_DAMPING,
    STEADY_LOAD,
    SUPPLY,
    TIME,
    TORQUE_CURRENT,
    TRANSMITTED,
    TRAVEL,
    TWO_MASSES,
)
from drivers.mock.plant.parts.compiled import Vector, compiled, inlined
from drivers.mock.plant.parts.friction import INERTIA
from drivers.mock.plant.parts.loops import (
    CURRENT,
    EMF_PER_SPEED,
    FRICTION_WORK,
    INDUCTANCE,
    LOOP_S,
    MODE,
    NOISE,
    OFF,
    OMEGA,
    RESISTANCE,
    STEPS,
    SUM_CURRENT,
    SUM_LOOPS,
    SUM_NOISE,
    SUM_VOLTAGE,
    TARGET,
    TARGET_LEFT,
    TARGET_STEP,
    THETA,
    TORQUE_PER_AMPERE,
    VELOCITY_INTEGRAL,
    VOLTAGE_INTEGRAL,
    current_command,
    voltage_command,
)

CONSTANTS_AT = OUTSIDE_END
"""Start of the constants of :mod:`drivers.mock.plant.effects.state` in the effect vector."""


@inlined
def move_joint(
    omega: float, held: float, bristles: float, torque: float, h: float, w: Vector, e: Vector
) -> tuple[float, float, float, float]:
    """Advance the joint speed by ``h`` s; return speed, friction at the end of the step, deflection
    of the bristles, and work of friction.
    """
    if e[table.PRESLIDING_STIFFNESS] > 0.0:
        new, bristles, drag = step_bristles(omega, bristles, torque, h, w, e)
        return new, abs(drag), bristles, h * drag * 0.5 * (omega + new)
    new, impulse, held = step_slipping(omega, held, torque, h, w, e)
    return new, held, bristles, impulse * abs(0.5 * (omega + new))


@inlined
def integrate(
    s: Vector,
    x: Vector,
    d: Vector,
    w: Vector,
    e: Vector,
    voltage: float,
    powered: bool,
    decay: float,
    resistance: float,
) -> float:
    """Integrate one loop period at constant voltage and return the charge, A s.

    A machine with one mass is integrated by the splitting of the nominal kernel. With two masses,
    the angles advance by half a step, then the speeds by a step, then the angles by half a step.
    """
    h = d[LOOP_S] / d[STEPS]
    at = CONSTANTS_AT
    two = e[at + TWO_MASSES] != 0.0
    outside = e[at + OUTSIDE_TORQUE] != 0.0
    steady = e[at + STEADY_LOAD]
    gear, rotor_inertia, damping = e[at + GEAR], e[at + ROTOR_INERTIA], e[at + SHAFT_DAMPING]
    per_ampere, per_speed = d[TORQUE_PER_AMPERE], d[EMF_PER_SPEED]
    # All variables that change are local variables, so that the compiler can keep the effect vector
    # in registers.
    omega, theta, current = s[OMEGA], x[JOINT], s[CURRENT]
    rotor, turning = s[THETA], x[ROTOR_SPEED]
    effective, bristles = x[TORQUE_CURRENT], x[BRISTLES]
    transmitted, play = x[TRANSMITTED], x[PLAY]
    external = friction_work = charge = 0.0
    warm = 1.0 + MAGNET_PER_K * x[HEAT] * e[table.HEATING_MAGNET]
    dead = dead_time_voltage(x[SUPPLY], e[at + NOMINAL_SUPPLY], e)
    lag_s = e[table.LAG_TIME]
    lag = 1.0 - math.exp(-h / lag_s) if lag_s > 0.0 else 1.0
    strange = outside_torque(x[RUN], theta, x[TRAVEL], e) if outside else 0.0
    held, _ = level(abs(omega), 1.0 if omega >= 0.0 else -1.0, w, e)
    error, steepness = mesh_error(theta, e)
    if not two:
        turning = omega * (1.0 + steepness)
    for _ in range(int(d[STEPS])):
        flux = warm * flux_factor(rotor * gear, e)
        if powered:
            current = winding(
                current, voltage, per_speed * flux * turning, resistance, dead, decay, e
            )
        # The torque over the step is that of the mean lagged current; the lagged current at the end
        # of the step is half a step later.
        acting = current if lag == 1.0 else current + lag * lag_s / h * (effective - current)
        effective = current if lag == 1.0 else effective + lag * (current - effective)
        torque = per_ampere * flux * saturated(acting, e) + cogging(rotor * gear, e)
        external = steady + device_torque(theta, omega, e)
        charge += current
        if two:
            rotor += 0.5 * h * turning
            theta += 0.5 * h * omega
            error, steepness = mesh_error(theta, e)
            twist = rotor - theta - error
            before = deflection(play, e)
            given, play = give_way(twist, play, e)
            # The coupling is in series with the shaft; the damping of the shaft does not act on the
            # coupling.
            rate = turning - omega * (1.0 + steepness) - (given - before) / h
            carried = shaft_torque(twist, rate, given, damping, e)
            transmitted = carried * (1.0 + e[table.MESH_WITH_TORQUE] * steepness)
            turning += h * (torque - carried) / rotor_inertia
            omega, held, bristles, work = move_joint(
                omega, held, bristles, transmitted + external + strange, h, w, e
            )
            rotor += 0.5 * h * turning
            theta += 0.5 * h * omega
        else:
            transmitted = torque * (1.0 + e[table.MESH_WITH_TORQUE] * steepness)
            new, held, bristles, work = move_joint(
                omega, held, bristles, transmitted + external + strange, h, w, e
            )
            theta += h * (0.5 * (omega + new))
            omega = new
            error, steepness = mesh_error(theta, e)
            rotor = theta + error
            turning = omega * (1.0 + steepness)
        friction_work += work
        if powered:
            current = winding(
                current, voltage, per_speed * flux * turning, resistance, dead, decay, e
            )
    s[THETA], s[OMEGA], s[CURRENT] = rotor, omega, current
    s[FRICTION_WORK] += friction_work
    x[JOINT], x[ROTOR_SPEED] = theta, turning
    x[TORQUE_CURRENT], x[BRISTLES], x[EXTERNAL] = effective, bristles, external
    x[TRANSMITTED], x[PLAY] = transmitted, play
    return float(charge * h)


@inlined
def power_stage(s: Vector, x: Vector, e: Vector, voltage: float) -> float:
    """Set the supply voltage under the present load, and return the winding voltage for the
    commanded ``voltage``, V.
    """
    nominal = e[CONSTANTS_AT + NOMINAL_SUPPLY]
    x[SUPPLY] = nominal
    if e[table.SAG_RESISTANCE] == 0.0:
        return voltage
    x[SUPPLY] = max(nominal - e[table.SAG_RESISTANCE] * voltage / nominal * s[CURRENT], 0.0)
    return float(voltage * x[SUPPLY] / nominal)


@compiled
def advance_hiding(
    loops: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    noise: Vector,
    path: Vector,
) -> None:
    """Advance ``loops`` drive-loop periods, as :func:`drivers.mock.plant.parts.loops.advance` does,
    with effects.

    ``x`` and ``histories`` are the state of the effects; ``e`` is the effect vector.
    """
    period = d[LOOP_S]
    step = period / d[STEPS]
    decay = math.exp(-0.5 * d[RESISTANCE] * step / d[INDUCTANCE])
    resistance = d[RESISTANCE]
    w = np.zeros(WORK_SIZE)
    w[INERTIA] = p[INERTIA]
    if e[CONSTANTS_AT + TWO_MASSES] != 0.0:
        w[INERTIA] -= e[CONSTANTS_AT + ROTOR_INERTIA]
    for k in range(loops):
        voltage = 0.0
        powered = s[MODE] != OFF
        error = d[NOISE] * noise[k] + e[table.CURRENT_OFFSET] + e[table.CURRENT_DRIFT] * x[TIME]
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
        if e[table.HEATING_RISE] > 0.0:
            resistance = d[RESISTANCE] * (1.0 + COPPER_PER_K * x[HEAT])
            decay = math.exp(-0.5 * resistance * step / d[INDUCTANCE])
            target = e[table.HEATING_RISE] * resistance * s[CURRENT] * s[CURRENT]
            x[HEAT] += (target - x[HEAT]) * period / e[table.HEATING_TIME]
        before = s[OMEGA]
        renew(w, p, e, x, before)
        charge = integrate(s, x, d, w, e, power_stage(s, x, e, voltage), powered, decay, resistance)
        remember(w, p, e, x, before, s[OMEGA], period)
        if e[TRAVEL_TORQUE] != 0.0:
            moved = s[OMEGA] * period / e[TRAVEL_LENGTH]
            x[TRAVEL] = (x[TRAVEL] + moved) / (1.0 + abs(moved))
        s[SUM_CURRENT] += sense(x, e, histories, charge, period)
        s[SUM_VOLTAGE] += voltage * period
        s[SUM_NOISE] += error
        s[SUM_LOOPS] += 1.0
