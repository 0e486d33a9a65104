"""The catalogue: one class per effect, with its words, parameters, equations and response; nothing
else names an effect.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from types import ModuleType

from identification.effects import device, friction, gas_generator, motor, sensing, transmission
from identification.effects.effect import Effect
from identification.effects.gas_generator import GasGeneratorEffect
from identification.effects.own import EffectError, OwnEffect


def _of(module: ModuleType) -> tuple[Effect, ...]:
    """Return the effects of a module in the order of their definition."""
    own = (c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, Effect))
    return tuple(c() for c in own if c.__module__ == module.__name__ and "equation" in vars(c))


MOTION: tuple[Effect, ...] = tuple(
    e for module in (motor, transmission, friction, device, sensing) for e in _of(module)
)
"""Effects of machine and sensors, in the order of the catalogue."""
GAS: tuple[GasGeneratorEffect, ...] = tuple(
    e for e in _of(gas_generator) if isinstance(e, GasGeneratorEffect)
)
"""Effects of the gas generator, which another model computes
(:mod:`identification.model.gas_generator`).
"""
EFFECTS: Mapping[str, Effect] = {e.name: e for e in (*MOTION, *GAS)}
"""Name to effect, in the order of the catalogue."""


def with_own(effects: Sequence[Effect | type[Effect]]) -> Mapping[str, Effect]:
    """Return the catalogue with effects of one's own, by name.

    Raises:
        EffectError: Two effects have one name.
    """
    found = dict(EFFECTS)
    for given in effects:
        entry = given() if isinstance(given, type) else given
        if entry.name in found:
            place = entry.placed if isinstance(entry, OwnEffect) else ""
            other = "the catalogue has" if entry.name in EFFECTS else "there is"
            raise EffectError(f"{place}{entry.name}: {other} an effect of this name; rename it")
        found[entry.name] = entry
    return found
