"""A progress bar over steps of known share."""

from __future__ import annotations

from typing import Self

from tqdm import tqdm


class ShareBar:
    """Shows what is being done and how much of it; nothing where the output is not a terminal."""

    def __init__(self) -> None:
        tqdm.monitor_interval = 0  # no helper thread
        self._bar = tqdm(
            total=100.0, disable=None, leave=False, bar_format="{desc} |{bar}| {n:.0f} %, {elapsed}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()

    def __call__(self, what: str, share: float) -> None:
        """Show ``what`` at ``share`` (0 to 1) of it."""
        if self._bar.disable:
            return
        self._bar.set_description_str(what, refresh=False)
        self._bar.update(100.0 * share - self._bar.n)
