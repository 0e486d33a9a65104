"""Records of the limits of a run, in SI units at the joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GasLimits:
    """Limits on the gas generator: chamber pressure, Pa, and the resulting contact force, N (eq.
    10).

    ``back_pressure`` is p_c0, Pa; ``area`` gives A_s, m^2, at a joint angle in rad.
    """

    pressure: float
    contact_force: float
    back_pressure: float
    area: Callable[[float], float]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits in SI units at the joint, with the two constants that the checks need.

    ``torque_per_ampere`` is Km i, N m/A; ``gear_ratio`` is i. ``gas`` is None on a bench without a
    pressure transmitter. ``reports_temperature`` and ``reports_supply`` are False for a drive that
    does not report its temperature or supply voltage; limits on values that the drive does not
    report, and infinite limits, are not checked.
    """

    angle_min: float
    angle_max: float
    speed: float
    torque: float
    current: float
    following_error: float
    encoder_disagreement: float
    temperature: float
    supply_min: float
    supply_max: float
    sample_age: float
    lateness: float
    torque_per_ampere: float
    gear_ratio: float
    gas: GasLimits | None = None
    reports_temperature: bool = True
    reports_supply: bool = True
