"""Injected effects outside the catalogue, which a diagnosis must locate and not identify."""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.mock.plant.effects.table import CATALOGUE_SIZE, Parameter
from drivers.mock.plant.parts.compiled import Vector, inlined

(
    TIMED_TORQUE,
    TIMED_FREQUENCY,
    TIMED_PHASE,
    ACCELERATION_DRAG,
    QUADRANT_TORQUE,
    WELL_TORQUE,
    WELL_CENTER,
    WELL_WIDTH,
    TRAVEL_TORQUE,
    TRAVEL_LENGTH,
    ROOT_DRAG,
    BURST_TORQUE,
    BURST_PERIOD,
    BURST_LENGTH,
    RESONANCE_TORQUE,
    RESONANCE_SPEED,
    RESONANCE_WIDTH,
    ONE_WAY_TORQUE,
    ONE_WAY_CENTER,
    ONE_WAY_WIDTH,
    SWITCHING_TORQUE,
    SWITCHING_PERIOD,
    WANDERING_TORQUE,
    WANDERING_PERIOD,
    LOADED_DRAG,
    OUTSIDE_END,
) = range(CATALOGUE_SIZE, CATALOGUE_SIZE + 26)

OUTSIDE: Mapping[str, Mapping[str, Parameter]] = {
    "x_timed_torque": {
        "torque_Nm": Parameter(TIMED_TORQUE, 0.0, 20.0),
        "frequency_Hz": Parameter(TIMED_FREQUENCY, 0.01, 500.0),
        "phase_rad": Parameter(TIMED_PHASE, -6.3, 6.3),
    },
    "x_acceleration_drag": {"coefficient_Nms2_rad": Parameter(ACCELERATION_DRAG, 0.0, 0.15)},
    "x_quadrant_friction": {"torque_Nm": Parameter(QUADRANT_TORQUE, -10.0, 10.0)},
    "x_two_wells": {
        "torque_Nm": Parameter(WELL_TORQUE, 0.0, 20.0),
        "center_rad": Parameter(WELL_CENTER, 0.0, 3.2),
        "width_rad": Parameter(WELL_WIDTH, 1e-3, 1.0),
    },
    "x_travel_memory": {
        "torque_Nm": Parameter(TRAVEL_TORQUE, 0.0, 20.0),
        "travel_rad": Parameter(TRAVEL_LENGTH, 0.01, 10.0),
    },
    "x_root_drag": {"coefficient_Nms05_rad05": Parameter(ROOT_DRAG, 0.0, 20.0)},
    "x_bursts": {
        "torque_Nm": Parameter(BURST_TORQUE, 0.0, 20.0),
        "period_s": Parameter(BURST_PERIOD, 0.05, 100.0),
        "length_s": Parameter(BURST_LENGTH, 1e-3, 10.0),
    },
    "x_speed_resonance": {
        "torque_Nm": Parameter(RESONANCE_TORQUE, 0.0, 20.0),
        "speed_rad_s": Parameter(RESONANCE_SPEED, 0.01, 10.0),
        "width_rad_s": Parameter(RESONANCE_WIDTH, 0.005, 5.0),
    },
    "x_one_way_patch": {
        "torque_Nm": Parameter(ONE_WAY_TORQUE, 0.0, 20.0),
        "center_rad": Parameter(ONE_WAY_CENTER, -3.2, 3.2),
        "width_rad": Parameter(ONE_WAY_WIDTH, 1e-3, 3.2),
    },
    "x_switching_torque": {
        "torque_Nm": Parameter(SWITCHING_TORQUE, 0.0, 20.0),
        "period_s": Parameter(SWITCHING_PERIOD, 0.05, 100.0),
    },
    "x_wandering_torque": {
        "torque_Nm": Parameter(WANDERING_TORQUE, 0.0, 20.0),
        "period_s": Parameter(WANDERING_PERIOD, 0.05, 100.0),
    },
    "x_loaded_drag": {"coefficient_s2_rad2": Parameter(LOADED_DRAG, 0.0, 2.0)},
}
"""Slot and range of each parameter of each effect."""

