"""Fits constants, effects and the state at the start of each recording jointly, by simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.gas.burns import (
    CONSTANTS,
    PRESSURE,
    PROPELLANT,
    VOLUME,
    Burn,
    generator,
    nominal_constants,
)
from identification.effects.gas_generator import GasEffect, effect_at
from identification.model import gas_generator as kernel
from identification.model.gas_generator import constants
from identification.numerics.least_squares import minimise
from identification.recording import Array
from identification.signals import BoolArray

_STEP = 0.01
"""Step of numerical derivatives, in the units of the fit."""
_STAGES = ((1e4, 1e-3, 10), (1.0, 1e-6, 25))
"""Stages of the fit: factor on the weight of the priors of valve and sensors, relative decrease of
the cost below which a stage ends, and greatest number of steps. The constants of valve and sensors
are almost fixed until all other parameters have converged; from distant start values they would
move far from their nominal values.
"""
_FARTHEST, _FIRM_FARTHEST = 6.0, 15.0
"""Limits of the constants of the propellant, and of valve and sensors, in tolerances. Without
limits, the filling of a chamber ten times as large would explain any slow mismatch.
"""
_REJECTED = 1e6
"""Residual, relative to the noise, that is returned beyond the limits."""


@dataclass(frozen=True)
class Start:
    """State at the first row of a recording: pressure in Pa, free volume in m^3."""

    pressure: float
    volume: float


@dataclass(frozen=True)
class Model:
    """Fitted quantities: constants by name, start of each recording, effects in the order of their
    addition.
    """

    constants: Mapping[str, float]
    starts: tuple[Start, ...]
    effects: tuple[GasEffect, ...] = ()


@dataclass(frozen=True)
class Fitted:
    """A model fitted to all recordings.

    Attributes:
        model: Fitted quantities.
        simulated: Simulated transducer signal of all rows, Pa, shape (n,).
        residual: Measured less simulated over the noise, shape (n,).
        tangent: Derivative of the simulated rows, over the noise, with respect to all fitted
            quantities, shape (n, p); the parameters of the effects come last.
        held: Weight of the prior of each fitted quantity, shape (p,).
        pull: Nominal less fitted value over the tolerance, shape (p,); zero without a prior.
        firm: Mask of the fitted quantities that belong to valve and sensors, shape (p,).
    """

    model: Model
    simulated: Array
    residual: Array
    tangent: Array
    held: Array
    pull: Array
    firm: BoolArray

    @property
    def cost(self) -> float:
        """Sum of whitened squares, including the priors."""
        return float(self.residual @ self.residual + self.pull @ self.pull)


def nominal_model(burns: Sequence[Burn]) -> Model:
    """Return the model with nominal constants; each recording starts at its first pressure."""
    g = generator(burns[0])
    return Model(nominal_constants(g), tuple(Start(b.first_pressure, g.V_0) for b in burns))


def fit(burns: Sequence[Burn], sigma: float, start: Model, *, shared: bool = True) -> Fitted:
    """Fit a model to recordings by least squares of the pressure.

    Args:
        burns: Recordings to fit.
        sigma: Noise of a row, Pa.
        start: Start values, with the effects to fit.
        shared: Whether constants and effects are fitted too; otherwise only the state at the start
            of each recording is fitted.
    """
    layout = _Layout(burns, start, shared)
    measured = np.concatenate([b.pressure for b in burns])
    x = layout.start
    for stiffness, tolerance, most_steps in _STAGES:
        held = np.where(layout.firm, stiffness, 1.0) * layout.held
        x = _minimised(burns, sigma, layout, x, held, tolerance, most_steps)
    model = layout.model(x)
    simulated = simulate(burns, model)
    tangent = _tangent(burns, layout, x) / sigma
    return Fitted(
        model,
        simulated,
        (measured - simulated) / sigma,
        tangent,
        layout.held,
        -layout.held * x,
        layout.firm,
    )


def _minimised(
    burns: Sequence[Burn],
    sigma: float,
    layout: _Layout,
    start: Array,
    held: Array,
    tolerance: float,
    most_steps: int,
) -> Array:
    """Return the least-squares solution with priors of weight ``held``."""
    measured = np.concatenate([b.pressure for b in burns])

    def residuals(x: Array) -> Array:
        if np.any(np.abs(layout.held * x) > np.where(layout.firm, _FIRM_FARTHEST, _FARTHEST)):
            return np.full(len(measured) + len(x), _REJECTED)
        return np.concatenate(((simulate(burns, layout.model(x)) - measured) / sigma, held * x))

    def jacobian(x: Array, _residual: Array) -> Array:
        return np.concatenate((_tangent(burns, layout, x) / sigma, np.diag(held)))

    return minimise(
        residuals, jacobian, start, threshold=math.inf, tolerance=tolerance, most_steps=most_steps
    ).x


def simulate(burns: Sequence[Burn], model: Model) -> Array:
    """Return the simulated transducer signal of all rows, Pa, shape (n,)."""
    return np.concatenate([transducer_signal(simulated_burn(b, model), model) for b in burns])


def transducer_signal(marched: Array, model: Model) -> Array:
    """Return the signal of a transducer with zero error and delay, Pa, shape (n,)."""
    pressure, _, rise = marched
    return np.asarray(pressure + model.constants["pressure_zero"] - model.constants["delay"] * rise)


def simulated_burn(burn: Burn, model: Model) -> Array:
    """Return simulated pressure (Pa), web burnt (m) and rate of pressure (Pa/s) of one recording,
    shape (3, n).
    """
    start, own, given = (
        model.starts[burn.index],
        nominal_constants(generator(burn)),
        model.constants,
    )
    off = np.array([given[name] - own[name] for name in ("angle_zero", "d", "D", "b")])
    areas = burn.areas.copy()
    areas[0] += off @ burn.shifts
    c = constants(generator(burn), given, start.pressure, start.volume)
    out = np.empty((3, len(burn.time)))
    kernel.march(burn.time, areas, c, effect_vector(model.effects), out)
    return out


def effect_vector(effects: Sequence[GasEffect]) -> Array:
    """Return the effects as the kernel's parameter vector."""
    e = np.zeros(kernel.MISSING_SIZE)
    for effect in effects:
        for name, size in effect.term.sizes.items():
            e[size.slot] = effect.parameters[name]
    return e


