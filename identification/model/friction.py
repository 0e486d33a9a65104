"""Stribeck friction as the paper writes it (eq. 9, bracket of eq. 12 and 13), linear but for the Stribeck speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.numerics.arrays import Array


def stribeck_shape(velocity: Array, omega_s: float, alpha: float) -> Array:
    """Return sgn(omega) exp(-|omega/omega_s|^alpha), the falling part of eq. 9, shape of ``velocity``."""
    return np.asarray(np.sign(velocity) * np.exp(-(np.abs(velocity / omega_s) ** alpha)))


def system_friction(velocity: Array, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return M_f of eq. 9 in N m while slipping (0 at rest, where friction is set-valued)."""
    p = parameters
    return np.asarray(
        p["Mc"] * np.sign(velocity)
        + (p["Ms"] - p["Mc"]) * stribeck_shape(velocity, p["omega_sf"], alpha)
        + p["sigma_2"] * velocity
    )


def load_coefficient(velocity: Array, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return m_L of eq. 12, dimensionless; times F_P L1 it is the working load M_L of eq. 13."""
    p = parameters
    return np.asarray(
        p["mu_c"] * np.sign(velocity)
        + (p["mu_s"] - p["mu_c"]) * stribeck_shape(velocity, p["omega_sL"], alpha)
        + p["mu_2"] * velocity
    )
