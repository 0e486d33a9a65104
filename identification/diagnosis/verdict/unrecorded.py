"""Effects that recordings cannot show because of what was not recorded: an origin of their angles,
a common clock.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.rows.clock import one_clock
from identification.diagnosis.rows.view import View, without_origin
from identification.recording import Recording

PLACED = (
    "gravity_imbalance",
    "return_spring",
    "end_stop",
    "position_dependent_friction",
    "load_position_dependence",
)
"""Effects at a place, of which recordings that do not share an origin of their angles say
nothing.
"""


def unsought(
    fitted: Sequence[Recording], views: Sequence[View]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return effects that are not to be sought, and warnings that say so.

    Args:
        fitted: Recordings to fit.
        views: Of the same.
    """
    names: set[str] = set()
    warnings = []
    if without_origin(views):
        names.update(PLACED)
        warnings.append(
            "angles were not recorded, only speeds: each recording counts them from where it "
            "began, so that effects at "
            f"a place ({_titles(PLACED)}) are not sought, and phases are each recording's own"
        )
    if not one_clock(fitted):
        warnings.append(
            "the recordings have no clock in common, so that each is taken to have begun cold: "
            "running time counts from its first sample"
        )
    return frozenset(names), tuple(warnings)


def _titles(names: Collection[str]) -> str:
    return ", ".join(title(n) for n in names)
