"""The pass at low amplitude that goes before a stage, under tighter limits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from rig.config.sequence import Array, FirstPass, StageSection, excitation
from rig.planning.limits import Limits

LONGEST_RAMP_SHARE = 0.25
"""Share of the pass that each of its ramps may take."""
GROWTH = 2.0
"""Factor of the amplitude from one pass to the next, where the joint has not moved: a soft drive
deflects by degrees before friction yields.
"""


@dataclass(frozen=True)
class PlannedPass:
    """A first pass, ready to run.

    Attributes:
        targets: Joint angles in rad, one a cycle, shape (n,).
        amplitude: Share of the stage's own amplitude.
        duration_s: s.
        move_limits: In force on the way to its start.
        limits: In force during the pass.
    """

    targets: Array
    amplitude: float
    duration_s: float
    move_limits: Limits
    limits: Limits


def plan_passes(
    section: StageSection, low: FirstPass, limits: Limits, cycle_s: float
) -> tuple[PlannedPass, ...]:
    """Compute the first pass of a stage, and the larger ones that follow while the joint does not
    move.
    """
    passes: list[PlannedPass] = []
    amplitude = low.amplitude
    while amplitude < 1.0:
        planned = _plan_pass(section, low, amplitude, limits, cycle_s)
        if passes and _peak_speed(planned.targets, cycle_s) > planned.limits.speed:
            break
        passes.append(planned)
        amplitude *= GROWTH
    return tuple(passes)


def _plan_pass(
    section: StageSection, low: FirstPass, amplitude: float, limits: Limits, cycle_s: float
) -> PlannedPass:
    """Compute one pass: the same tones about the same centre, smaller and shorter; a ramp at its
    speed over a shorter travel.
    """
    if section.ramp is not None:
        ramp = section.ramp.model_copy(
            update={"travel_deg": amplitude * section.ramp.travel_deg, "times": 1}
        )
        small = section.model_copy(update={"ramp": ramp, "duration_s": ramp.moving_s})
        return _judged(excitation(small, cycle_s), low, amplitude, limits, cycle_s)
    slowest_s = 1.0 / min(tone.frequency_Hz for tone in section.tones)
    wanted_s = low.duration_s or slowest_s + section.ramp_in_s + section.ramp_out_s
    duration_s = min(wanted_s, section.duration_s)
    ramp_s = LONGEST_RAMP_SHARE * duration_s
    small = section.model_copy(
        update={
            "tones": tuple(
                tone.model_copy(update={"amplitude_deg": amplitude * tone.amplitude_deg})
                for tone in section.tones
            ),
            "duration_s": duration_s,
            "ramp_in_s": min(section.ramp_in_s, ramp_s),
            "ramp_out_s": min(section.ramp_out_s, ramp_s),
        }
    )
    return _judged(excitation(small, cycle_s), low, amplitude, limits, cycle_s)


def _judged(
    targets: Array, low: FirstPass, amplitude: float, limits: Limits, cycle_s: float
) -> PlannedPass:
    """Put the limits of a first pass around its targets."""
    moving = _tighter(limits, low.limit_share)
    return PlannedPass(targets, amplitude, len(targets) * cycle_s, moving, _around(targets, moving))


def _peak_speed(targets: Array, cycle_s: float) -> float:
    return float(np.max(np.abs(np.diff(targets)), initial=0.0)) / cycle_s


def _tighter(limits: Limits, share: float) -> Limits:
    """Cut the limits.

    Static friction does not shrink with the amplitude, so those on torque are cut half as much. So
    is the following error, which measures torque on a soft drive.
    """
    torque_share = 0.5 * (1.0 + share)
    return dataclasses.replace(
        limits,
        speed=share * limits.speed,
        following_error=torque_share * limits.following_error,
        torque=torque_share * limits.torque,
        current=torque_share * limits.current,
    )


def _around(targets: Array, limits: Limits) -> Limits:
    """Limit the joint to the range of the pass, widened by the allowed following error."""
    slack = limits.following_error
    return dataclasses.replace(
        limits,
        angle_min=max(limits.angle_min, float(np.min(targets, initial=np.inf)) - slack),
        angle_max=min(limits.angle_max, float(np.max(targets, initial=-np.inf)) + slack),
    )
