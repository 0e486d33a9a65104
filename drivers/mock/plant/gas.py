"""Compiled time steps of the simulated gas generator (eq. 2 to 8), by an implicit method.

    dm/dt = rho_b A_b r - p A_t / C_r,    dV/dt = A_b r,    p = m R_g T_g / V,    r = a p^n

These are eq. 7, with the mass m of the stored gas as the state; they include the gas density. Eq. 8
neglects the gas density; this is equivalent to a gas source of rho_g A_b r, so that one time step
solves eq. 7 and eq. 8. The method is SDIRK of second order (Alexander). It must be L-stable,
because the pressure may settle within one step if the free volume is small or the throat is open.
Stages and sums are linear in m, V, burnt and outflow, so that the mass balance holds to rounding
for any step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.effects import gas as hidden
from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.kernel import Histories, advance
from drivers.mock.plant.effects.pack import GAS_KNOWN
from drivers.mock.plant.effects.table import JOINT
from drivers.mock.plant.parts import constants
from drivers.mock.plant.parts.compiled import Vector, compiled, inlined
from drivers.mock.plant.parts.friction import MOMENT, open_throat
from drivers.mock.plant.parts.loops import LOOP_S

# State vector.
(
    BURN_TIME,  # s since ignition
    MASS,  # mass of the stored gas, kg
    VOLUME,  # free volume, m^3
    BURNT,  # propellant burnt since ignition, kg
    OUTFLOW,  # gas through throat and leaks since ignition, kg
    PRESSURE,  # p_g, Pa
    THROAT,  # A_t of the valve, m^2
    FORCE,  # F_P, eq. 10, N
    PENDING,  # loops of the drive since the last step
    MEMORY,  # from here on: state of injected effects
) = range(10)
GAS_SIZE = MEMORY + hidden.MEMORY_SIZE

# Constants and the factors on them; without effects the factors are 1, and there is no leak.
(
    DENSITY,  # rho_b, kg/m^3
    BURNING_AREA,  # A_b, m^2
    RATE,  # a, m/s Pa^-n
    EXPONENT,  # n
    ENERGY,  # R_g T_g, J/kg
    VELOCITY,  # C_r, m/s
    ENTHALPY,  # of the gas at flame temperature, J/kg
    BACK_PRESSURE,  # p_c0, Pa
    SIMPLIFIED,  # 1: eq. 8
    ARM,  # L1, m
    HOLE,  # d/2, m
    OPENING,  # D/2, m
    HALF_WIDTH,  # b/2, m
    LOOPS_PER_STEP,
    THROAT_SHARE,  # share of A_t that is open
    BURNING_SHARE,  # share of A_b that burns
    RATE_SHARE,  # of r
    HEAT_SHARE,  # factor on the gas temperature; C_r is proportional to its square root
    LEAK_AREA,  # m^2, beside the throat
    HIDING,  # 1: an effect is injected
    HIDDEN,  # from here on: parameters of the effects
) = range(21)
PARAMETER_SIZE = HIDDEN + hidden.HIDDEN_SIZE

_GAMMA = 1.0 - math.sqrt(0.5)


@inlined
def conditions(y: Vector, g: Vector) -> tuple[float, float, float, float, float]:
    """Return the factors on throat, burning area, burning rate and heat, and the leak, m^2."""
    throat, burning, rate, heat, leak = (
        g[THROAT_SHARE],
        g[BURNING_SHARE],
        g[RATE_SHARE],
        g[HEAT_SHARE],
        g[LEAK_AREA],
    )
    if g[HIDING] == 0.0:
        return throat, burning, rate, heat, leak
    web, at = y[MEMORY + hidden.WEB], HIDDEN
    heat *= 1.0 - y[MEMORY + hidden.COOLED]
    leak += g[at + hidden.LEAK]
    # The gas leaves the burning surface at the speed at which the outflow passes the cross-section
    # of the chamber.
    speed = (
        (y[THROAT] * throat + leak) * g[ENERGY] * math.sqrt(heat) / (g[VELOCITY] * g[BURNING_AREA])
    )
    throat *= hidden.open_share(y[BURN_TIME], g, at)
    burning *= hidden.burning_share(web, g, at)
    rate *= hidden.rate_share(y[BURN_TIME], web, speed, g, at)
    return throat, burning, rate, heat, leak


@inlined
def remember(y: Vector, g: Vector, grown: float, burning_area: float, h: float) -> None:
    """Update the states of the effects after ``h`` s in which ``grown`` m^3 burnt."""
    web, cooled, warmed = MEMORY + hidden.WEB, MEMORY + hidden.COOLED, MEMORY + hidden.WARMED
    y[web] += grown / burning_area
    if g[HIDDEN + hidden.HEAT_FLOW] > 0.0:
        burnt = g[DENSITY] * grown / h
        y[cooled], y[warmed] = hidden.cool(
            y[cooled], y[warmed], burnt, y[MASS], g[ENTHALPY], h, g, HIDDEN
        )


@inlined
def solve_stage(
    mass: float,
    volume: float,
    h: float,
    grown: float,
    flow: float,
    energy: float,
    guess: float,
    g: Vector,
) -> tuple[float, float]:
    """Solve an implicit stage: a step of ``h`` s from ``mass`` and ``volume``, with the rates at
    the end of the step.

    (V + h q) p / RT = m + h (rho_b q - flow p) with q = grown p^n; eq. 8 has no term h q on the
    left. The difference of both sides is convex in p and negative at 0, so that it has one positive
    root, to which Newton's method converges from above.

    Args:
        mass: Mass, positive, kg.
        volume: Volume, m^3.
        h: Step, s.
        grown: Volume rate divided by p^n.
        flow: Mass rate divided by p.
        energy: Specific energy RT, J/kg.
        guess: Initial guess of the pressure, Pa.
        g: Parameters.

    Returns:
        Pressure, Pa; volume rate, m^3/s.
    """
    p, n, supply = guess, g[EXPONENT], g[DENSITY]
    exact = 0.0 if g[SIMPLIFIED] != 0.0 else 1.0 / energy
    linear = volume / energy + h * flow
    rate = slope = 0.0
    for _ in range(60):
        rate = grown * p**n
        slope = n * rate / p
        steepness = linear + h * (exact * (rate + p * slope) - supply * slope)
        if steepness <= 0.0:
            p *= 2.0
            continue
        change = (linear * p + h * rate * (exact * p - supply) - mass) / steepness
        change = min(change, 0.5 * p)
        p -= change
        rate -= slope * change
        if (
            abs(change) <= 1e-8 * p
        ):  # Newton's method converges quadratically: the remaining error is below rounding.
            break
    return p, rate


@inlined
def step_gas(y: Vector, g: Vector, angle: float, h: float) -> None:
    """Advance by ``h`` s while the throat area changes to that at ``angle`` (rad)."""
    throat_share, burning_share, rate_share, heat_share, leak = conditions(y, g)
    energy, velocity = g[ENERGY] * heat_share, g[VELOCITY] * math.sqrt(heat_share)
    grown = g[BURNING_AREA] * burning_share * g[RATE] * rate_share
    grows = hidden.layer(y[BURN_TIME] + h, g, HIDDEN)
    before, after = (
        y[THROAT],
        open_throat(angle, g[ARM], g[HOLE] - grows, g[OPENING] - grows, g[HALF_WIDTH]),
    )
    mass, volume, pressure = y[MASS], y[VOLUME], y[PRESSURE]
    made = 1.0 / energy if g[SIMPLIFIED] != 0.0 else 0.0
    early = (throat_share * (before + _GAMMA * (after - before)) + leak) / velocity
    late = (throat_share * after + leak) / velocity
    p1, q1 = solve_stage(mass, volume, _GAMMA * h, grown, early, energy, pressure, g)
    first = 1.0 - _GAMMA
    base = mass + first * h * ((g[DENSITY] + made * p1) * q1 - early * p1)
    # If the step is far longer than the settling time, the second stage would start below zero; one
    # implicit Euler step then replaces the two stages.
    share = first if base > 0.0 else 0.0
    base = base if base > 0.0 else mass
    p2, q2 = solve_stage(
        base, volume + share * h * q1, (1.0 - share) * h, grown, late, energy, p1, g
    )
    burnt = h * (share * q1 + (1.0 - share) * q2)
    out = h * (share * early * p1 + (1.0 - share) * late * p2)
    y[BURN_TIME] += h
    y[BURNT] += g[DENSITY] * burnt
    y[OUTFLOW] += out
    y[MASS] += g[DENSITY] * burnt - out + made * h * (share * p1 * q1 + (1.0 - share) * p2 * q2)
    y[VOLUME] += burnt
    y[PRESSURE] = y[MASS] * energy / y[VOLUME]
    y[THROAT] = after
    y[FORCE] = contact_force(y[PRESSURE], after, g)
    if g[HIDING] != 0.0:
        remember(y, g, burnt, g[BURNING_AREA] * burning_share, h)


@inlined
def contact_force(pressure: float, throat: float, g: Vector) -> float:
    """Return the contact force F_P = (p_g - p_c0) A_s (eq. 10), N, or zero if p_g is below p_c0."""
    return float(
        max(pressure - g[BACK_PRESSURE], 0.0) * (math.pi * g[OPENING] * g[OPENING] - throat)
    )


@inlined
def settled_pressure(throat: float, g: Vector) -> float:
    """Return the pressure at which the generator burns steadily, Pa.

    With eq. 8 this pressure is (rho_b A_b a C_r / A_t)^(1/(1-n)); with eq. 7 it is the slightly
    lower root of (rho_b - p/RT) A_b a p^n = p A_t / C_r.
    """
    n = g[EXPONENT]
    energy, velocity = g[ENERGY] * g[HEAT_SHARE], g[VELOCITY] * math.sqrt(g[HEAT_SHARE])
    grown = g[BURNING_AREA] * g[BURNING_SHARE] * g[RATE] * g[RATE_SHARE]
    flow = (throat * g[THROAT_SHARE] + g[LEAK_AREA]) / velocity
    p = float((g[DENSITY] * grown / flow) ** (1.0 / (1.0 - n)))
    if g[SIMPLIFIED] != 0.0:
        return p
    for _ in range(60):
        # The equation divided by p^n is flow p^(1-n) + grown p / RT = rho_b grown.
        power = flow * p ** (1.0 - n)
        change = (power + grown * (p / energy - g[DENSITY])) / (
            (1.0 - n) * power / p + grown / energy
        )
        p -= min(change, 0.5 * p)
        if abs(change) <= 1e-14 * p:
            break
    return p


HEAT_RATIO = 1.25  # specific-heat ratio of the gas


def gas_vector(machine: constants.Machine) -> Vector:
    """Pack the gas generator and valve of a machine; L1 is the joint's moment arm."""
    generator, valve = machine.gas, machine.gas.valve
    g = np.zeros(PARAMETER_SIZE)
    g[DENSITY] = generator.propellant_density_kg_m3
    g[BURNING_AREA] = 0.25 * math.pi * generator.chamber_diameter_m**2
    g[RATE] = 1e-3 * generator.burning_rate_mm_s * 1e-6**generator.pressure_exponent
    g[EXPONENT] = generator.pressure_exponent
    g[ENERGY] = generator.energy_J_kg
    g[ENTHALPY] = HEAT_RATIO / (HEAT_RATIO - 1.0) * generator.energy_J_kg
    g[VELOCITY] = generator.characteristic_velocity_m_s
    g[BACK_PRESSURE] = generator.back_pressure_Pa
    g[SIMPLIFIED] = float(generator.equation == 8)
    g[ARM] = machine.joint.moment_arm_m
    g[HOLE] = 0.5 * valve.hole_diameter_m
    g[OPENING] = 0.5 * valve.opening_diameter_m
    g[HALF_WIDTH] = 0.5 * valve.plate_width_m
    g[LOOPS_PER_STEP] = generator.loops_per_step
    g[THROAT_SHARE] = g[BURNING_SHARE] = g[RATE_SHARE] = g[HEAT_SHARE] = 1.0
    hides = GAS_KNOWN.keys() & machine.effects.keys()
    for name in hides:
        for key, value in machine.effects[name].items():
            g[HIDDEN + GAS_KNOWN[name][key].slot] = value
    g[HIDING] = float(bool(hides))
    return g


