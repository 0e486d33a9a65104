"""Constants of the propellant, the start of each burn and named effects, fitted together by forward simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.gas.burns import Burn, generator
from identification.diagnosis.gas.terms import GasEffect, effect_at
from identification.estimate.levenberg import minimise
from identification.model import gas_kernel as kernel
from identification.model.gas_generator import SHARED, constants
from identification.recording import Array

TOLERANCE: Mapping[str, float] = {"a": 0.1, "n": 0.03, "C_r": 0.05, "V_0": 0.3}
"""How far the believed constants may be off, one standard deviation: a share of each, for n a difference.

A propellant's lots differ in burning rate; a strand burner gives n to a few hundredths; free volumes are what the
igniter and the grain's length have left.
"""
_START_SHARE = 0.01
"""Unit of the start pressure, as a share; it is not held to anything."""
_STEP = 0.01
"""Of numerical derivatives, in the units of the fit."""
_OUTLIER = 6.0
_SETTLED = 1e-6
_MOST_STEPS = 25
_FARTHEST = 8.0
"""Tolerances beyond which no constant is looked for: such a chamber could not be marched either..."""
_REJECTED = 1e6
"""... and the residual there, over the noise."""


@dataclass(frozen=True)
class Start:
    """State of one burn at its first row: pressure in Pa, free volume in m^3."""

    pressure: float
    volume: float


@dataclass(frozen=True)
class Model:
    """What is fitted: propellant constants by name, the start of each burn, effects in the order they were added."""

    constants: Mapping[str, float]
    starts: tuple[Start, ...]
    effects: tuple[GasEffect, ...] = ()


@dataclass(frozen=True)
class Fitted:
    """A model fitted to all burns.

    Attributes:
        model: Its values.
        simulated: Pressure of all rows, Pa, shape (n,).
        residual: Measured less simulated over the noise, shape (n,).
        tangent: Derivative of the simulated rows over the noise by everything that was fitted, shape (n, p); the
            effects' parameters come last.
        held: Weight that holds each of those to what was believed, shape (p,).
    """

    model: Model
    simulated: Array
    residual: Array
    tangent: Array
    held: Array

    @property
    def cost(self) -> float:
        """Sum of whitened squares."""
        return float(self.residual @ self.residual)


def believed(burns: Sequence[Burn]) -> Model:
    """Return the model with what is believed of it, each burn from its first pressure."""
    g = generator(burns[0])
    return Model({name: getattr(g, name) for name in SHARED}, tuple(Start(b.first_pressure, g.V_0) for b in burns))


def fit(burns: Sequence[Burn], sigma: float, start: Model, *, propellant: bool = True) -> Fitted:
    """Fit a model to burns by least squares of the pressure, outliers held back.

    Args:
        burns: Recordings to fit.
        sigma: Noise of a row, Pa.
        start: To start from, with the effects to fit.
        propellant: Whether its constants and effects are fitted; else the start of each burn alone.
    """
    layout = _Layout(burns, start, propellant)
    measured = np.concatenate([b.pressure for b in burns])

    def residuals(x: Array) -> Array:
        if np.any(np.abs(layout.held * x) > _FARTHEST):
            return np.full(len(measured) + len(x), _REJECTED)
        simulated = simulate(burns, layout.model(x))
        return np.concatenate(((simulated - measured) / sigma, layout.held * x))

    def jacobian(x: Array, residual: Array) -> Array:
        return np.concatenate((_tangent(burns, layout, x) / sigma, np.diag(layout.held)))

    x = minimise(residuals, jacobian, layout.start, threshold=_OUTLIER, tolerance=_SETTLED, most_steps=_MOST_STEPS).x
    model = layout.model(x)
    simulated = simulate(burns, model)
    return Fitted(model, simulated, (measured - simulated) / sigma, _tangent(burns, layout, x) / sigma, layout.held)


def simulate(burns: Sequence[Burn], model: Model) -> Array:
    """Return the pressure of all rows, Pa, shape (n,)."""
    return np.concatenate([march(b, model)[0] for b in burns])


def march(burn: Burn, model: Model, place: int | None = None) -> Array:
    """Return pressure (Pa), web burnt (m) and gas temperature over the flame's of one burn, shape (3, n).

    Args:
        burn: Whose valve.
        model: With its start.
        place: Of its start among the model's; None takes the burn's own index.
    """
    start = model.starts[burn.index if place is None else place]
    c = constants(generator(burn), model.constants, start.pressure, start.volume)
    out = np.empty((3, len(burn.time)))
    kernel.march(burn.time, burn.areas, c, missing(model.effects), out)
    return out


def missing(effects: Sequence[GasEffect]) -> Array:
    """Pack effects for the march."""
    e = np.zeros(kernel.MISSING_SIZE)
    for effect in effects:
        for name, size in effect.term.sizes.items():
            e[size.slot] = effect.parameters[name]
    return e


class _Layout:
    """Where each number of a model stands in the vector that is fitted, and in which unit."""

    def __init__(self, burns: Sequence[Burn], start: Model, propellant: bool) -> None:
        self._believed, self._given, self._propellant = believed(burns), start, propellant
        self.shared = len(SHARED) if propellant else 0
        self.burns = len(burns)
        self.ends = self.shared + 2 * self.burns
        inner: list[float] = []
        if propellant:
            inner += [self._offset(name, start.constants[name]) for name in SHARED]
        for mine, own in zip(start.starts, self._believed.starts, strict=True):
            inner += [
                math.log(mine.volume / own.volume) / TOLERANCE["V_0"],
                math.log(mine.pressure / own.pressure) / _START_SHARE,
            ]
        if propellant:
            inner += [x for effect in start.effects for x in effect.coordinates]
        self.start = np.array(inner)
        self.held = np.zeros(len(inner))
        self.held[: self.ends] = [1.0] * self.shared + [1.0, 0.0] * self.burns

    def _offset(self, name: str, value: float) -> float:
        own = self._believed.constants[name]
        return (value - own if name == "n" else math.log(value / own)) / TOLERANCE[name]

    def model(self, x: Array) -> Model:
        """Return the model at a vector."""
        own, given = self._believed, self._given
        shared = dict(given.constants)
        for name, value in zip(SHARED[: self.shared], x, strict=False):
            moved = TOLERANCE[name] * float(value)
            shared[name] = own.constants[name] + moved if name == "n" else own.constants[name] * math.exp(moved)
        pairs = x[self.shared : self.ends].reshape(-1, 2)
        starts = tuple(
            Start(b.pressure * math.exp(_START_SHARE * p), b.volume * math.exp(TOLERANCE["V_0"] * v))
            for b, (v, p) in zip(own.starts, pairs, strict=True)
        )
        effects, at = [], self.ends
        for effect in given.effects if self._propellant else ():
            count = len(effect.term.sizes)
            effects.append(effect_at(effect.term, tuple(float(v) for v in x[at : at + count])))
            at += count
        return Model(shared, starts, tuple(effects) if self._propellant else given.effects)

    def touches(self, k: int) -> int | None:
        """Return the burn that alone an entry of the vector moves, or None."""
        return (k - self.shared) // 2 if self.shared <= k < self.ends else None


def _tangent(burns: Sequence[Burn], layout: _Layout, x: Array) -> Array:
    """Return the derivative of the simulated pressure, Pa, shape (n, p)."""
    here = [march(b, layout.model(x))[0] for b in burns]
    edges = np.cumsum([0, *(len(p) for p in here)])
    out = np.zeros((edges[-1], len(x)))
    for k in range(len(x)):
        moved = x.copy()
        moved[k] += _STEP
        model = layout.model(moved)
        own = layout.touches(k)
        for j, burn in enumerate(burns):
            if own is None or own == j:
                out[edges[j] : edges[j + 1], k] = (march(burn, model)[0] - here[j]) / _STEP
    return out
