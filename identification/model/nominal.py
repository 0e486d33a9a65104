"""Nominal parameter values: friction from the paper (Sec. 4.2), inertia from a bench file."""

from __future__ import annotations

from collections.abc import Mapping

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
