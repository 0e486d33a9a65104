"""Finds effects that recordings cannot show because a common origin of their angles, or a common
clock, was not recorded.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.rows.clock import one_clock
from identification.diagnosis.rows.view import View, lacks_common_origin
from identification.recording import Recording

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


def unrecorded_effects(
    fitted: Sequence[Recording], views: Sequence[View]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return effects to exclude from the search, and warnings that state the reason.

    Args:
        fitted: Recordings to fit.
        views: Views of these recordings.
    """
    names: set[str] = set()
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


def _titles(names: Collection[str]) -> str:
    return ", ".join(title(n) for n in names)
