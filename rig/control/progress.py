"""Shows the progress of a run on the status line of a terminal."""

from __future__ import annotations

import math
from typing import Self

from rig.common.sample import Sample
from rig.terminal.screen import Screen

_BAR = 12


class RunProgress:
    """Shows elapsed and remaining run time, stage, angle error and current.

    Run time is the time of the control cycles, without the wait at a prompt. Nothing is shown if
    the output is not a terminal.

    Args:
        cycle_s: Control cycle, s.
        duration_s: Expected time in motion, s.
        screen: Terminal of the status line.
    """

    def __init__(self, cycle_s: float, duration_s: float, screen: Screen | None = None) -> None:
        self._cycle_s = cycle_s
        self._total_s = duration_s
        self._done_s = 0.0
        self._screen = screen or Screen()

    def __enter__(self) -> Self:
        return self

    @property
    def left_s(self) -> float:
        """Expected remaining time in motion, s."""
        return self._total_s - self._done_s

    def __exit__(self, *exception: object) -> None:
        """Clear the status line for other output."""

    def __call__(self, stage: str, cycles: int, sample: Sample) -> None:
        """Advance by this many cycles and show the latest sample."""
        self._done_s = min(self._done_s + cycles * self._cycle_s, self._total_s)
        if not self._screen.has_status:
            self._screen.pump()
            return
        share = self._done_s / self._total_s if self._total_s else 1.0
        bar = "#" * round(_BAR * share)
        error_deg = math.degrees(sample.angle - sample.command)
        self._screen.status(
            f"{stage} |{bar:<{_BAR}}| {self._total_s - self._done_s:.0f} s left, "
            f"error {error_deg:+z.3f} deg, {sample.current:+z.2f} A"
        )
