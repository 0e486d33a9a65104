"""Finds effects that recordings cannot show because a common origin of their angles, or a common
clock, was not recorded, or because the bench has no angle of this kind.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.rows.clock import one_clock
from identification.diagnosis.rows.view import View, lacks_common_origin
from identification.model.units import LINEAR
from identification.recording import Bench, Recording

LOCAL_EFFECTS = (
    "gravity_imbalance",
    "return_spring",
    "end_stop",
    "position_dependent_friction",
    "load_position_dependence",
)
"""Effects at a fixed angle, which recordings without a common origin of their angles cannot
show.
"""

OF_A_TURN = ("gear_mesh_ripple", "encoder_eccentricity", "gravity_imbalance")
"""Effects periodic in the angle of the joint, which a carriage does not have."""
OF_THE_MOTOR = ("cogging", "torque_ripple")
"""Effects periodic in the angle of the motor, which a linear bench shows only if its gear ratio
(rad/m) is known.
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
            "no angle was recorded, only speed: each recording counts its angle from its own first "
            f"sample, so effects at a fixed angle ({_titles(LOCAL_EFFECTS)}) are not searched for, "
            "and phases hold for one recording each"
        )
    if not one_clock(fitted):
        warnings.append(
            "the recordings have no common clock, so each is assumed to start cold, with its "
            "running time counted from its first sample; state start in the campaign file if known"
        )
    return frozenset(names), tuple(warnings)


def _not_on(bench: Bench) -> tuple[str, ...]:
    """Return effects that are periodic in an angle that the bench, as described, does not have."""
    if bench.motion != LINEAR:
        return ()
    return OF_A_TURN if bench.gear_ratio != 1.0 else (*OF_A_TURN, *OF_THE_MOTOR)


def _titles(names: Collection[str]) -> str:
    return ", ".join(title(n) for n in names)
