"""The ladder of friction models that a bench may declare, and the terms of each.

Terms are those of eq. 9, and two of the bracket of eq. 13 for the load a gear carries: ``mu_gc``
and ``mu_gs`` multiply the magnitude of a known load torque, a pendulum's m g l sin(angle - zero).
The falling parts of both share omega_sf.
"""

from __future__ import annotations

from collections.abc import Mapping

LADDER: Mapping[str, tuple[str, ...]] = {
    "coulomb_viscous": ("Mc", "sigma_2"),
    "stribeck": ("Mc", "Ms", "sigma_2"),
    "load_dependent": ("Mc", "sigma_2", "mu_gc"),
    "stribeck_load_dependent": ("Mc", "Ms", "sigma_2", "mu_gc", "mu_gs"),
}
"""Rung to its friction terms, simplest first; a rung is added here and nowhere else."""

NOMINAL = "stribeck"
"""The paper's system load, eq. 9."""


def rises(rung: str) -> bool:
    """Whether friction rises toward rest, with a Stribeck speed."""
    return "Ms" in LADDER[rung]


def bears_load(rung: str) -> bool:
    """Whether friction grows with the load torque of a pendulum."""
    return "mu_gc" in LADDER[rung]
