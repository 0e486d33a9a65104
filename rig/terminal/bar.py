"""Shows a progress bar over steps of known share."""

from __future__ import annotations

import time
from typing import Final, Self

from tqdm import tqdm

_PERIOD_S: Final = 0.1
"""Shortest time between two showings of one kind of work."""


class ShareBar:
    """Progress bar that shows the present work and its share; shows nothing if the output is not a
    terminal.
    """

    def __init__(self) -> None:
        tqdm.monitor_interval = 0  # no helper thread
        self._what = ""
        self._shown_at = -_PERIOD_S
        self._bar = tqdm(
            total=100.0, disable=None, leave=False, bar_format="{desc} |{bar}| {n:.0f} %, {elapsed}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()

    def __call__(self, what: str, share: float) -> None:
        """Show the work ``what`` and the share of it that is done, 0 to 1."""
        if self._bar.disable:
            return
        now = time.monotonic()
        if what == self._what and now - self._shown_at < _PERIOD_S and share < 1.0:
            return
        self._what, self._shown_at = what, now
        self._bar.set_description_str(what, refresh=False)
        self._bar.n = 100.0 * share
        self._bar.refresh()
