"""Simulates whole recordings of machine and drive in one call of compiled code, without the bus."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.burning import advance_loaded
from drivers.mock.plant.effects.sensing import Histories
from drivers.mock.plant.effects.state import RUN, SEEN, SUPPLY
from drivers.mock.plant.gas import PRESSURE
from drivers.mock.plant.parts.compiled import Vector, compiled
from drivers.mock.plant.parts.loops import (
    LOOP_S,
    MEASURED,
    SUM_CURRENT,
    SUM_LOOPS,
    SUM_NOISE,
    SUM_VOLTAGE,
    TARGET,
    TARGET_LEFT,
    TARGET_STEP,
    THETA,
    VELOCITY_ESTIMATE,
)

# Columns of the latched values.
(
    ROTOR,
    JOINT_SEEN,
    SPEED,
    MEAN_CURRENT,
    MEAN_VOLTAGE,
    LINK_VOLTAGE,
    FOLLOWING,
    RUN_TIME,
    CHAMBER_PRESSURE,
    LATCHED,
) = range(10)


class Latches(NamedTuple):
    """Values of drive and joint encoder at each SYNC before conversion to device units; arrays of
    shape (n,).

    ``current_A`` and ``voltage_V`` are means over the cycle that ends at the SYNC; ``run_s`` is the
    running time of the machine. ``pressure_Pa`` is exact; while no gas generator burns, it is the
    pressure downstream of the valve.
    """

    motor_counts: NDArray[np.float64]
    joint_counts: NDArray[np.float64]
    joint_velocity_rad_s: NDArray[np.float64]
    current_A: NDArray[np.float64]
    voltage_V: NDArray[np.float64]
    supply_V: NDArray[np.float64]
    following_rad: NDArray[np.float64]
    run_s: NDArray[np.float64]
    pressure_Pa: NDArray[np.float64]


@compiled
def record_cycles(
    loops_per_cycle: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    y: Vector,
    g: Vector,
    noise: Vector,
    targets: Vector,
    no_path: Vector,
    out: Histories,
) -> None:
    """Run one cycle for each joint angle of ``targets``: advance, sample, set the target.

    As with a bus, the target that is sent with a SYNC is reached by interpolation one cycle later.
    """
    for k in range(len(targets)):
        part = noise[k * loops_per_cycle : (k + 1) * loops_per_cycle]
        advance_loaded(loops_per_cycle, s, x, histories, d, p, e, y, g, part, no_path)
        n = s[SUM_LOOPS]
        seconds = n * d[LOOP_S]
        row = out[k]
        row[ROTOR] = s[THETA]
        row[JOINT_SEEN] = x[SEEN]
        row[SPEED] = s[VELOCITY_ESTIMATE]
        row[MEAN_CURRENT] = s[SUM_CURRENT] / seconds + s[SUM_NOISE] / n
        row[MEAN_VOLTAGE] = s[SUM_VOLTAGE] / seconds
        row[LINK_VOLTAGE] = x[SUPPLY]
        row[FOLLOWING] = s[TARGET] - s[MEASURED]
        row[RUN_TIME] = x[RUN]
        row[CHAMBER_PRESSURE] = y[PRESSURE]
        s[SUM_CURRENT] = s[SUM_VOLTAGE] = s[SUM_NOISE] = s[SUM_LOOPS] = 0.0
        s[TARGET_LEFT] = loops_per_cycle
        s[TARGET_STEP] = (targets[k] - s[TARGET]) / loops_per_cycle
