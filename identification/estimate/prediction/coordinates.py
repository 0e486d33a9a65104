"""Defines the search coordinates of the fit to the predicted angle: friction, motor constants,
delay (M50).

The coordinates contain rises instead of static levels, and the logarithms of the Stribeck speed and
of the ratios of motor constants. The lateness of the command is the delay with which a logged
command acts. All coordinates have bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.prediction.pieces import Motor, Piece
from identification.model.ladder import SIMULATED, bears_load, drive_share
from identification.model.parameters import DRIVE_SHARE
from identification.numerics.arrays import Array
from identification.numerics.bounded_descent import Box
from identification.recording import Model, Recording

CONSTANTS = ("torque_constant", "resistance")
LATENESS = "lateness"
RELATIVE_STD = 0.3
"""Relative standard deviation of a motor constant, unless the campaign states one. Motor constants
deviate because of warm windings, tolerances of magnets, and torque losses in gears.
"""
_FASTEST_SHARE, _SLOWEST_SHARE = 1.0 / 3.0, 1e-3
_LATEST = 5.0
"""Greatest lateness, in sample periods."""
_MOST_MU, _MOST_SHARE = 0.9, 5.0


@dataclass(frozen=True)
class Scales:
    """Sizes of the signals, SI, from which bounds and steps of finite differences follow.

    Attributes:
        torque: Greatest drive torque.
        speed: Greatest speed.
        inertia: Inertia at the start of the search.
        period: Sample period.
    """

    torque: float
    speed: float
    inertia: float
    period: float


@dataclass(frozen=True)
class Axis:
    """Bounds of one coordinate, and its step for finite differences."""

    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Point:
    """The parameters of one simulation.

    Attributes:
        values: Friction and inertia by name, SI.
        motor: Ratios of the motor constants to the declared motor constants.
        lateness: Delay with which a logged command acts, s.
    """

    values: Mapping[str, float]
    motor: Motor
    lateness: float


@dataclass(frozen=True)
class Coordinates:
    """The free coordinates of one friction model (rung) of the ladder.

    Attributes:
        rung: Name of the rung, of :data:`identification.model.ladder.SIMULATED`.
        names: Free coordinates, in the order of x.
        axes: Bounds and step of each coordinate, by name.
        model: Declared model; its fixed parameters do not change.
        prior: Standard deviation of the prior of a coordinate, by name; a prior is centred at 0.
    """

    rung: str
    names: tuple[str, ...]
    axes: Mapping[str, Axis]
    model: Model
    prior: Mapping[str, float]

    @property
    def box(self) -> Box:
        """Bounds of x."""
        axes = [self.axes[n] for n in self.names]
        return Box(np.array([a.low for a in axes]), np.array([a.high for a in axes]))

    def steps(self) -> Array:
        """Return the steps of finite differences, shape (p,)."""
        return np.array([self.axes[n].step for n in self.names])

    def start(self, values: Mapping[str, float]) -> Array:
        """Return the coordinates of named parameters, with the declared motor constants, shape
        (p,).
        """
        share = drive_share(self.rung)
        # At rest the motor torque balances the external torque, so that the transmitted load
        # |external torque - motor torque| is twice the external torque.
        carried = 1.0 + share
        coulomb, gear = values.get("Mc", 0.0), values.get("mu_gc", 0.0)
        x = {
            "Mc": coulomb,
            "rise": max(values.get("Ms", 0.0) - coulomb, 0.0),
            "omega_sf": math.log(max(values.get("omega_sf", 1.0), 1e-12)),
            "sigma_2": values.get("sigma_2", 0.0),
            "J": values.get("J", 0.0),
            "mu_gc": gear / carried,
            "gear_rise": max(values.get("mu_gs", 0.0) - gear, 0.0) / carried,
            DRIVE_SHARE: share,
            "offset": values.get("offset", 0.0),
        }
        return self.box.clip(np.array([x.get(n, 0.0) for n in self.names]))

    def point(self, x: Array) -> Point:
        """Return the parameters at x."""
        found = dict(zip(self.names, (float(v) for v in x), strict=True))
        fixed = self.model.fixed
        values = {n: float(v) for n, v in fixed.items()}
        values |= {n: found[n] for n in ("Mc", "sigma_2", "J", "mu_gc", "offset") if n in found}
        if "rise" in found:
            values["Ms"] = values["Mc"] + found["rise"]
        if "omega_sf" in found:
            values["omega_sf"] = math.exp(found["omega_sf"])
        if "gear_rise" in found:
            values["mu_gs"] = values["mu_gc"] + found["gear_rise"]
        share = found.get(DRIVE_SHARE, drive_share(self.rung))
        if share:
            values[DRIVE_SHARE] = share
        motor = Motor(**{n: math.exp(found.get(n, 0.0)) for n in CONSTANTS})
        return Point(values, motor, found.get(LATENESS, 0.0))

    def prior_rows(self, x: Array) -> Array:
        """Return the standardised distances from the centres of the priors, shape (k,)."""
        at = dict(zip(self.names, x, strict=True))
        return np.array([at[n] / s for n, s in self.prior.items()])


def priors(recording: Recording) -> dict[str, float]:
    """Return the standard deviation of the logarithm of each motor constant."""
    bench, stated = recording.bench, recording.uncertainties
    declared = {"torque_constant": bench.torque_constant, "resistance": bench.resistance}
    return {
        name: stated.get(f"bench.{name}", RELATIVE_STD * value) / value
        for name, value in declared.items()
        if value is not None
    }


def coordinates(
    rung: str, model: Model, pieces: Sequence[Piece], scales: Scales, *, free: bool
) -> Coordinates:
    """Return the coordinates of one friction model (rung).

    Args:
        rung: Name of the rung.
        model: Declared model.
        pieces: Pieces of recordings that are predicted.
        scales: Sizes of the signals.
        free: Whether the motor constants are free, within their priors.
    """
    t, w = scales.torque, scales.speed
    small = 5e-4 * t
    axes = {
        "Mc": Axis(0.0, t, small),
        "rise": Axis(0.0, t, small),
        "omega_sf": Axis(math.log(_SLOWEST_SHARE * w), math.log(_FASTEST_SHARE * w), 1e-2),
        "sigma_2": Axis(0.0, t / w, 2e-3 * t / w),
        "J": Axis(1e-3 * scales.inertia, 1e2 * scales.inertia, 1e-2 * scales.inertia),
        "mu_gc": Axis(0.0, _MOST_MU, 1e-3),
        "gear_rise": Axis(0.0, _MOST_MU, 1e-3),
        DRIVE_SHARE: Axis(0.0, _MOST_SHARE, 5e-3),
        "offset": Axis(-t, t, small),
        "torque_constant": Axis(-1.5, 1.5, 3e-3),
        "resistance": Axis(-1.5, 1.5, 3e-3),
        LATENESS: Axis(0.0, _LATEST * scales.period, 0.03 * scales.period),
    }
    looped = [p.recording.controller for p in pieces if "command" in p.recording.channels]
    driven = any(p.volts for p in pieces) or any(c and c.output != "torque" for c in looped)
    names = ["Mc", "rise", "omega_sf", "sigma_2", "J"]
    names += ["mu_gc", "gear_rise"] if bears_load(rung) else []
    names += [DRIVE_SHARE] if DRIVE_SHARE in SIMULATED[rung] else []
    names += ["offset"] if "offset" in model.terms else []
    held = set(model.fixed) | ({"rise"} if "Ms" in model.fixed else set())
    prior = {}
    if free and driven:
        prior = priors(pieces[0].recording)
    names = [n for n in names if n not in held] + list(prior)
    names += [LATENESS] if any(looped) else []
    return Coordinates(rung, tuple(names), axes, model, prior)
