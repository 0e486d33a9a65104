"""Compiled integration of a machine with injected effects.

Without effects the results equal those of the nominal kernel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

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
from drivers.mock.plant.effects.outside import (
    OUTSIDE_END,
    TRAVEL_LENGTH,
    TRAVEL_TORQUE,
    outside_torque,
)
from drivers.mock.plant.effects.table import (
    BRISTLES,
    BRUSH_CURRENT,
    BRUSH_VOLTAGE,
    COGGING_ORDER,
    COGGING_PHASE,
    COGGING_TORQUE,
    DEAD_TIME_VOLTAGE,
    EXTERNAL,
    GAP,
    GEAR,
    HEAT,
    HISTORY,
    HYSTERESIS_DEFLECTION,
    HYSTERESIS_TORQUE,
    JOINT,
    LOOP,
    MESH_AMPLITUDE,
    MESH_ORDER,
    MESH_PHASE,
    NOMINAL_SUPPLY,
    OUTSIDE_TORQUE,
    PLAY,
    RECORDING,
    RIPPLE_FRACTION,
    RIPPLE_ORDER,
    RIPPLE_PHASE,
    ROTOR_INERTIA,
    ROTOR_SPEED,
    RUN,
    SATURATION_KNEE,
    SATURATION_RATIONAL,
    SEEN,
    SHAFT_DAMPING,
    SLIPPED,
    STEADY_LOAD,
    STIFFNESS,
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

HARD_N_M_RAD = 1e6
"""Default stiffness of teeth and shaft; a torque of 20 N m twists the shaft by 20 microradian, one
count of the encoder.
"""
DAMPING_RATIO = 0.08
"""Assumed damping ratio of the oscillation of rotor against joint on the spring of the shaft."""


@inlined
def stiffness_of(e: Vector) -> float:
    """Return the shaft's stiffness, N m/rad."""
    return e[STIFFNESS] if e[STIFFNESS] > 0.0 else HARD_N_M_RAD


@inlined
def shaft_torque(twist: float, rate: float, given: float, damping: float, e: Vector) -> float:
    """Return the torque that the shaft transmits from rotor to joint.

    Teeth can only push, so that damping does not reverse the torque of a closed gap.

    Args:
        twist: Twist, rad.
        rate: Rate of the twist without that of the coupling, rad/s.
        given: Deflection in the coupling's hysteresis, rad.
        damping: Damping, N m s/rad.
        e: Effect vector.
    """
    stiffness = stiffness_of(e)
    half = 0.5 * e[GAP]
    if half == 0.0:
        return float(stiffness * (twist - given) + damping * rate)
    if twist > half:
        return float(max(stiffness * (twist - half - given) + damping * rate, 0.0))
    if twist < -half:
        return float(min(stiffness * (twist + half - given) + damping * rate, 0.0))
    return 0.0


@inlined
def deflection(play: float, e: Vector) -> float:
    """Return the deflection in the coupling's hysteresis for the present play state, rad."""
    most = e[HYSTERESIS_DEFLECTION]
    return float(most * min(max(play / e[HYSTERESIS_TORQUE], -1.0), 1.0)) if most > 0.0 else 0.0


@inlined
def give_way(twist: float, play: float, e: Vector) -> tuple[float, float]:
    """Return the deflection, rad, and the state of the play operator, N m, of a coupling with
    hysteresis in series with the shaft's spring.

    The coupling is rate-independent and dissipative. A play operator of half width ``torque_Nm``
    follows the torque. The deflection is proportional to the output of the operator,
    ``deflection_rad`` for ``torque_Nm``, and at most +- ``deflection_rad``. Deflection and torque
    are solved together in closed form, because the spring is stiff.

    Args:
        twist: Twist of spring and coupling, rad.
        play: Previous state of the play operator, N m.
        e: Effect vector.
    """
    most, width = e[HYSTERESIS_DEFLECTION], e[HYSTERESIS_TORQUE]
    if most == 0.0:
        return 0.0, 0.0
    half = 0.5 * e[GAP]
    beyond = max(twist - half, 0.0) + min(twist + half, 0.0)
    stiffness = stiffness_of(e)
    torque = stiffness * (beyond - most * min(max(play / width, -1.0), 1.0))
    if abs(torque - play) > width:
        side = 1.0 if torque > play else -1.0
        play = stiffness * (beyond + side * most) / (1.0 + stiffness * most / width) - side * width
        if abs(play) > width:
            play = stiffness * (beyond - math.copysign(most, play)) - side * width
    return deflection(play, e), play


@inlined
def mesh_error(theta: float, e: Vector) -> tuple[float, float]:
    """Return the mesh error phi/i - theta at a joint angle, rad, and its derivative with respect to
    the angle.
    """
    if e[MESH_AMPLITUDE] == 0.0:
        return 0.0, 0.0
    at = e[MESH_ORDER] * theta + e[MESH_PHASE]
    return e[MESH_AMPLITUDE] * math.sin(at), e[MESH_AMPLITUDE] * e[MESH_ORDER] * math.cos(at)


