"""Compiled integration of the simulated machine with the injected effects."""

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
from drivers.mock.plant.parts import loops
from drivers.mock.plant.parts.compiled import Vector, compiled, inlined
from drivers.mock.plant.parts.friction import INERTIA
from drivers.mock.plant.parts.loops import current_command, voltage_command

HARD_N_M_RAD = 1e6
"""Default stiffness; 20 N m twist the shaft by 20 microradian, a count of the encoder."""
DAMPING_RATIO = 0.08
"""Assumed damping ratio of the oscillation of rotor against joint on the spring of the shaft."""


@inlined
def stiffness_of(e: Vector) -> float:
    """Return the shaft's stiffness, N m/rad."""
    return e[table.STIFFNESS] if e[table.STIFFNESS] > 0.0 else HARD_N_M_RAD


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
    half = 0.5 * e[table.GAP]
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
    most = e[table.HYSTERESIS_DEFLECTION]
    return (
        float(most * min(max(play / e[table.HYSTERESIS_TORQUE], -1.0), 1.0)) if most > 0.0 else 0.0
    )


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
    most, width = e[table.HYSTERESIS_DEFLECTION], e[table.HYSTERESIS_TORQUE]
    if most == 0.0:
        return 0.0, 0.0
    half = 0.5 * e[table.GAP]
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
    """Return the mesh error phi/i - theta, rad, and its derivative by the angle."""
    if e[table.MESH_AMPLITUDE] == 0.0:
        return 0.0, 0.0
    at = e[table.MESH_ORDER] * theta + e[table.MESH_PHASE]
    return e[table.MESH_AMPLITUDE] * math.sin(at), e[table.MESH_AMPLITUDE] * e[
        table.MESH_ORDER
    ] * math.cos(at)


COPPER_PER_K = 0.00393  # temperature coefficient of the resistance of a copper winding, 1/K
MAGNET_PER_K = -0.001  # relative decrease of magnet flux, torque constant and back-EMF per kelvin


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
    if e[table.BRUSH_VOLTAGE] != 0.0:
        push -= e[table.BRUSH_VOLTAGE] * math.tanh(current / e[table.BRUSH_CURRENT])
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
    return float(e[table.DEAD_TIME_VOLTAGE] * supply / nominal)


@inlined
def flux_factor(shaft: float, e: Vector) -> float:
    """Return the ratio of the flux at a motor angle to its mean; it scales torque and back-EMF."""
    if e[table.RIPPLE_FRACTION] == 0.0:
        return 1.0
    return float(
        1.0
        + e[table.RIPPLE_FRACTION] * math.sin(e[table.RIPPLE_ORDER] * shaft + e[table.RIPPLE_PHASE])
    )


@inlined
def saturated(current: float, e: Vector) -> float:
    """Return the effective current for the torque under saturation, A."""
    knee = e[table.SATURATION_KNEE]
    if knee <= 0.0:
        return current
    if e[table.SATURATION_RATIONAL] > 0.0:
        return float(current / (1.0 + (current / knee) ** 2))
    return float(knee * math.tanh(current / knee))


@inlined
def cogging(shaft: float, e: Vector) -> float:
    """Return the cogging torque at the joint, at a motor angle in rad."""
    if e[table.COGGING_TORQUE] == 0.0:
        return 0.0
    return float(
        e[table.COGGING_TORQUE] * math.sin(e[table.COGGING_ORDER] * shaft + e[table.COGGING_PHASE])
    )


@inlined
def read_rotor(rotor: float, e: Vector) -> float:
    """Return the rotor's angle over the gear ratio, as the encoder of the motor reads it, rad."""
    if e[table.READING_RIPPLE] == 0.0:
        return rotor
    gear = e[CONSTANTS_AT + table.GEAR]
    wave = math.sin(e[table.READING_ORDER] * rotor * gear + e[table.READING_PHASE])
    return float(rotor + e[table.READING_RIPPLE] * wave / gear)


Histories = NDArray[np.float64]
"""Joint angles and mean currents of the last loop periods, shape (2, table.HISTORY)."""


@inlined
def earlier(history: Vector, loop: float, delay_s: float, period_s: float) -> float:
    """Return the value ``delay_s`` before the newest one, which has the index ``loop``."""
    back = delay_s / period_s
    whole = math.floor(back)
    share = back - whole
    at = int(loop - whole)
    mask = table.HISTORY - 1
    return float((1.0 - share) * history[at & mask] + share * history[(at - 1) & mask])


