"""Units of quantities on a rotary bench (rad, N m) and on a linear bench (m, N).

The code states all units for a rotary bench (rad, N m, kg m^2). On a linear bench m replaces rad, N
replaces N m and kg replaces kg m^2. Where no torque constant is known, torques are in A.
"""

from __future__ import annotations

from collections.abc import Mapping

LINEAR = "linear"
_LINEAR_UNITS: Mapping[str, str] = {
    "rad": "m",
    "rad/s": "m/s",
    "rad/s^2": "m/s^2",
    "1/rad": "1/m",
    "s/rad": "s/m",
    "N m": "N",
    "N m/s": "N/s",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "kg m^2": "kg",
    "A/rad": "A/m",
    "A s/rad": "A s/m",
    "A s^2/rad": "A s^2/m",
    "A s^2/rad^2": "A s^2/m^2",
}
_LINEAR_ENDINGS = (
    ("_Nms2_rad2", "_Ns2_m2"),
    ("_Nms_rad", "_Ns_m"),
    ("_Nm_rad", "_N_m"),
    ("_Nm_s", "_N_s"),
    ("_Nm", "_N"),
    ("_kgm2", "_kg"),
    ("_rad", "_m"),
)
PHASES = ("phase", "zero")
"""Prefixes of the names of parameters that are angles on a linear bench too."""


def unit_on(motion: str, unit: str, amperes: bool = False) -> str:
    """Return the unit of a quantity on a bench.

    Args:
        motion: ``rotary`` or ``linear``.
        unit: Unit of the quantity on a rotary bench.
        amperes: Whether torques are in amperes.
    """
    if amperes:
        unit = "A s^2/rad" if unit == "kg m^2" else unit.replace("N m", "A")
    return _LINEAR_UNITS.get(unit, unit) if motion == LINEAR else unit


def parameter_unit(motion: str, name: str, unit: str, amperes: bool = False) -> str:
    """Return the unit of an effect's parameter on a bench; phases are in rad on linear benches
    too.
    """
    return unit if unit == "rad" and name.startswith(PHASES) else unit_on(motion, unit, amperes)


def parameter_title(motion: str, name: str) -> str:
    """Return the displayed name of an effect's parameter; the name ends with the unit of the bench.

    Result files keep the name for a rotary bench.
    """
    if motion != LINEAR or name.startswith(PHASES):
        return name
    for rotary, linear in _LINEAR_ENDINGS:
        if name.endswith(rotary):
            return name.removesuffix(rotary) + linear
    return name


def torque_word(motion: str) -> str:
    """Return the word ``torque``, or ``force`` on a linear bench."""
    return "force" if motion == LINEAR else "torque"
