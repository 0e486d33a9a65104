"""Finds and corrects counter overflows: steps of a power of two in a column or in the time.

The functions depend only on their arguments.
"""

from __future__ import annotations

import numpy as np

from identification.recording import Array

POWERS = range(8, 33)
"""Widths of counters that are recognised, bits."""
CONVERTED_UNITS = (1e-3, 1e-6)
"""Units, in seconds, of a 32-bit counter of time that the logger has converted to seconds:
milliseconds and microseconds. Overflows of shorter counters are not searched in converted time
stamps, because successive recordings of 4096 or 65536 samples look like such overflows.
"""
LEVELS = 8
"""Least number of different values of a column that is read as signed; a column with fewer values
may be a digital output.
"""
DAY_S = 86400.0
WHOLE_TOLERANCE = 1e-3
"""Greatest distance from an integer at which a value divided by the file's scale is a count."""
ORDINARY_SHARE = 0.125
"""Greatest step between overflows, as a share of the modulus; the direction of larger steps would
be uncertain.
"""
TIME_PERIODS = 100.0
"""Longest time step at an overflow, in median periods."""
POSITIONS = frozenset({"angle", "motor_angle"})
TIMES = frozenset({"time", "angle_time"})


def unwrapped(name: str, values: Array) -> tuple[Array, str]:
    """Correct the overflows of a counter.

    Args:
        name: The channel of the column.
        values: The column as stored, shape (n,).

    Returns:
        The corrected column and a note; ``values`` and an empty note if there is no overflow.
    """
    if name == "enabled" or len(values) < 3:
        return values, ""
    if name in TIMES:
        return _time(values)
    finite = values[np.isfinite(values)]
    if finite.size < 3 or np.any(finite != np.rint(finite)):
        return values, ""
    steps = np.diff(finite)
    for power in POWERS:
        modulus = float(2**power)
        jumps = np.abs(steps) > modulus / 2
        if not jumps.any() or not _in_window(finite, modulus):
            continue
        turned = steps - modulus * np.sign(steps) * jumps
        if np.max(np.abs(turned)) > ORDINARY_SHARE * modulus:
            continue
        count = int(jumps.sum())
        if name in POSITIONS:
            return _continued(values, modulus), (
                f"a counter of {power} bits that overflows {count} times: corrected"
            )
        if finite.min() >= 0 and len(np.unique(finite)) >= LEVELS:
            signed = np.where(values >= modulus / 2, values - modulus, values)
            return signed, (
                f"steps of 2^{power} around zero: the column holds signed numbers of {power} bits "
                f"as unsigned numbers, and was read as signed numbers"
            )
    return values, ""


def unwrapped_counts(name: str, values: Array, scale: tuple[float, float]) -> tuple[Array, str]:
    """Correct the overflows of a counter to which the file has applied a scale.

    Args:
        name: The channel of the column.
        values: Values in the file's unit, shape (n,).
        scale: Factor and offset: value = factor x count + offset.

    Returns:
        See :func:`unwrapped`.
    """
    factor, offset = scale
    if name in TIMES or not np.isfinite(factor) or factor == 0.0:
        return values, ""
    counts = (values - offset) / factor
    whole = np.rint(counts)
    known = np.isfinite(counts)
    if not known.any() or np.max(np.abs(counts - whole)[known]) > WHOLE_TOLERANCE:
        return values, ""
    turned, note = unwrapped(name, whole)
    return (values + factor * (turned - whole), note) if note else (values, "")


def _in_window(values: Array, modulus: float) -> bool:
    """Return whether all values fit into the range of an unsigned or a signed counter with this
    modulus.
    """
    low, high = float(values.min()), float(values.max())
    return (low >= 0 and high < modulus) or (low >= -modulus / 2 and high < modulus / 2)


def _continued(values: Array, modulus: float) -> Array:
    """Return the values with multiples of the modulus added, so that no step exceeds half of the
    modulus.
    """
    result = values.astype(np.float64)
    known = np.isfinite(result)
    steps = np.diff(result[known])
    turns = np.concatenate(([0.0], np.cumsum(-np.rint(steps / modulus))))
    result[known] += modulus * turns
    return result


def _time(values: Array) -> tuple[Array, str]:
    if not np.all(np.isfinite(values)):
        return values, ""
    steps = np.diff(values)
    back = steps < 0
    if not back.any():
        return values, ""
    forward = steps[steps > 0]
    if not forward.size:
        return values, ""
    longest = TIME_PERIODS * float(np.median(forward))
    whole = bool(np.all(values == np.rint(values)))
    candidates = [(2.0**power, f"2^{power}") for power in POWERS if whole]
    candidates += [(2.0**32 * unit, f"2^32 x {unit:g}") for unit in CONVERTED_UNITS]
    candidates += [(DAY_S * scale, "one day") for scale in (1.0, 1e3, 1e6)]
    for modulus, words in candidates:
        over = steps[back] + modulus
        if values.min() >= 0 and values.max() < modulus and np.all((over > 0) & (over <= longest)):
            turns = np.concatenate(([0.0], np.cumsum(back)))
            return values + modulus * turns, (
                f"starts again after {words}, {int(back.sum())} times: corrected"
            )
    return values, ""