@inlined
def sense(x: Vector, e: Vector, histories: Histories, charge: float, period_s: float) -> float:
    """Sample the joint encoder; return the charge, A s, of the logged mean current."""
    x[table.LOOP] += 1.0
    at = int(x[table.LOOP]) & (table.HISTORY - 1)
    theta = x[table.JOINT]
    if (
        e[table.SLIP_ANGLE] != 0.0
        and x[table.RECORDING] == e[table.SLIP_RECORDING]
        and x[table.TIME] >= e[table.SLIP_TIME]
    ):
        x[table.SLIPPED] = e[table.SLIP_ANGLE]
    seen = theta + x[table.SLIPPED]
    if e[table.ECCENTRICITY] != 0.0:
        seen += e[table.ECCENTRICITY] * math.sin(theta + e[table.ECCENTRICITY_PHASE])
    histories[0, at] = seen
    histories[1, at] = charge
    if e[table.DELAY_TIME] > 0.0:
        seen = earlier(histories[0], x[table.LOOP], e[table.DELAY_TIME], period_s)
    x[table.SEEN] = seen
    x[table.TIME] += period_s
    x[table.RUN] += period_s
    if e[table.SKEW_TIME] > 0.0:
        return earlier(histories[1], x[table.LOOP], e[table.SKEW_TIME], period_s)
    return charge


CONSTANTS_AT = OUTSIDE_END  # start of the constants of `table` in the effect vector


@inlined
def move_joint(
    omega: float, held: float, bristles: float, torque: float, h: float, w: Vector, e: Vector
) -> tuple[float, float, float, float]:
    """Advance by ``h`` s; return speed, friction, deflection of the bristles, and work."""
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
    """Integrate eq. 1 over one loop period at constant voltage and return the charge, A s.

    The method is Strang splitting: half a step of the current (exact for a given speed), a step of
    the speed, half a step of the current. The mean torque on the shaft is exactly Km i times the
    logged mean current. With two masses, the angles advance by half a step before and after the
    speeds. ``decay`` is exp(-R h / 2 L).
    """
    h = d[loops.LOOP_S] / d[loops.STEPS]
    at = CONSTANTS_AT
    two = e[at + table.TWO_MASSES] != 0.0
    outside = e[at + table.OUTSIDE_TORQUE] != 0.0
    steady = e[at + table.STEADY_LOAD]
    gear, rotor_inertia, damping = (
        e[at + table.GEAR],
        e[at + table.ROTOR_INERTIA],
        e[at + table.SHAFT_DAMPING],
    )
    per_ampere, per_speed = d[loops.TORQUE_PER_AMPERE], d[loops.EMF_PER_SPEED]
    # All variables that change are local variables, so that the compiler can keep the effect vector
    # in registers.
    omega, theta, current = s[loops.OMEGA], x[table.JOINT], s[loops.CURRENT]
    rotor, turning = s[loops.THETA], x[table.ROTOR_SPEED]
    effective, bristles = x[table.TORQUE_CURRENT], x[table.BRISTLES]
    transmitted, play, wound = x[table.TRANSMITTED], x[table.PLAY], x[table.WOUND]
    external = friction_work = charge = 0.0
    warm = 1.0 + MAGNET_PER_K * x[table.HEAT] * e[table.HEATING_MAGNET]
    dead = dead_time_voltage(x[table.SUPPLY], e[at + table.NOMINAL_SUPPLY], e)
    lag_s = e[table.LAG_TIME]
    lag = 1.0 - math.exp(-h / lag_s) if lag_s > 0.0 else 1.0
    strange = outside_torque(x[table.RUN], theta, x[table.TRAVEL], e) if outside else 0.0
    held, _ = level(abs(omega), 1.0 if omega >= 0.0 else -1.0, w, e)
    error, steepness = mesh_error(theta, e)
    if not two:
        turning = omega * (1.0 + steepness)
    for _ in range(int(d[loops.STEPS])):
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
        torque -= e[table.STRAY_DRAG] * acting * acting * turning
        torque -= wound * (
            e[table.WIND_MOTION] * abs(torque) + e[table.WIND_TORQUE] * torque * wound
        )
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
    s[loops.THETA], s[loops.OMEGA], s[loops.CURRENT] = rotor, omega, current
    s[loops.FRICTION_WORK] += friction_work
    x[table.JOINT], x[table.ROTOR_SPEED] = theta, turning
    x[table.TORQUE_CURRENT], x[table.BRISTLES], x[table.EXTERNAL] = effective, bristles, external
    x[table.TRANSMITTED], x[table.PLAY] = transmitted, play
    return float(charge * h)