def unlit(machine: constants.Machine) -> Vector:
    """Return the state without combustion: no gas, and the pressure downstream of the valve."""
    y = np.zeros(GAS_SIZE)
    y[PRESSURE] = machine.gas.back_pressure_Pa
    return y


def lit(
    machine: constants.Machine, g: Vector, angle_rad: float, pressure_Pa: float | None = None
) -> Vector:
    """Return the state at ignition.

    Args:
        machine: The machine with the gas generator.
        g: Vector of the gas generator.
        angle_rad: Valve angle, rad.
        pressure_Pa: Pressure at the start, or None for the steady pressure at this angle.
    """
    y = np.zeros(GAS_SIZE)
    y[THROAT] = valve_throat(g, np.array([angle_rad]))[0]
    y[PRESSURE] = (
        steady_pressures(g, y[THROAT : THROAT + 1])[0] if pressure_Pa is None else pressure_Pa
    )
    y[VOLUME] = machine.gas.free_volume_m3
    burnt = g[DENSITY] * g[BURNING_AREA] * g[RATE] * y[PRESSURE] ** g[EXPONENT]
    cooled = hidden.settled_chill(burnt, g[ENTHALPY], g, HIDDEN)
    y[MEMORY + hidden.COOLED] = cooled
    y[MASS] = y[PRESSURE] * y[VOLUME] / (g[ENERGY] * g[HEAT_SHARE] * (1.0 - cooled))
    y[FORCE] = contact_force(y[PRESSURE], y[THROAT], g)
    return y


