"""Plans the first passes before a stage: its motion, smaller, under tighter limits."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.common.errors import InputError
from rig.config.sequence import Array, FirstPass, StageSection, excitation
from rig.planning.limits import Limits

LEAST_TARGETS = 2  # least number of control cycles of a first pass
LONGEST_RAMP_SHARE = 0.25  # longest fade-in or fade-out, as a share of the duration of the pass
GROWTH = 2.0
"""Factor on the amplitude from pass to pass while the joint, as with soft gains, does not move."""


@dataclass(frozen=True)
class PlannedPass:
    """A first pass, with its share of the amplitude, and limits also of the move to its start."""

    targets: Array
    amplitude: float
    duration_s: float
    move_limits: Limits
    limits: Limits


def plan_passes(
    section: StageSection, low: FirstPass, limits: Limits, cycle_s: float
) -> tuple[PlannedPass, ...]:
    """Return the first pass of a stage, and larger ones while the joint does not move."""
    passes: list[PlannedPass] = []
    amplitude = low.amplitude
    while amplitude < 1.0:
        planned = _plan_pass(section, low, amplitude, limits, cycle_s)
        peak = float(np.max(np.abs(np.diff(planned.targets)), initial=0.0)) / cycle_s
        if passes and peak > planned.limits.speed:
            break
        passes.append(planned)
        amplitude *= GROWTH
    return tuple(passes)


def _plan_pass(
    section: StageSection, low: FirstPass, amplitude: float, limits: Limits, cycle_s: float
) -> PlannedPass:
    """Return one first pass: the tones smaller and shorter, or the ramp with less travel."""
    if section.ramp is not None:
        ramp = section.ramp.model_copy(
            update={"travel_deg": amplitude * section.ramp.travel_deg, "times": 1}
        )
        changes: dict[str, Any] = {"ramp": ramp, "duration_s": ramp.moving_s}
    else:
        slowest_s = 1.0 / min(tone.frequency_Hz for tone in section.tones)
        wanted_s = low.duration_s or slowest_s + section.ramp_in_s + section.ramp_out_s
        duration_s = min(wanted_s, section.duration_s)
        ramp_s = LONGEST_RAMP_SHARE * duration_s
        changes = {
            "tones": tuple(
                tone.model_copy(update={"amplitude_deg": amplitude * tone.amplitude_deg})
                for tone in section.tones
            ),
            "duration_s": duration_s,
            "ramp_in_s": min(section.ramp_in_s, ramp_s),
            "ramp_out_s": min(section.ramp_out_s, ramp_s),
        }
    targets = excitation(section.model_copy(update=changes), cycle_s)
    if len(targets) < LEAST_TARGETS:
        raise InputError(
            f"stage {section.name}: a first pass of {changes['duration_s']:.3g} s has fewer than "
            f"{LEAST_TARGETS} control cycles; state a longer `first_pass` or ramp"
        )
    moving = _tighter(limits, low.limit_share)
    # The angle range of the pass is that of its targets, widened by the allowed following error.
    slack = moving.following_error
    around = dataclasses.replace(
        moving,
        angle_min=max(moving.angle_min, float(np.min(targets, initial=np.inf)) - slack),
        angle_max=min(moving.angle_max, float(np.max(targets, initial=-np.inf)) + slack),
    )
    return PlannedPass(targets, amplitude, len(targets) * cycle_s, moving, around)


def _tighter(limits: Limits, share: float) -> Limits:
    """Return reduced limits.

    Static friction does not decrease with the amplitude, and soft gains need an error for it:
    torque, current and following error are reduced half as much as the speed.
    """
    torque_share = 0.5 * (1.0 + share)
    return dataclasses.replace(
        limits,
        speed=share * limits.speed,
        following_error=torque_share * limits.following_error,
        torque=torque_share * limits.torque,
        current=torque_share * limits.current,
    )
