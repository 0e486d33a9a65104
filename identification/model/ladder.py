"""The ladder of friction models: models of increasing complexity, and the terms of each.

The terms are those of eq. 9 and two terms of friction that grows with the load of the gear, as in
the bracket of eq. 13: ``mu_gc`` and ``mu_gs`` multiply the magnitude of a known load torque, such
as that of a pendulum, m g l sin(angle - zero). Both falling parts have the Stribeck speed omega_sf.
"""

from __future__ import annotations

from collections.abc import Mapping

LADDER: Mapping[str, tuple[str, ...]] = {
    "coulomb_viscous": ("Mc", "sigma_2"),
    "stribeck": ("Mc", "Ms", "sigma_2"),
    "load_dependent": ("Mc", "sigma_2", "mu_gc"),
    "stribeck_load_dependent": ("Mc", "Ms", "sigma_2", "mu_gc", "mu_gs"),
}
"""Friction terms of each model (rung) of the ladder, simplest first. A new rung is added to this
table only.
"""

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
    """Return the weight mu_gd of the motor torque in the load of a rung; if mu_gd is fitted, its
    start value.
    """
    return 1.0 if rung in (TRANSMITTED, DIRECTIONAL) else 0.0
