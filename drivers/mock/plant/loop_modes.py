"""Opens the position and velocity loop of the simulated drive for speed and torque mode, and closes
them again in motion.

``s`` is the state vector of the machine, ``d`` the vector of its drive and motor constants, indexed
as in :mod:`drivers.mock.plant.parts.loops`.
"""

from __future__ import annotations

import math

from drivers.mock.plant.parts import loops
from drivers.mock.plant.parts.compiled import Vector
from drivers.mock.plant.parts.constants import Loops


def close_loops(d: Vector, cascade: Loops, position: bool, speed: bool) -> None:
    """Close position and speed loop, or open them."""
    d[loops.POSITION_GAIN] = cascade.position_gain if position else 0.0
    d[loops.VELOCITY_GAIN] = (cascade.velocity_gain_N_m_s_rad or 0.0) if speed else 0.0
    d[loops.FEEDFORWARD] = cascade.velocity_feedforward if position else 1.0


def spin(s: Vector, d: Vector, speed_rad_s: float) -> None:
    """Command a joint speed until the next command; the position loop stays open."""
    if s[loops.MODE] != loops.OFF:
        s[loops.MODE] = loops.TRACK
        s[loops.TARGET_LEFT] = math.inf
        s[loops.TARGET_STEP] = speed_rad_s * d[loops.LOOP_S]


def take_over(s: Vector, d: Vector, cascade: Loops) -> bool:
    """Close all loops of a drive in motion, at its present position and speed; return whether a
    loop was open.
    """
    if d[loops.POSITION_GAIN] == cascade.position_gain:
        return False
    s[loops.TARGET] = s[loops.MEASURED]
    if d[loops.VELOCITY_GAIN] == 0.0:
        s[loops.TARGET_STEP] = s[loops.VELOCITY_ESTIMATE] * d[loops.LOOP_S]
        s[loops.VELOCITY_INTEGRAL] = 0.0
    close_loops(d, cascade, position=True, speed=True)
    return True