class _Layout:
    """Layout of the fitted vector, whose entries are deviations from nominal values in
    tolerances.
    """

    def __init__(self, burns: Sequence[Burn], start: Model, shared: bool) -> None:
        self._believed, self._given = nominal_model(burns), start
        self.constants = CONSTANTS if shared else {}
        self.effects = start.effects if shared else ()
        self.shared, self.ends = len(self.constants), len(self.constants) + 2 * len(burns)
        inner = [
            c.steps(self._believed.constants[k], start.constants[k])
            for k, c in self.constants.items()
        ]
        for mine, own in zip(start.starts, self._believed.starts, strict=True):
            inner += [
                VOLUME.steps(own.volume, mine.volume),
                PRESSURE.steps(own.pressure, mine.pressure),
            ]
        inner += [x for effect in self.effects for x in effect.coordinates]
        self.start = np.array(inner)
        self.held = np.zeros(len(inner))
        self.held[: self.ends] = [1.0] * self.shared + [1.0, 0.0] * len(burns)
        self.firm = np.zeros(len(inner), dtype=np.bool_)
        self.firm[: self.shared] = [name not in PROPELLANT for name in self.constants]

    def model(self, x: Array) -> Model:
        """Return the model with the fitted quantities of a vector."""
        own = self._believed
        moved = {
            k: c.moved(own.constants[k], float(v))
            for (k, c), v in zip(self.constants.items(), x, strict=False)
        }
        pairs = x[self.shared : self.ends].reshape(-1, 2)
        starts = tuple(
            Start(PRESSURE.moved(b.pressure, float(p)), VOLUME.moved(b.volume, float(v)))
            for b, (v, p) in zip(own.starts, pairs, strict=True)
        )
        effects, at = [], self.ends
        for effect in self.effects:
            count = len(effect.term.sizes)
            effects.append(effect_at(effect.term, tuple(float(v) for v in x[at : at + count])))
            at += count
        return Model(
            {**self._given.constants, **moved}, starts, tuple(effects) or self._given.effects
        )

    def touches(self, k: int) -> int | None:
        """Return the recording that the entry ``k`` of the vector affects, or None if this entry
        affects all recordings.
        """
        return (k - self.shared) // 2 if self.shared <= k < self.ends else None


def _tangent(burns: Sequence[Burn], layout: _Layout, x: Array) -> Array:
    """Return the derivative of the simulated pressure with respect to the fitted vector, Pa, shape
    (n, p).
    """
    here = [simulate((b,), layout.model(x)) for b in burns]
    edges = np.cumsum([0, *(len(p) for p in here)])
    out = np.zeros((edges[-1], len(x)))
    for k in range(len(x)):
        moved = x.copy()
        moved[k] += _STEP
        model, own = layout.model(moved), layout.touches(k)
        for j, burn in enumerate(burns):
            if own is None or own == j:
                out[edges[j] : edges[j + 1], k] = (simulate((burn,), model) - here[j]) / _STEP
    return out
