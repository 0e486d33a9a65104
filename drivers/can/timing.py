"""Duration of classical CAN frames, and bus load of a control cycle."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

ANSWER_SHARE: Final = 0.8
"""Share of a control cycle within which process data must arrive; the rest of the cycle is for
heartbeats, SDO and the computations of the host.
"""


def frame_bits(length: int) -> int:
    """Return the maximum length of a base-format data frame of ``length`` bytes, in bit times.

    34 + 8 n bits, with n data bytes, are subject to bit stuffing, in the worst case one stuff bit
    after every four bits; 13 bits (delimiters, acknowledge, end of frame, intermission) are not.
    """
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


def cycle_bits(frames: Iterable[tuple[int, int]]) -> float:
    """Return the mean number of bit times of SYNC and process data in a control cycle, with the
    worst-case number of stuff bits.

    Args:
        frames: Data bytes of each PDO, and its period in cycles.
    """
    return frame_bits(0) + sum(frame_bits(length) / every for length, every in frames)
