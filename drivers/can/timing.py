"""Duration of classical CAN frames, and bus load of a control cycle."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

ANSWER_SHARE: Final = 0.8
"""Share of a cycle within which process data must arrive; the rest is for heartbeats, SDO and
the host.
"""


def frame_bits(length: int) -> int:
    """Return the maximum length of a base-format data frame of ``length`` bytes, in bit times.

    34 + 8 n bits are subject to stuffing, one stuff bit after every four at worst; 13 bits
    (delimiters, acknowledge, end of frame, intermission) are not.
    """
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


def cycle_bits(frames: Iterable[tuple[int, int]]) -> float:
    """Return the mean bit times of a control cycle: SYNC and process data, with worst-case
    stuffing.

    Args:
        frames: Data bytes of each PDO, and the number of cycles in which it goes once.
    """
    return frame_bits(0) + sum(frame_bits(length) / every for length, every in frames)
