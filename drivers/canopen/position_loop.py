"""Position loop in this program, for drives that accept only a speed or a torque, as pure
functions.

The loop is a cascade as in a drive: a P controller of the position with feed-forward of the
commanded speed and, for a torque command, a PI controller of the speed. All values are at the
joint, in SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from drivers.errors import ConfigurationError

FASTEST_1_S: Final = 60.0
"""Greatest position gain that is derived from the cycle time, 1/s; common drives have this gain."""
GAIN_CYCLES: Final = 0.06
"""Product of position gain and cycle time for a derived gain. A sample is two cycles old when the
command computed from it acts, so that the delay reduces the phase margin by 0.12 rad (7 deg).
"""
SPEED_CYCLES: Final = 0.15
"""Product of speed-loop bandwidth and cycle time for a derived gain; the delay reduces the phase
margin by 0.3 rad (17 deg).
"""
RATIO: Final = 0.4
"""Greatest ratio of a derived position gain to the bandwidth of the speed loop."""


@dataclass(frozen=True)
class LoopGains:
    """Gains of the position loop and the speed loop.

    Attributes:
        position_1_s: Speed command per position error, 1/s.
        speed_N_m_s_rad: Torque command per speed error, N m s/rad; 0 for a drive that is commanded
            by a speed.
        reset_1_s: Inverse reset time of the speed loop, 1/s.
    """

    position_1_s: float
    speed_N_m_s_rad: float = 0.0
    reset_1_s: float = 0.0


@dataclass(frozen=True)
class LoopLimits:
    """Limits of the command that the loop computes.

    Attributes:
        angle_min_rad: Lower end of the range of the joint angle.
        angle_max_rad: Upper end of this range.
        speed_rad_s: Greatest speed.
        torque_N_m: Greatest torque.
        deceleration_rad_s2: Deceleration with which the joint stops before an end of the range.
    """

    angle_min_rad: float
    angle_max_rad: float
    speed_rad_s: float
    torque_N_m: float
    deceleration_rad_s2: float


class LoopState(NamedTuple):
    """State of the loop: the last target, rad (NaN without a target), and the integral of the speed
    controller, N m.
    """

    target_rad: float = math.nan
    integral_N_m: float = 0.0


AT_REST: Final = LoopState()


def derived(
    cycle_s: float, inertia_kg_m2: float | None, wanted: LoopGains | None = None
) -> LoopGains:
    """Return the gains for a cycle time; gains in ``wanted`` that are not 0 are kept.

    Args:
        cycle_s: Control cycle, s.
        inertia_kg_m2: Inertia at the joint, or None for a drive that is commanded by a speed.
        wanted: Gains that the bench file states, 0 for each gain that it does not state.
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

    The commands do not move the joint beyond an end of the angle range: near an end, the speed
    command is limited to a speed from which the joint can still stop before the end. A torque that
    would increase a speed above the speed limit is replaced by 0.

    Args:
        state: State after the last cycle.
        gains: Gains; without a speed gain the torque command is 0.
        limits: Limits of the commands.
        cycle_s: Control cycle, s.
        target_rad: Joint angle to follow.
        angle_rad: Joint angle as last measured.
        speed_rad_s: Joint speed as last measured.

    Raises:
        ConfigurationError: A value is not finite.
    """
    if not math.isfinite(target_rad + angle_rad + speed_rad_s):
        raise ConfigurationError(
            f"the inputs of the position loop are target {target_rad:g} rad, angle "
            f"{angle_rad:g} rad and speed {speed_rad_s:g} rad/s, but all must be finite; check the "
            "drive's process data"
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
        integral = state.integral_N_m  # anti-windup: no further integration at the torque limit
    if abs(speed_rad_s) > limits.speed_rad_s and torque * speed_rad_s > 0.0:
        torque = 0.0
    return LoopState(target_rad, integral), speed, torque


def _stopping(distance_rad: float, limits: LoopLimits) -> float:
    """Return the greatest speed toward an end of the angle range at this distance from it,
    rad/s.
    """
    if distance_rad <= 0.0:
        return 0.0
    return min(limits.speed_rad_s, math.sqrt(2.0 * limits.deceleration_rad_s2 * distance_rad))
