"""Checks the units of speed and acceleration of a CiA 402 drive, and states the setting for the
bench file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from drivers.errors import ConfigurationError
from drivers.objects import ObjectAddress, ProcessChannel, optional
from drivers.remedies import KNOWN_SPREAD, MEASURED_SPREAD
from drivers.units import ServoScales

UNIT: Final[ObjectAddress] = (0x60A9, 0)
"""SI unit of the velocity (CiA 402-2): power of ten, numerator, denominator, reserved."""
ACCELERATION_UNIT: Final[ObjectAddress] = (0x60AA, 0)
"""SI unit of the acceleration (CiA 402-2), likewise."""
RPM: Final = 2.0 * math.pi / 60.0
"""Speed of one turn per minute, rad/s."""
_NUMERATORS: Final[Mapping[int, float]] = {
    0x10: 1.0,
    0x41: math.pi / 180.0,
    0xB4: 2.0 * math.pi,
}
"""Codes of CiA 303-2: radian, degree, revolution."""
_DENOMINATORS: Final[Mapping[int, float]] = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}
"""Codes of the time units: second, minute, hour."""
_RPM_CODE: Final = 0xC0
_SQUARE_SECOND: Final = 0x57
"""Codes in 60AAh: revolutions per minute, and the square second."""
_POWERS: Final = (-3, -2, -1, 1, 2, 3)
"""Powers of ten of the decimal multiples that are recognised."""
_SAME: Final = 0.01
"""Relative difference up to which two units count as equal."""
_UNUSUAL: Final = 3.0
"""Least ratio of the distances, as logarithms, to a unit with a name and to a decimal multiple for
the latter to count.
"""
_WORDS: Final[Mapping[str, str]] = {"rpm": "rpm", "counts_per_s": "counts per second"}


def decode(word: int) -> float | None:
    """Return the motor speed of one unit, rad/s, as object 60A9h states it, or None for units
    without SI meaning, such as counts.
    """
    numerator = _NUMERATORS.get(word >> 16 & 0xFF)
    denominator = _DENOMINATORS.get(word >> 8 & 0xFF)
    if numerator is None or denominator is None:
        return None
    power = word >> 24 & 0xFF
    return numerator / denominator * 10.0 ** (power - 256 if power > 127 else power)


def decode_acceleration(word: int) -> float | None:
    """Return the motor acceleration of one unit, rad/s^2, as object 60AAh states it, or None for
    units without SI meaning.
    """
    if word >> 8 & 0xFF == _SQUARE_SECOND:
        return decode(word & ~0xFF00 | 0x0300)
    if word >> 16 & 0xFF == _RPM_CODE:
        found = decode(word & ~0xFF0000 | 0xB40000)
        return None if found is None else found / 60.0
    return None


def refusals(channel: ProcessChannel, scales: ServoScales) -> Iterator[ConfigurationError]:
    """Yield an error for each unit that differs from that of the bench file."""
    word, told = _stated(channel, UNIT, decode)
    unit = scales.motor_speed_unit_rad_s
    if told is not None and abs(told - unit) > _SAME * told:
        yield ConfigurationError(
            f"unit of the speed, 60A9h: the drive states {told:.6g} rad/s ({word:08X}h), the bench "
            f"file states {unit:.6g} rad/s: {_words(told, scales, exact=True)}"
        )
    word, told = _stated(channel, ACCELERATION_UNIT, decode_acceleration)
    unit = scales.motor_acceleration_unit_rad_s2
    if told is not None and abs(told - unit) > _SAME * told:
        yield ConfigurationError(
            f"unit of the acceleration, 60AAh: the drive states {told:.6g} rad/s^2 ({word:08X}h), "
            f"the bench file states {unit:.6g} rad/s^2: set servo.acceleration_unit_rad_s2: "
            f"{told:.6g}"
        )


def _stated(
    channel: ProcessChannel, address: ObjectAddress, meaning: Callable[[int], float | None]
) -> tuple[int, float | None]:
    """Return the value of an object of a unit, and the unit, or None if the object states no
    unit.
    """
    word = optional(channel.read, *address) if channel.describes(*address) else None
    if word is None:
        return 0, None
    return word & 0xFFFFFFFF, meaning(word & 0xFFFFFFFF)


def remedy(scales: ServoScales, factor: float) -> str:
    """Return a text with the setting to change if the reported speed is ``factor`` times the true
    speed.
    """
    if factor == 0.0:
        return (
            "606Ch reads 0 while 6064h changes: the drive does not measure its speed, or shows it "
            "in a unit too coarse for this motion; set servo.velocity_unit_rad_s to the unit in "
            "its manual, and a finer one with the maker's tool"
        )
    if factor < 0.0:
        return "606Ch has the opposite sign of 6064h; correct the drive with its maker's tool"
    return _words(scales.motor_speed_unit_rad_s / factor, scales)


def settings(scales: ServoScales, factor: float) -> tuple[tuple[str, str | float | None], ...]:
    """Return the keys in the bench file that correct the unit of the drive's speed, and their
    values; none if no key corrects it.
    """
    if factor <= 0.0:
        return ()
    name, unit = _recognised(scales.motor_speed_unit_rad_s / factor, scales)
    if name is not None and name in _units(scales):
        return (("velocity_unit_rad_s", None), ("velocity_unit", name))
    return (("velocity_unit", None), ("velocity_unit_rad_s", float(f"{unit:.4g}")))


def nearest_factor(scales: ServoScales, factor: float, spread: float) -> float:
    """Return the factor of the named unit nearest to a rough factor if the ratio of the two factors
    is within ``spread``, else the nearest power of ten; the present unit is excluded.
    """
    if factor <= 0.0:
        return factor
    own = scales.motor_speed_unit_rad_s
    named = _nearest(own / factor, _others(scales), spread)
    if named is not None:
        return own / named[1]
    return 10.0 ** (round(math.log10(factor)) or math.copysign(1.0, math.log10(factor)))


def _units(scales: ServoScales) -> dict[str, float]:
    """Return the units that have a name in the bench file."""
    return {"rpm": RPM, "counts_per_s": scales.count_rad}


def _others(scales: ServoScales) -> dict[str, float]:
    """Return the named units other than the unit of the bench file."""
    own = scales.motor_speed_unit_rad_s
    return {name: unit for name, unit in _units(scales).items() if abs(unit - own) > _SAME * own}


def _decimal(scales: ServoScales) -> dict[str, float]:
    """Return decimal multiples of the unit of the bench file, because drives are set to powers of
    ten.
    """
    own = scales.motor_speed_unit_rad_s
    name = next((n for n, unit in _units(scales).items() if abs(unit - own) <= _SAME * own), None)
    words = "times the stated unit" if name is None else _WORDS[name]
    return {f"{10.0**power:g} {words}": own * 10.0**power for power in _POWERS}


def _nearest(unit: float, known: Mapping[str, float], spread: float) -> tuple[str, float] | None:
    """Return name and value of the nearest of known units, or None if no unit is within the ratio
    ``spread``. None where none is within a ratio.
    """
    if not known:
        return None
    name = min(known, key=lambda name: _apart(unit, known[name]))
    return (name, known[name]) if _apart(unit, known[name]) <= math.log(spread) else None


def _apart(first: float, second: float) -> float:
    return abs(math.log(first / second))


def _recognised(unit: float, scales: ServoScales, exact: bool = False) -> tuple[str | None, float]:
    """Return name and value of a known unit; the name of an unknown unit is empty.

    A measured value may differ from the true unit by rounding, and by peaks of the speed between
    samples. A decimal multiple is less likely than a named unit. A decimal multiple is therefore
    chosen only if the nearest named unit is farther from the value than the error of a measured
    motion, and if the multiple is much nearer.
    """
    one = 1.0 + _SAME
    named = _nearest(unit, _others(scales), one if exact else KNOWN_SPREAD)
    decimal = _nearest(unit, _decimal(scales), one if exact else MEASURED_SPREAD)
    if named is None or decimal is None:
        return named or decimal or (None, unit)
    apart = _apart(unit, named[1])
    usual = apart <= math.log(MEASURED_SPREAD) or apart <= _UNUSUAL * _apart(unit, decimal[1])
    return named if usual else decimal


def _words(found: float, scales: ServoScales, exact: bool = False) -> str:
    name, unit = _recognised(found, scales, exact)
    if name is not None and name in _units(scales):
        return f"606Ch is in {_WORDS[name]}: set servo.velocity_unit: {name}"
    setting = f"set servo.velocity_unit_rad_s: {unit:.4g}"
    if exact:
        return f"606Ch is in {name}: {setting}" if name is not None else setting
    if name is not None:
        return f"606Ch looks like {name}: {setting}, or the unit in the manual of the drive"
    return (
        f"{setting}, about the speed of one unit of 606Ch, or the unit in the manual of the drive"
    )
