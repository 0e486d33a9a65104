"""Finds effects that recordings cannot show because their angles have no common origin, because
they have no common clock, or because the bench has no angle with which the effect is periodic.
"""

from __future__ import annotations

from collections.abc import Sequence

from identification.effects import MOTION
from identification.effects.effect import Needs, title
from identification.model.units import LINEAR
from identification.recording import Bench, Recording
from identification.views.view import View, lacks_common_origin, one_clock


def unrecorded_effects(
    fitted: Sequence[Recording], views: Sequence[View]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return effects to exclude from the search, and warnings that state the reason.

    Args:
        fitted: Recordings to fit.
        views: Views of these recordings.
    """
    absent = _not_on(fitted[0].bench)
    warnings = []
    if lacks_common_origin(views):
        absent |= {Needs.COMMON_ZERO}
        local = [title(e.name) for e in MOTION if Needs.COMMON_ZERO in e.needs]
        warnings.append(
            "only speed was recorded, no angle: the angle of each recording is counted from its "
            f"first sample, so that effects at a fixed angle ({', '.join(local)}) are not "
            "searched for, and each recording has phases of its own"
        )
    if not one_clock(fitted):
        warnings.append(
            "the recordings have no common clock, so each recording is assumed to start cold, with "
            "running time counted from its first sample; if the start times are known, state "
            "`start` in the campaign file"
        )
    return frozenset(e.name for e in MOTION if e.needs & absent), tuple(warnings)


def _not_on(bench: Bench) -> frozenset[Needs]:
    """Return which angles the bench, by its description, does not have; on a linear bench the angle
    of the motor is known only if the gear ratio (rad/m) is known.
    """
    if bench.motion != LINEAR:
        return frozenset()
    motor = {Needs.MOTOR_TURN} if bench.gear_ratio == 1.0 else set()
    return frozenset({Needs.JOINT_TURN, *motor})
