"""Stiffness and damping that a host may add over a bus, from the joint's inertia and the delay of
the bus.

A host that sends a torque with every cycle closes a loop of its own around the joint: K (commanded
- measured angle) + D (commanded - measured speed). With the joint a bare inertia J and tau the
delay from measurement to effect, it is L(s) = (K + D s) exp(-tau s) / (J s^2). With

    K = J omega^2 sin(delta),    D = J omega cos(delta)

its gain is exactly one at omega, and its phase margin 90 deg - delta - omega tau. The crossover
omega is where the delay takes 45 deg, and delta is 10 deg, so 35 deg are left, and 5.6 dB of gain.
A drive's own loops and viscous friction add to it; the lag of a current loop takes from it (6 deg
at 0.26 ms and 1 kHz).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

DELAY_CYCLES = 2.0
"""From the middle of the interval whose speed is measured to that of the one in which the torque
acts.
"""
LAG_RAD = math.pi / 4.0
"""Phase that this delay may take at the crossover."""
DELTA_RAD = math.pi / 18.0
"""Phase that stiffness may take there."""


@dataclass(frozen=True)
class Gains:
    """What a host adds at the joint.

    Attributes:
        stiffness: K, N m/rad.
        damping: D, N m s/rad.
    """

    stiffness: float
    damping: float


def gains(inertia: float, period: float) -> Gains:
    """Return stiffness and damping for an inertia in kg m^2 and a control cycle in s."""
    crossover = LAG_RAD / (DELAY_CYCLES * period)
    return Gains(
        inertia * crossover**2 * math.sin(DELTA_RAD), inertia * crossover * math.cos(DELTA_RAD)
    )