COPPER_PER_K = 0.00393
"""Temperature coefficient of the resistance of a copper winding, 1/K."""
MAGNET_PER_K = -0.001
"""Relative decrease of magnet flux, torque constant and back-EMF per kelvin."""


@inlined
def winding(
    current: float,
    voltage: float,
    emf: float,
    resistance: float,
    dead: float,
    decay: float,
    e: Vector,
) -> float:
    """Return the current after half a step at constant voltage and speed.

    The dead time opposes the current with the constant voltage ``dead``; the brushes oppose the
    current with a voltage that grows with the current. A current that the dead time brings to zero
    stays zero until the voltage exceeds ``dead``.
    """
    push = voltage - emf
    if e[BRUSH_VOLTAGE] != 0.0:
        push -= e[BRUSH_VOLTAGE] * math.tanh(current / e[BRUSH_CURRENT])
    if dead == 0.0:
        settled = push / resistance
        return settled + (current - settled) * decay
    if current == 0.0:
        if abs(push) <= dead:
            return 0.0
        side = math.copysign(1.0, push)
    else:
        side = math.copysign(1.0, current)
    settled = (push - side * dead) / resistance
    after = settled + (current - settled) * decay
    return 0.0 if after * side < 0.0 else after


@inlined
def dead_time_voltage(supply: float, nominal: float, e: Vector) -> float:
    """Return the voltage loss due to the dead time, a share of the supply voltage, V."""
    return float(e[DEAD_TIME_VOLTAGE] * supply / nominal)


@inlined
def flux_factor(shaft: float, e: Vector) -> float:
    """Return the ratio of the flux at a motor angle (rad) to the mean flux; this ratio scales
    torque and back-EMF.
    """
    if e[RIPPLE_FRACTION] == 0.0:
        return 1.0
    return float(1.0 + e[RIPPLE_FRACTION] * math.sin(e[RIPPLE_ORDER] * shaft + e[RIPPLE_PHASE]))


@inlined
def saturated(current: float, e: Vector) -> float:
    """Return the effective current for the torque under saturation, A."""
    knee = e[SATURATION_KNEE]
    if knee <= 0.0:
        return current
    if e[SATURATION_RATIONAL] > 0.0:
        return float(current / (1.0 + (current / knee) ** 2))
    return float(knee * math.tanh(current / knee))


@inlined
def cogging(shaft: float, e: Vector) -> float:
    """Return the cogging torque at the joint, at a motor angle in rad."""
    if e[COGGING_TORQUE] == 0.0:
        return 0.0
    return float(e[COGGING_TORQUE] * math.sin(e[COGGING_ORDER] * shaft + e[COGGING_PHASE]))


Histories = NDArray[np.float64]
"""Joint angles and mean currents of the last loop periods, shape (2, HISTORY)."""


@inlined
def earlier(history: Vector, loop: float, delay_s: float, period_s: float) -> float:
    """Return the value that was ``delay_s`` before the newest value, interpolated between loop
    periods; ``loop`` is the index of the newest value.
    """
    back = delay_s / period_s
    whole = math.floor(back)
    share = back - whole
    at = int(loop - whole)
    mask = HISTORY - 1
    return float((1.0 - share) * history[at & mask] + share * history[(at - 1) & mask])


@inlined
def sense(x: Vector, e: Vector, histories: Histories, charge: float, period_s: float) -> float:
    """Sample the joint encoder, and return the charge, A s, that corresponds to the logged mean
    current of this period.
    """
    x[LOOP] += 1.0
    at = int(x[LOOP]) & (HISTORY - 1)
    theta = x[JOINT]
    if (
        e[table.SLIP_ANGLE] != 0.0
        and x[RECORDING] == e[table.SLIP_RECORDING]
        and x[TIME] >= e[table.SLIP_TIME]
    ):
        x[SLIPPED] = e[table.SLIP_ANGLE]
    seen = theta + x[SLIPPED]
    if e[table.ECCENTRICITY] != 0.0:
        seen += e[table.ECCENTRICITY] * math.sin(theta + e[table.ECCENTRICITY_PHASE])
    histories[0, at] = seen
    histories[1, at] = charge
    if e[table.DELAY_TIME] > 0.0:
        seen = earlier(histories[0], x[LOOP], e[table.DELAY_TIME], period_s)
    x[SEEN] = seen
    x[TIME] += period_s
    x[RUN] += period_s
    if e[table.SKEW_TIME] > 0.0:
        return earlier(histories[1], x[LOOP], e[table.SKEW_TIME], period_s)
    return charge


CONSTANTS_AT = OUTSIDE_END
"""Start of the constants of :mod:`drivers.mock.plant.effects.table` in the effect vector."""


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