_ROOT_FLOOR = 1e-4  # speed, rad/s, below which the drag is linear, so that its slope is finite


@inlined
def scatter(number: float) -> float:
    """Return a pseudo-random number in [0, 1) that depends only on the integer ``number``."""
    x = math.sin(12.9898 * number + 4.1414) * 43758.5453
    return x - math.floor(x)


@inlined
def outside_torque(run: float, theta: float, travel: float, e: Vector) -> float:
    """Return the torque, N m, at a running time, s, an angle, rad, and a travel state -1 to 1."""
    torque = 0.0
    if e[TIMED_TORQUE] != 0.0:
        torque += e[TIMED_TORQUE] * math.sin(
            2.0 * math.pi * e[TIMED_FREQUENCY] * run + e[TIMED_PHASE]
        )
    if e[WELL_TORQUE] != 0.0:
        for side in (-1.0, 1.0):
            u = (theta - side * e[WELL_CENTER]) / e[WELL_WIDTH]
            torque -= e[WELL_TORQUE] * u * math.exp(0.5 - 0.5 * u * u)
    if e[TRAVEL_TORQUE] != 0.0:
        torque -= e[TRAVEL_TORQUE] * travel
    if e[BURST_TORQUE] != 0.0:
        slot = math.floor(run / e[BURST_PERIOD])
        begin = scatter(slot) * max(e[BURST_PERIOD] - e[BURST_LENGTH], 0.0)
        if 0.0 <= run - slot * e[BURST_PERIOD] - begin < e[BURST_LENGTH]:
            torque += e[BURST_TORQUE] * (1.0 if scatter(slot + 0.5) > 0.5 else -1.0)
    if e[SWITCHING_TORQUE] != 0.0 and scatter(math.floor(run / e[SWITCHING_PERIOD])) > 0.5:
        torque += e[SWITCHING_TORQUE]
    if e[WANDERING_TORQUE] != 0.0:
        at = run / e[WANDERING_PERIOD]
        slot = math.floor(at)
        u = at - slot
        u = u * u * (3.0 - 2.0 * u)
        torque += e[WANDERING_TORQUE] * (
            (2.0 * scatter(slot) - 1.0) * (1.0 - u) + (2.0 * scatter(slot + 1.0) - 1.0) * u
        )
    return torque


@inlined
def outside_level(speed: float, moment: float, e: Vector) -> tuple[float, float]:
    """Return extra friction at ``speed`` >= 0 rad/s under a load moment in N m, and its slope."""
    magnitude = slope = 0.0
    if e[ROOT_DRAG] != 0.0:
        root = math.sqrt(speed + _ROOT_FLOOR)
        magnitude += e[ROOT_DRAG] * (root - math.sqrt(_ROOT_FLOOR))
        slope += 0.5 * e[ROOT_DRAG] / root
    if e[RESONANCE_TORQUE] != 0.0:
        u = (speed - e[RESONANCE_SPEED]) / e[RESONANCE_WIDTH]
        bump = e[RESONANCE_TORQUE] * math.exp(-0.5 * u * u)
        magnitude += bump
        slope -= bump * u / e[RESONANCE_WIDTH]
    if e[LOADED_DRAG] != 0.0:
        magnitude += moment * e[LOADED_DRAG] * speed * speed
        slope += 2.0 * moment * e[LOADED_DRAG] * speed
    return magnitude, slope


@inlined
def outside_sides(theta: float, acceleration: float, e: Vector) -> tuple[float, float]:
    """Return extra Coulomb friction, N m, for both directions, and its asymmetry."""
    both = one = 0.0
    if e[ACCELERATION_DRAG] != 0.0:
        both += e[ACCELERATION_DRAG] * abs(acceleration)
    if e[QUADRANT_TORQUE] != 0.0:
        one += math.copysign(e[QUADRANT_TORQUE], e[QUADRANT_TORQUE] * theta)
    if e[ONE_WAY_TORQUE] != 0.0:
        u = (theta - e[ONE_WAY_CENTER]) / e[ONE_WAY_WIDTH]
        half = 0.5 * e[ONE_WAY_TORQUE] * math.exp(-0.5 * u * u)
        both += half
        one += half
    return both, one
