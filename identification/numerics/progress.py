"""Progress callback of long computations."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Function that is called with the label of the current step and the share of the step that is
done, 0 to 1.
"""


def silent(_what: str, _share: float) -> None:
    """Ignore the progress."""
