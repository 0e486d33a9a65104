"""Progress of a run at the terminal; nothing when the output is not one."""

from __future__ import annotations

import math
from typing import Self

from tqdm import tqdm

from rig.sample import Sample

# tqdm's monitor is a thread; the control process has none.
tqdm.monitor_interval = 0


class RunProgress:
    """A bar over the cycles of a whole run, with stage, angle error and current.

    Args:
        cycle_s: Control cycle, s.
        duration_s: Expected run time, s.
    """

    def __init__(self, cycle_s: float, duration_s: float) -> None:
        self._cycle_s = cycle_s
        self._total_s = round(duration_s, 1)
        self._bar = tqdm(
            total=self._total_s,
            unit="s",
            disable=None,
            leave=False,
            bar_format="{desc}|{bar}| {n:.0f}/{total:.0f} s, {remaining} left{postfix}",
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()

    def __call__(self, stage: str, cycles: int, sample: Sample) -> None:
        """Advance by so many cycles, and show the latest sample."""
        bar = self._bar
        if bar.disable:
            return
        error = math.degrees(sample.angle - sample.command)
        bar.set_description_str(stage, refresh=False)
        bar.set_postfix_str(f"error {error:+.3f} deg, {sample.current:+.2f} A", refresh=False)
        bar.update(min(cycles * self._cycle_s, self._total_s - bar.n))