@inlined
def power_stage(s: Vector, x: Vector, e: Vector, voltage: float) -> float:
    """Set the supply voltage under load; return the winding voltage for ``voltage``, V."""
    nominal = e[CONSTANTS_AT + table.NOMINAL_SUPPLY]
    x[table.SUPPLY] = nominal
    if e[table.SAG_RESISTANCE] == 0.0:
        return voltage
    refers = e[table.SAG_SUPPLY] if e[table.SAG_SUPPLY] > 0.0 else nominal
    fall = e[table.SAG_RESISTANCE] * voltage / refers * s[loops.CURRENT] / refers
    x[table.SUPPLY] = max(nominal * (1.0 - fall), 0.0)
    return float(voltage * x[table.SUPPLY] / nominal)


@compiled
def advance(
    count: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    noise: Vector,
    path: Vector,
) -> None:
    """Advance ``count`` drive-loop periods.

    ``x`` and ``histories`` are the state of the effects; ``e`` is the effect vector. ``noise``
    has ``count`` samples of unit rms; ``path`` has ``count`` commanded joint angles; if it is
    empty, the drive interpolates to its target.
    """
    period = d[loops.LOOP_S]
    step = period / d[loops.STEPS]
    decay = math.exp(-0.5 * d[loops.RESISTANCE] * step / d[loops.INDUCTANCE])
    resistance = d[loops.RESISTANCE]
    w = np.zeros(WORK_SIZE)
    w[INERTIA] = p[INERTIA]
    if e[CONSTANTS_AT + table.TWO_MASSES] != 0.0:
        w[INERTIA] -= e[CONSTANTS_AT + table.ROTOR_INERTIA]
    for k in range(count):
        voltage = 0.0
        powered = s[loops.MODE] != loops.OFF
        error = (
            d[loops.NOISE] * noise[k]
            + e[table.CURRENT_OFFSET]
            + e[table.CURRENT_DRIFT] * x[table.TIME]
        )
        if len(path) > 0:
            s[loops.TARGET_STEP] = path[k] - s[loops.TARGET]
            s[loops.TARGET_LEFT] = 1.0
        wanted = current_command(s, d)
        if powered:
            voltage = voltage_command(s, d, wanted, error)
        else:
            s[loops.CURRENT] = 0.0
            s[loops.VELOCITY_INTEGRAL] = 0.0
            s[loops.VOLTAGE_INTEGRAL] = 0.0
        if e[table.HEATING_RISE] > 0.0:
            resistance = d[loops.RESISTANCE] * (1.0 + COPPER_PER_K * x[table.HEAT])
            decay = math.exp(-0.5 * resistance * step / d[loops.INDUCTANCE])
            target = e[table.HEATING_RISE] * resistance * s[loops.CURRENT] * s[loops.CURRENT]
            x[table.HEAT] += (target - x[table.HEAT]) * period / e[table.HEATING_TIME]
        before = s[loops.OMEGA]
        renew(w, p, e, x, before)
        charge = integrate(s, x, d, w, e, power_stage(s, x, e, voltage), powered, decay, resistance)
        remember(w, p, e, x, before, s[loops.OMEGA], period)
        if e[table.WIND_TRAVEL] > 0.0:
            moved = s[loops.OMEGA] * period / e[table.WIND_TRAVEL]
            x[table.WOUND] = (x[table.WOUND] + moved) / (1.0 + abs(moved))
        if e[TRAVEL_TORQUE] != 0.0:
            moved = s[loops.OMEGA] * period / e[TRAVEL_LENGTH]
            x[table.TRAVEL] = (x[table.TRAVEL] + moved) / (1.0 + abs(moved))
        s[loops.SUM_CURRENT] += sense(x, e, histories, charge, period)
        s[loops.SUM_VOLTAGE] += voltage * period
        s[loops.SUM_NOISE] += error
        s[loops.SUM_LOOPS] += 1.0