@compiled
def valve_throat(g: Vector, angle: Vector) -> Vector:
    """Return A_t at each valve angle (rad), m^2, shape (n,)."""
    out = np.empty_like(angle)
    for k in range(len(angle)):
        out[k] = open_throat(angle[k], g[ARM], g[HOLE], g[OPENING], g[HALF_WIDTH])
    return out


@compiled
def steady_pressures(g: Vector, throat: Vector) -> Vector:
    """Return the steady pressure at each throat area (m^2), Pa, shape (n,)."""
    out = np.empty_like(throat)
    for k in range(len(throat)):
        out[k] = settled_pressure(throat[k], g)
    return out


class Burn(NamedTuple):
    """A simulated firing, sampled at the times of its valve angles; arrays of shape (n,).

    ``burnt`` and ``outflow`` are counted from the first sample.
    """

    pressure_Pa: Vector
    throat_m2: Vector
    contact_force_N: Vector
    free_volume_m3: Vector
    stored_kg: Vector
    burnt_kg: Vector
    outflow_kg: Vector


def burn(
    machine: constants.Machine,
    angle_rad: Vector,
    period_s: float,
    steps: int = 1,
    pressure_Pa: float | None = None,
) -> Burn:
    """Simulate a firing while the valve follows given angles, with linear interpolation between
    samples.

    Args:
        machine: The machine with the gas generator.
        angle_rad: Valve angles, rad, shape (n,).
        period_s: Sampling period, s.
        steps: Integration steps per sample.
        pressure_Pa: Pressure at the start, or None for the steady pressure at the first angle.
    """
    g = gas_vector(machine)
    y = lit(machine, g, float(angle_rad[0]), pressure_Pa)
    out = np.zeros((len(angle_rad), GAS_SIZE))
    _follow(y, g, np.ascontiguousarray(angle_rad, dtype=np.float64), period_s, steps, out)
    return Burn(
        out[:, PRESSURE],
        out[:, THROAT],
        out[:, FORCE],
        out[:, VOLUME],
        out[:, MASS],
        out[:, BURNT],
        out[:, OUTFLOW],
    )


