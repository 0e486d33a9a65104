"""Position loop in this program, for drives that accept only a speed or a torque. Pure functions.

The loop is a cascade as in a drive: position P with feed-forward of the commanded speed and, for a
torque command, speed PI. All values are at the joint, in SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from drivers.errors import ConfigurationError

FASTEST_1_S: Final = 60.0
"""Greatest derived position gain, 1/s; common drives have this gain."""
GAIN_CYCLES: Final = 0.06
"""Product of position gain and cycle for a derived gain. A sample is two cycles old when its
command acts, so that the loop loses 0.12 rad (7 deg) of phase at its own frequency.
"""
SPEED_CYCLES: Final = 0.15
"""Product of speed-loop bandwidth and cycle for a derived gain; the loop loses 0.3 rad (17 deg) of
phase.
"""
RATIO: Final = 0.4
"""Greatest ratio of a derived position gain to the bandwidth of the speed loop."""


@dataclass(frozen=True)
class LoopGains:
    """Gains of the position loop and the speed loop.

    Attributes:
        position_1_s: Speed command per position error.
        speed_N_m_s_rad: Torque command per speed error; 0 for a drive that takes a speed.
        reset_1_s: Inverse reset time of the speed loop.
    """

    position_1_s: float
    speed_N_m_s_rad: float = 0.0
    reset_1_s: float = 0.0


@dataclass(frozen=True)
class LoopLimits:
    """Limits of the command that the loop computes.

    Attributes:
        angle_min_rad: Lower end of the joint angle.
        angle_max_rad: Upper end.
        speed_rad_s: Speed.
        torque_N_m: Torque.
        deceleration_rad_s2: Deceleration with which it stops in front of an end.
    """

    angle_min_rad: float
    angle_max_rad: float
    speed_rad_s: float
    torque_N_m: float
    deceleration_rad_s2: float


class LoopState(NamedTuple):
    """State of the loop: the last target, rad (NaN if there is none), and the integral, N m."""

    target_rad: float = math.nan
    integral_N_m: float = 0.0


AT_REST: Final = LoopState()


def derived(
    cycle_s: float, inertia_kg_m2: float | None, wanted: LoopGains | None = None
) -> LoopGains:
    """Return the gains for a cycle; gains of ``wanted`` that are not 0 are kept.

    Args:
        cycle_s: Control cycle, s.
        inertia_kg_m2: Inertia at the joint, or None for a drive that takes a speed.
        wanted: Gains that the bench file states, 0 for each that it leaves open.
    """
    stated = wanted or LoopGains(0.0)
    bandwidth_1_s = SPEED_CYCLES / cycle_s
    position = min(FASTEST_1_S, GAIN_CYCLES / cycle_s)
    if inertia_kg_m2 is None:
        return LoopGains(stated.position_1_s or position)
    speed = stated.speed_N_m_s_rad or inertia_kg_m2 * bandwidth_1_s
    if inertia_kg_m2 > 0.0:
        position = min(position, RATIO * speed / inertia_kg_m2)
    return LoopGains(stated.position_1_s or position, speed, stated.reset_1_s or position / 2.0)


def step(
    state: LoopState,
    gains: LoopGains,
    limits: LoopLimits,
    cycle_s: float,
    target_rad: float,
    angle_rad: float,
    speed_rad_s: float,
) -> tuple[LoopState, float, float]:
    """Return the new state, the speed command and the torque command of one cycle.

    Neither command leads beyond an end of the angle range: near an end, the speed command is
    limited to a speed from which the joint can still stop before the end. A torque that would raise
    a speed beyond its limit is 0.

    Args:
        state: From the last cycle.
        gains: Gains; without a speed gain the torque command is 0.
        limits: Limits.
        cycle_s: Control cycle, s.
        target_rad: Joint angle to follow.
        angle_rad: Joint angle as last measured.
        speed_rad_s: Joint speed as last measured.

    Raises:
        ConfigurationError: A value is not finite.
    """
    if not math.isfinite(target_rad + angle_rad + speed_rad_s):
        raise ConfigurationError(
            f"the position loop got target {target_rad:g} rad, angle {angle_rad:g} rad, speed "
            f"{speed_rad_s:g} rad/s: a value is missing; check the drive's process data"
        )
    ahead = 0.0 if math.isnan(state.target_rad) else (target_rad - state.target_rad) / cycle_s
    wanted = ahead + gains.position_1_s * (target_rad - angle_rad)
    up = _stopping(limits.angle_max_rad - angle_rad, limits)
    down = _stopping(angle_rad - limits.angle_min_rad, limits)
    speed = min(max(wanted, -down), up)
    if not gains.speed_N_m_s_rad:
        return LoopState(target_rad), speed, 0.0
    error = speed - speed_rad_s
    integral = state.integral_N_m + (gains.speed_N_m_s_rad * gains.reset_1_s * cycle_s * error)
    asked = gains.speed_N_m_s_rad * error + integral
    torque = min(max(asked, -limits.torque_N_m), limits.torque_N_m)
    if torque != asked and torque * error > 0.0:
        integral = state.integral_N_m  # not further into the limit
    if abs(speed_rad_s) > limits.speed_rad_s and torque * speed_rad_s > 0.0:
        torque = 0.0
    return LoopState(target_rad, integral), speed, torque


def _stopping(distance_rad: float, limits: LoopLimits) -> float:
    """Return the greatest speed towards an end of the angle range at this distance, rad/s."""
    if distance_rad <= 0.0:
        return 0.0
    return min(limits.speed_rad_s, math.sqrt(2.0 * limits.deceleration_rad_s2 * distance_rad))
