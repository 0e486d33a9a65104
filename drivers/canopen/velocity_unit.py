"""Checks the units of speed and acceleration of a CiA 402 drive, and states the setting that
corrects the bench file.
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
"""SI unit of the acceleration (CiA 402-2): power of ten, numerator, denominator, reserved."""
RPM: Final = 2.0 * math.pi / 60.0
"""Speed of one turn per minute, rad/s."""
_NUMERATORS: Final[Mapping[int, float]] = {
    0x10: 1.0,
    0x41: math.pi / 180.0,
    0xB4: 2.0 * math.pi,
}
"""Codes of CiA 303-2 for radian, degree and revolution, to the angle in rad."""
_DENOMINATORS: Final[Mapping[int, float]] = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}
"""Codes of the time units second, minute and hour, to the time in s."""
_RPM_CODE: Final = 0xC0
_SQUARE_SECOND: Final = 0x57
"""Codes in 60AAh for revolutions per minute and for the square second."""
_POWERS: Final = (-3, -2, -1, 1, 2, 3)
"""Powers of ten by which the true unit may differ from the unit in the bench file."""
_SAME: Final = 0.01
"""Relative difference up to which two units count as equal."""
_UNUSUAL: Final = 3.0
"""A decimal multiple is chosen in place of a named unit only if, on a logarithmic scale, the
distance to the named unit is more than so many times the distance to the multiple.
"""
_Stated = tuple[ObjectAddress, int, float | None]
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
    """Yield an error for each unit of the drive that differs from the unit in the bench file."""
    yield from _unlike(
        "speed",
        "rad/s",
        scales.motor_speed_unit_rad_s,
        _stated(channel, UNIT, decode),
        lambda told: _words(told, scales, exact=True),
    )
    yield from _unlike(
        "acceleration",
        "rad/s^2",
        scales.motor_acceleration_unit_rad_s2,
        _stated(channel, ACCELERATION_UNIT, decode_acceleration),
        lambda told: f"set servo.acceleration_unit_rad_s2: {told:.6g}",
    )


def _unlike(
    name: str, symbol: str, unit: float, stated: _Stated, setting: Callable[[float], str]
) -> Iterator[ConfigurationError]:
    (index, _), word, told = stated
    if told is not None and abs(told - unit) > _SAME * told:
        yield ConfigurationError(
            f"unit of the {name}, {index:04X}h: {told:.6g} {symbol} ({word:08X}h) in the drive, "
            f"but {unit:.6g} {symbol} in the bench file: {setting(told)}"
        )


def _stated(
    channel: ProcessChannel, address: ObjectAddress, meaning: Callable[[int], float | None]
) -> _Stated:
    """Return the address and the value of an object that states a unit, and the unit in SI, or None
    if the drive has no such object or the object states no SI unit.
    """
    word = optional(channel.read, *address) if channel.describes(*address) else None
    if word is None:
        return address, 0, None
    return address, word & 0xFFFFFFFF, meaning(word & 0xFFFFFFFF)


def remedy(scales: ServoScales, factor: float) -> str:
    """Return a text that states the setting to change if the reported speed is ``factor`` times the
    true speed.
    """
    if factor == 0.0:
        return (
            "the speed 606Ch reads 0 while the position 6064h changes: the drive does not measure "
            "the speed, or its unit of the speed is too coarse for this motion; set a finer unit "
            "with the maker's tool, and state this unit in servo.velocity_unit_rad_s"
        )
    if factor < 0.0:
        return (
            "the speed 606Ch has the opposite sign of the change of the position 6064h; correct "
            "the sign with the maker's tool"
        )
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
    """Return the factor of the nearest named unit if its ratio to the rough ``factor`` is within
    ``spread``, else the power of ten nearest to the rough factor; the present unit is excluded.
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
    """Return the named units that differ from the unit in the bench file."""
    own = scales.motor_speed_unit_rad_s
    return {name: unit for name, unit in _units(scales).items() if abs(unit - own) > _SAME * own}


def _decimal(scales: ServoScales) -> dict[str, float]:
    """Return decimal multiples of the unit in the bench file by name; in many drives a power of ten
    of the unit can be set.
    """
    own = scales.motor_speed_unit_rad_s
    name = next((n for n, unit in _units(scales).items() if abs(unit - own) <= _SAME * own), None)
    words = "times the stated unit" if name is None else _WORDS[name]
    return {f"{10.0**power:g} {words}": own * 10.0**power for power in _POWERS}


def _nearest(unit: float, known: Mapping[str, float], spread: float) -> tuple[str, float] | None:
    """Return name and value of the nearest of the known units, or None if no known unit is within a
    factor of ``spread``.
    """
    if not known:
        return None
    name = min(known, key=lambda name: _apart(unit, known[name]))
    return (name, known[name]) if _apart(unit, known[name]) <= math.log(spread) else None


def _apart(first: float, second: float) -> float:
    return abs(math.log(first / second))


def _recognised(unit: float, scales: ServoScales, exact: bool = False) -> tuple[str | None, float]:
    """Return name and value of the known unit that a value belongs to; the name is None if there is
    no such unit.

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
        return f"the unit of 606Ch is {_WORDS[name]}: set servo.velocity_unit: {name}"
    setting = f"set servo.velocity_unit_rad_s: {unit:.4g}"
    if exact:
        return f"the unit of 606Ch is {name}: {setting}" if name is not None else setting
    if name is not None:
        return f"the unit of 606Ch is probably {name}; check the drive's manual, then {setting}"
    return (
        f"one unit of 606Ch is about {unit:.4g} rad/s; look up the exact unit in the drive's "
        f"manual, or {setting}"
    )
