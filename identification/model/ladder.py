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

TRANSMITTED, DIRECTIONAL = "stribeck_transmitted_load", "stribeck_directional_load"
SIMULATED: Mapping[str, tuple[str, ...]] = {
    "stribeck": LADDER["stribeck"],
    "stribeck_load_dependent": LADDER["stribeck_load_dependent"],
    TRANSMITTED: LADDER["stribeck_load_dependent"],
    DIRECTIONAL: (*LADDER["stribeck_load_dependent"], "mu_gd"),
}
"""Rung to its friction terms, of the fits to the simulated angle.

The load of the last two is |external - mu_gd motor torque|: with mu_gd = 1 the torque that the
teeth transmit; a free mu_gd makes friction differ by whether the motor drives or is driven. They
need a simulated motor torque: with the measured one as a regressor, its own errors would fit it.
"""

NOMINAL = "stribeck"
"""The paper's system load, eq. 9."""


def rises(rung: str) -> bool:
    """Whether friction rises toward rest, with a Stribeck speed."""
    return "Ms" in LADDER[rung]


def bears_load(rung: str) -> bool:
    """Whether friction grows with the load torque of a pendulum."""
    return "mu_gc" in {**LADDER, **SIMULATED}[rung]


def drive_share(rung: str) -> float:
    """Weight mu_gd of the motor's torque in the load of a rung; its start where it is fitted."""
    return 1.0 if rung in (TRANSMITTED, DIRECTIONAL) else 0.0
