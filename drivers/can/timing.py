"""How long classical CAN frames take, and how much of a bus one control cycle needs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

ANSWER_SHARE: Final = 0.8
"""Share of a cycle in which its process data must be in; the rest is left to heartbeats, SDO and
the host.
"""


def frame_bits(length: int) -> int:
    """Return the longest a base-format data frame of ``length`` bytes can be, in bit times.

    34 + 8 n bits are subject to stuffing, one stuff bit after every four at worst; 13 bits
    (delimiters, acknowledge, end of frame, intermission) are not.
    """
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


def cycle_bits(frames: Iterable[tuple[int, int]]) -> float:
    """Return the bit times of a mean control cycle: SYNC and process data, at their longest.

    Args:
        frames: Data bytes of each PDO, and the number of cycles in which it goes once.
    """
    return frame_bits(0) + sum(frame_bits(length) / every for length, every in frames)
