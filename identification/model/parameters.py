"""Parameters of the nominal model and of the ladder of friction models: names, units, and places in
the vector for compiled kernels.

The vector holds the rises dM = Ms - Mc and dmu = mu_s - mu_c, and not the static levels of the
tables, because searches bound the rises and regressions are linear in the rises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.numerics.arrays import Array

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
    "N m s/(A^2 rad)": "N s/(A^2 m)",
    "A s^2/rad": "A s^2/m",
    "A s^2/rad^2": "A s^2/m^2",
}
_LINEAR_ENDINGS = (
    ("_Nms2_rad2", "_Ns2_m2"),
    ("_Nms_rad", "_Ns_m"),
    ("_Nms_A2rad", "_Ns_A2m"),
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
    """Return an effect parameter's unit on a bench; phases are in rad on linear benches too."""
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


SYSTEM_PARAMETERS = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
"""Parameters that the unloaded fit determines (eq. 16)."""
LOAD_PARAMETERS = ("mu_c", "mu_s", "omega_sL", "mu_2")
"""Parameters that the loaded fit determines (eq. 15)."""
GEAR_PARAMETERS = ("mu_gc", "mu_gs")
"""Parameters that the unloaded fit determines if friction grows with a pendulum's torque."""
DRIVE_SHARE = "mu_gd"
"""Weight of the drive's torque in the transmitted load, over that of the external torque."""
STRIBECK_TERMS = (
    ("Mc", "Ms", "omega_sf"),
    ("mu_c", "mu_s", "omega_sL"),
    ("mu_gc", "mu_gs", "omega_sf"),
)
"""Coulomb level, static level and Stribeck speed of each part of friction that may rise."""

UNITS_ROTARY: Mapping[str, str] = {
    "J": "kg m^2",
    "Mc": "N m",
    "Ms": "N m",
    "omega_sf": "rad/s",
    "sigma_2": "N m s/rad",
    "mu_c": "1",
    "mu_s": "1",
    "omega_sL": "rad/s",
    "mu_2": "s/rad",
    "mu_gc": "1",
    "mu_gs": "1",
    "offset": "N m",
}

MC, SYSTEM_RISE, OMEGA_SF, SIGMA_2, INERTIA = range(5)
MU_C, LOAD_RISE, OMEGA_SL, MU_2, OFFSET = range(5, 10)
MU_GC, GEAR_RISE, ALPHA, WEIGHT, ZERO, STEADY, GEAR_DRIVE, SIZE = range(10, 18)
"""Indices in the vector.

``WEIGHT`` (m g l, N m) and ``ZERO`` (rad) belong to a declared pendulum, ``STEADY`` is a known
constant torque on the joint, N m, ``ALPHA`` is the Stribeck exponent.
"""
INDEX: Mapping[str, int] = {
    "Mc": MC,
    "Ms": SYSTEM_RISE,
    "omega_sf": OMEGA_SF,
    "sigma_2": SIGMA_2,
    "J": INERTIA,
    "mu_c": MU_C,
    "mu_s": LOAD_RISE,
    "omega_sL": OMEGA_SL,
    "mu_2": MU_2,
    "offset": OFFSET,
}
"""Place of each fitted parameter in the vector; the place of a static level holds the rise."""
COULOMB_OF: Mapping[str, int] = {"Ms": MC, "mu_s": MU_C}
"""Place of the Coulomb level that belongs to each static level."""
LOGARITHMIC = (OMEGA_SF, OMEGA_SL, INERTIA)
"""Places of the parameters that are always positive; a search varies their logarithms."""


def pack(values: Mapping[str, float], alpha: float) -> Array:
    """Return the vector of named parameters, shape (SIZE,).

    A parameter that is absent has no effect. A static level below its Coulomb level counts as the
    Coulomb level.
    """
    p = np.zeros(SIZE)
    p[OMEGA_SF] = p[OMEGA_SL] = 1.0
    for name, k in INDEX.items():
        if name in values:
            p[k] = values[name]
    p[MU_GC] = values.get("mu_gc", 0.0)
    p[GEAR_DRIVE] = values.get(DRIVE_SHARE, 0.0)
    for (coulomb, static, _), k in zip(
        STRIBECK_TERMS, (SYSTEM_RISE, LOAD_RISE, GEAR_RISE), strict=True
    ):
        p[k] = max(values.get(static, 0.0) - values.get(coulomb, 0.0), 0.0)
    p[ALPHA] = alpha
    return p


def unpack(p: Array, names: Sequence[str]) -> dict[str, float]:
    """Return the named parameters of a vector, SI."""
    values = {name: float(p[INDEX[name]]) for name in names}
    for static, coulomb in COULOMB_OF.items():
        if static in values:
            values[static] = float(p[coulomb] + p[INDEX[static]])
    return values


NOMINAL: Mapping[str, float] = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "J": 0.204,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}
"""Nominal values in SI units, at the joint; the inertia is that of the packaged practical bench.
"""


LADDER: Mapping[str, tuple[str, ...]] = {
    "coulomb_viscous": ("Mc", "sigma_2"),
    "stribeck": ("Mc", "Ms", "sigma_2"),
    "load_dependent": ("Mc", "sigma_2", "mu_gc"),
    "stribeck_load_dependent": ("Mc", "Ms", "sigma_2", "mu_gc", "mu_gs"),
}
"""Friction terms of each model (rung) of the ladder, simplest first; here alone a rung is added."""

TRANSMITTED, DIRECTIONAL = "stribeck_transmitted_load", "stribeck_directional_load"
SIMULATED: Mapping[str, tuple[str, ...]] = {
    "stribeck": LADDER["stribeck"],
    "stribeck_load_dependent": LADDER["stribeck_load_dependent"],
    TRANSMITTED: LADDER["stribeck_load_dependent"],
    DIRECTIONAL: (*LADDER["stribeck_load_dependent"], "mu_gd"),
}
"""Friction terms of each rung, for fits that compare simulated with measured angles.

The load of the last two rungs is |external torque - mu_gd motor torque|. With mu_gd = 1 this load
is the torque that the gear teeth transmit; with a free mu_gd, friction depends on whether the motor
drives the load or is driven by it. These two rungs need a simulated motor torque: the noise of a
measured motor torque in a regressor would correlate with the residual.
"""

PAPER_FRICTION = "stribeck"
"""Model of the ladder that is the paper's system load, eq. 9."""


def rises(rung: str) -> bool:
    """Return whether a rung has static friction above Coulomb friction and a Stribeck speed."""
    return "Ms" in LADDER[rung]


def bears_load(rung: str) -> bool:
    """Return whether the friction of a rung grows with the load torque of a pendulum."""
    return "mu_gc" in {**LADDER, **SIMULATED}[rung]


def drive_share(rung: str) -> float:
    """Return the weight mu_gd of the motor torque in a rung's load; its start value if fitted."""
    return 1.0 if rung in (TRANSMITTED, DIRECTIONAL) else 0.0
