"""Gains of a position loop that the host closes over the bus, from joint inertia and bus delay.

A host that sends a torque with every cycle can close a position loop around the joint: K (commanded
- measured angle) + D (commanded - measured speed). For a bare inertia J and a delay tau from
measurement to effect, the open loop is L(s) = (K + D s) exp(-tau s) / (J s^2). With K = J omega^2
sin(delta), D = J omega cos(delta) the gain of the open loop is exactly one at omega, and the phase
margin is 90 deg - delta - omega tau. The crossover omega is the frequency at which the delay causes
a phase lag of 45 deg, and delta is 10 deg; the phase margin is then 35 deg and the gain margin 5.6
dB. The drive's own loops and viscous friction increase the phase margin; the lag of a current loop
reduces the phase margin (by 6 deg at 0.26 ms and 1 kHz).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

DELAY_CYCLES = 2.0
"""Delay in control cycles, from the middle of the interval over which the speed is measured to the
middle of the interval in which the torque acts.
"""
LAG_RAD = math.pi / 4.0
"""Phase lag of the open loop due to the delay, at the crossover."""
DELTA_RAD = math.pi / 18.0
"""Phase lag delta of the open loop due to the stiffness, at the crossover."""


@dataclass(frozen=True)
class Gains:
    """Stiffness and damping that a host adds at the joint.

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