def throat_area(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the effective throat area A_t at each valve angle, m^2, shape (n,)."""
    return valve_throat(gas_vector(machine), np.ascontiguousarray(angle_rad, dtype=np.float64))


def impacted_area(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the impacted area A_s = pi D^2/4 - A_t at each valve angle, m^2, shape (n,)."""
    opening = 0.25 * np.pi * machine.gas.valve.opening_diameter_m**2
    return np.asarray(opening - throat_area(machine, angle_rad))


def steady_pressure(machine: constants.Machine, angle_rad: Vector) -> Vector:
    """Return the pressure of steady burning at each valve angle, Pa, shape (n,)."""
    return steady_pressures(gas_vector(machine), throat_area(machine, angle_rad))


@compiled
def _follow(
    y: Vector, g: Vector, angle: Vector, period: float, steps: int, out: NDArray[np.float64]
) -> None:
    out[0] = y
    for k in range(1, len(angle)):
        for j in range(1, steps + 1):
            step_gas(y, g, angle[k - 1] + (angle[k] - angle[k - 1]) * j / steps, period / steps)
        out[k] = y


REFERENCE_FORCE_N = 3000.0
"""Contact force at which the injected effect ``load_exponent`` has no effect."""


@compiled
def felt_force(force: float, e: Vector) -> float:
    """Return the effective contact force, to which friction is proportional, N.

    With the injected effect ``load_exponent``, the effective force is a power of the contact force
    ``force``, equal to ``force`` at the reference force. Without this effect it is equal to
    ``force``.
    """
    if e[table.LOAD_EXPONENT] > 0.0 and force > 0.0:
        return float(REFERENCE_FORCE_N * (force / REFERENCE_FORCE_N) ** e[table.LOAD_EXPONENT])
    return force


@compiled
def advance_loaded(
    loops: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    y: Vector,
    g: Vector,
    noise: Vector,
    path: Vector,
) -> None:
    """Advance ``loops`` drive-loop periods; the arguments are those of the kernels of machine and
    gas generator, of which ``y`` and ``g`` belong to the gas generator.

    In each gas step the contact force is that at the start of the step; at 50 deg/s the force
    changes by 0.5 N in 100 microseconds. Steps are counted from ignition, so that the result does
    not depend on how the time is divided among calls.
    """
    burns = y[MASS] > 0.0
    done = 0
    while done < loops:
        n = min(int(g[LOOPS_PER_STEP] - y[PENDING]), loops - done) if burns else loops
        if burns:
            p[MOMENT] = felt_force(y[FORCE], e) * g[ARM]
        part = path[done : done + n]
        advance(n, s, x, histories, d, p, e, noise[done : done + n], part)
        done += n
        if burns:
            y[PENDING] += n
            if y[PENDING] >= g[LOOPS_PER_STEP]:
                step_gas(y, g, x[JOINT], y[PENDING] * d[LOOP_S])
                y[PENDING] = 0.0
