"""Finds effects that recordings cannot show because their angles have no common origin, because
they have no common clock, or because the bench has no angle with which the effect is periodic.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.rows.clock import one_clock
from identification.diagnosis.rows.view import View, lacks_common_origin
from identification.model.parameters import LINEAR
from identification.recording import Bench, Recording

LOCAL_EFFECTS = (
    "gravity_imbalance",
    "return_spring",
    "end_stop",
    "position_dependent_friction",
    "load_position_dependence",
)
"""Effects at a fixed angle, which cannot be found if the angles of the recordings have no common
origin.
"""

OF_A_TURN = ("gear_mesh_ripple", "encoder_eccentricity", "gravity_imbalance")
"""Effects that are periodic in the angle of the joint, which a linear bench does not have."""
OF_THE_MOTOR = ("cogging", "torque_ripple")
"""Effects that are periodic in the angle of the motor, which can be found on a linear bench only if
its gear ratio (rad/m) is known.
"""


def unrecorded_effects(
    fitted: Sequence[Recording], views: Sequence[View]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return effects to exclude from the search, and warnings that state the reason.

    Args:
        fitted: Recordings to fit.
        views: Views of these recordings.
    """
    names = set(_not_on(fitted[0].bench))
    warnings = []
    if lacks_common_origin(views):
        names.update(LOCAL_EFFECTS)
        warnings.append(
            "only speed was recorded, no angle: the angle of each recording is counted from its "
            f"first sample, so that effects at a fixed angle ({_titles(LOCAL_EFFECTS)}) are not "
            "searched for, and each recording has phases of its own"
        )
    if not one_clock(fitted):
        warnings.append(
            "the recordings have no common clock, so each recording is assumed to start cold, with "
            "running time counted from its first sample; if the start times are known, state "
            "`start` in the campaign file"
        )
    return frozenset(names), tuple(warnings)


def _not_on(bench: Bench) -> tuple[str, ...]:
    """Return the effects that are periodic in an angle that the bench, by its description, does not
    have.
    """
    if bench.motion != LINEAR:
        return ()
    return OF_A_TURN if bench.gear_ratio != 1.0 else (*OF_A_TURN, *OF_THE_MOTOR)


def _titles(names: Collection[str]) -> str:
    return ", ".join(title(n) for n in names)
