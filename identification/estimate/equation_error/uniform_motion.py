"""The conventional method: fits a Stribeck curve to the motor torque in uniform motion (eq. 14).

The method needs motion at constant speed, but neither the inertia nor derivatives. If the joint
sticks and slips, the mean torque is not the friction at the mean speed. Stick-slip is detected by
the spread of the speed, because it does not change the mean speed.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.equation_error.variable_projection import solve
from identification.model.friction import stribeck_shape, system_friction
from identification.numerics.arrays import Array
from identification.numerics.bounded_least_squares import Design
from identification.recording import Recording

LEAST_S = 0.4
"""Shortest interval of constant commanded speed that is used."""
SETTLING_SHARE = 0.4
"""Share of each interval that is omitted at the start, while the joint accelerates."""
SMOOTHING_S = 0.02
"""Averaging time of the speed whose spread is computed, s; averaging removes the effect of encoder
steps, but not slips.
"""
UNIFORM = 0.2
"""Greatest spread of the speed, rms relative to the mean, that counts as uniform motion."""
_SPEED_UNIT = 1e-9  # rad per sample: commanded speeds count as equal if they differ by less
_LEAST_SPEEDS = 4  # distinct speeds, as many as a curve has parameters
_DIGITS = 6  # decimals of a speed in rad/s; speeds count as equal if they agree in these decimals


@dataclass(frozen=True)
class UniformPoint:
    """One interval of constant commanded speed.

    Attributes:
        recording: Name of the recording.
        speed: Commanded speed with sign, rad/s.
        torque: Mean torque of the motor at the joint, N m.
        spread: Rms deviation of the measured speed from its mean, relative to the commanded speed.
        moment: Contact moment F_P L1, N m.
    """

    recording: str
    speed: float
    torque: float
    spread: float
    moment: float

    @property
    def uniform(self) -> bool:
        """Whether the joint moved uniformly, as the method assumes."""
        return self.spread <= UNIFORM

    @property
    def friction(self) -> float:
        """Friction at the commanded speed by eq. 14, in the direction of motion, N m."""
        return self.torque if self.speed > 0.0 else -self.torque


def uniform_points(recording: Recording) -> list[UniformPoint]:
    """Return a point for each interval of constant commanded speed.

    Raises:
        KeyError: The recording lacks command, angle, or both torque and current.
    """
    channels = recording.channels
    steps = np.diff(channels["command"])
    ends = np.flatnonzero(np.abs(np.diff(steps)) > _SPEED_UNIT) + 1
    bounds = [0, *ends.tolist(), len(steps)]
    period = recording.period
    angle = channels["angle"]
    torque = (
        channels["torque"]
        if "torque" in channels
        else recording.bench.ampere_torque * channels["current"]
    )
    n = max(1, round(SMOOTHING_S / period))
    found = []
    for start, end in itertools.pairwise(bounds):
        speed = float(np.mean(steps[start:end])) / period
        if abs(speed) * period < _SPEED_UNIT or (end - start) * period < LEAST_S:
            continue
        first = start + round(SETTLING_SHARE * (end - start))
        measured = (angle[first + n : end] - angle[first : end - n]) / (n * period)
        found.append(
            UniformPoint(
                recording.name,
                speed,
                float(np.mean(torque[first:end])),
                float(np.sqrt(np.mean((measured - speed) ** 2)) / abs(speed)),
                recording.contact_force * (recording.bench.moment_arm or 0.0),
            )
        )
    return found


def fit_uniform(points: Sequence[UniformPoint], alpha: float = 2.0) -> dict[str, float]:
    """Fit eq. 9 to the unloaded points, then the bracket of eq. 12 to the loaded points.

    Returns:
        Parameter name to value; the parameters of a stage with fewer speeds than parameters are
        omitted.
    """
    unloaded = [p for p in points if p.moment == 0.0]
    loaded = [p for p in points if p.moment > 0.0]
    if _distinct(unloaded) < _LEAST_SPEEDS:
        return {}
    found = _fit(
        _speeds(unloaded), np.array([p.friction for p in unloaded]), np.ones(len(unloaded)), alpha
    )
    system = dict(zip(("Mc", "Ms", "omega_sf", "sigma_2"), found, strict=True))
    if _distinct(loaded) < _LEAST_SPEEDS:
        return system
    rest = np.array([p.friction for p in loaded]) - system_friction(_speeds(loaded), system, alpha)
    load = _fit(_speeds(loaded), rest, np.array([p.moment for p in loaded]), alpha)
    return {**system, **dict(zip(("mu_c", "mu_s", "omega_sL", "mu_2"), load, strict=True))}


def errors_percent(found: Mapping[str, float], truth: Mapping[str, float]) -> dict[str, float]:
    """Return the error of each estimated parameter in percent of the true value."""
    return {name: 100.0 * (value / truth[name] - 1.0) for name, value in found.items()}


def _distinct(points: Sequence[UniformPoint]) -> int:
    return len({round(abs(p.speed), _DIGITS) for p in points})


def _speeds(points: Sequence[UniformPoint]) -> Array:
    return np.array([abs(p.speed) for p in points])


def _fit(
    speed: Array, friction: Array, scale: Array, alpha: float
) -> tuple[float, float, float, float]:
    """Return Coulomb level, static level, Stribeck speed and viscous coefficient of the curve
    fitted to points; ``scale`` is 1 or the contact moment.
    """
    low = np.zeros(3)
    high = np.array([np.inf, 2.0 * float(np.max(np.abs(friction / scale))), np.inf])

    def design(omega_s: float) -> Design:
        columns = np.column_stack(
            [np.ones_like(speed), stribeck_shape(speed, omega_s, alpha), speed]
        )
        return Design(columns * scale[:, None], friction, low, high)

    best = solve(design, 0.5 * float(np.min(speed)), 2.0 * float(np.max(speed)))
    coulomb, rise, viscous = (float(c) for c in best.coefficients)
    return coulomb, coulomb + rise, best.omega_s, viscous
