"""Checks the unit of the speed of a CiA 402 drive, and states the setting for the bench file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from drivers.errors import ConfigurationError
from drivers.objects import ObjectAddress, ProcessChannel, optional
from drivers.remedies import KNOWN_SPREAD
from drivers.units import ServoScales

UNIT: Final[ObjectAddress] = (0x60A9, 0)
"""SI unit of the velocity (CiA 402-2): power of ten, numerator, denominator, reserved."""
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
_SAME: Final = 0.01
"""Relative difference up to which two units count as equal."""


def decode(word: int) -> float | None:
    """Return the motor speed of one unit, rad/s, as object 60A9h states it; None for units without
    SI meaning, such as counts.
    """
    numerator = _NUMERATORS.get(word >> 16 & 0xFF)
    denominator = _DENOMINATORS.get(word >> 8 & 0xFF)
    if numerator is None or denominator is None:
        return None
    power = word >> 24 & 0xFF
    return numerator / denominator * 10.0 ** (power - 256 if power > 127 else power)


def refusals(channel: ProcessChannel, scales: ServoScales) -> Iterator[ConfigurationError]:
    """Yield an error if the unit differs from that of the bench file."""
    word = optional(channel.read, *UNIT) if channel.describes(*UNIT) else None
    told = None if word is None else decode(word & 0xFFFFFFFF)
    if word is None or told is None:
        return
    unit = scales.motor_speed_unit_rad_s
    if abs(told - unit) > _SAME * told:
        yield ConfigurationError(
            f"unit of the speed, 60A9h: the drive states {told:.6g} rad/s "
            f"({word & 0xFFFFFFFF:08X}h), the bench file states {unit:.6g} rad/s: "
            f"{_words(told, scales)}"
        )


def remedy(scales: ServoScales, factor: float) -> str:
    """Return a text with the setting to change if the reported speed is ``factor`` times the true
    speed.
    """
    if factor <= 0.0:
        return "606Ch has the opposite sign of 6064h; correct the drive with its maker's tool"
    return _words(scales.motor_speed_unit_rad_s / factor, scales)


def settings(scales: ServoScales, factor: float) -> tuple[tuple[str, str | float | None], ...]:
    """Return the keys in the bench file that correct the unit of the drive's speed, and their
    values; none if no key corrects it.
    """
    if factor <= 0.0:
        return ()
    unit = scales.motor_speed_unit_rad_s / factor
    name = _known(unit, scales)
    if name is not None:
        return (("velocity_unit_rad_s", None), ("velocity_unit", name))
    return (("velocity_unit", None), ("velocity_unit_rad_s", float(f"{unit:.3g}")))


def nearest_factor(scales: ServoScales, factor: float, spread: float) -> float:
    """Return the factor of the known unit that is nearest to a rough factor; the rough factor if
    none is within ``spread``.
    """
    if factor <= 0.0:
        return factor
    own = scales.motor_speed_unit_rad_s
    name = _known(own / factor, scales, spread)
    return factor if name is None else own / _units(scales)[name]


def _units(scales: ServoScales) -> dict[str, float]:
    return {"rpm": RPM, "counts_per_s": scales.count_rad}


def _known(unit: float, scales: ServoScales, spread: float = KNOWN_SPREAD) -> str | None:
    """Return the name of the nearest unit of speed; None if the unit has no name."""
    known = _units(scales)
    name = min(known, key=lambda name: abs(math.log(unit / known[name])))
    return name if known[name] / spread <= unit <= known[name] * spread else None


def _words(unit: float, scales: ServoScales) -> str:
    name = _known(unit, scales)
    if name is not None:
        words = name.replace("counts_per_s", "counts per second")
        return f"606Ch is in {words}: set servo.velocity_unit: {name}"
    return f"set servo.velocity_unit_rad_s, the speed of one unit of 606Ch: about {unit:.2g}"
