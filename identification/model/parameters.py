"""Parameters of the nominal model: names, units, and places in the vector for compiled kernels.

The vector holds the rises dM = Ms - Mc and dmu = mu_s - mu_c, and not the static levels of the
tables, because searches bound the rises and regressions are linear in the rises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.model.units import LINEAR, unit_on
from identification.numerics.arrays import Array

SYSTEM_PARAMETERS = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
"""Parameters that the unloaded fit determines (eq. 16)."""
LOAD_PARAMETERS = ("mu_c", "mu_s", "omega_sL", "mu_2")
"""Parameters that the loaded fit determines (eq. 15)."""
GEAR_PARAMETERS = ("mu_gc", "mu_gs")
"""Parameters that the unloaded fit determines if friction grows with a pendulum's torque."""
DRIVE_SHARE = "mu_gd"
"""Weight of the drive's torque in the transmitted load, relative to the weight of the external
torque.
"""
STRIBECK_TERMS = (
    ("Mc", "Ms", "omega_sf"),
    ("mu_c", "mu_s", "omega_sL"),
    ("mu_gc", "mu_gs", "omega_sf"),
)
"""Coulomb level, static level and Stribeck speed of each part of friction that may rise as the
speed falls to zero.
"""

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
UNITS_LINEAR: Mapping[str, str] = {
    name: unit_on(LINEAR, unit) for name, unit in UNITS_ROTARY.items()
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
"""Place of each fitted parameter in the vector, by name; the place of a static level holds the
rise.
"""
COULOMB_OF: Mapping[str, int] = {"Ms": MC, "mu_s": MU_C}
"""Place of the Coulomb level that belongs to each static level."""
LOGARITHMIC = (OMEGA_SF, OMEGA_SL, INERTIA)
"""Places of the parameters that are always positive; a search varies their logarithms."""


def pack(values: Mapping[str, float], alpha: float) -> Array:
    """Return the vector of named parameters, shape (SIZE,).

    A parameter that is absent has no effect. A static level below its Coulomb level counts as the
    Coulomb level.

    Args:
        values: Parameter name to value, SI.
        alpha: Stribeck exponent.
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
