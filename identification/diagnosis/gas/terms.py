"""Table of the gas generator's effects: their slots in the kernel's parameter vector, scales and
trial values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from identification.model import gas_generator as kernel


@dataclass(frozen=True)
class Size:
    """One parameter of an effect.

    Attributes:
        slot: Index in the kernel's vector of effects.
        scale: A typical observable size, in the unit of the parameter; the fit uses multiples of
            it.
        trials: Start values of a nonlinear parameter, whose logarithm is fitted; empty for a size.
    """

    slot: int
    scale: float
    trials: tuple[float, ...] = ()


@dataclass(frozen=True)
class GasTerm:
    """One effect of the catalogue with its parameters; the first parameter is the size of the
    effect, which is zero if the effect is absent.

    Attributes:
        name: Stable name.
        sizes: Name of each parameter to its slot, scale and trial values.
    """

    name: str
    sizes: Mapping[str, Size]

    @property
    def shapes(self) -> tuple[tuple[float, ...], ...]:
        """Trial values of all parameters after the first, the nonlinear parameters."""
        shapes: tuple[tuple[float, ...], ...] = ((),)
        for size in list(self.sizes.values())[1:]:
            shapes = tuple((*shape, value) for shape in shapes for value in size.trials)
        return shapes


GAS_TERMS = (
    GasTerm("throat_deposition", {"rate_m_s": Size(kernel.LAYER_RATE, 1e-6)}),
    GasTerm("burning_area_change", {"taper_per_m": Size(kernel.TAPER, 0.01)}),
    GasTerm("erosive_burning", {"coefficient_s_m": Size(kernel.EROSION, 1e-3)}),
    GasTerm(
        "heat_loss",
        {
            "heat_flow_W": Size(kernel.HEAT_FLOW, 1e4),
            "time_s": Size(kernel.HEAT_TIME, 1.0, (1.0, 3.0, 10.0, 30.0)),
        },
    ),
    GasTerm("leakage", {"area_m2": Size(kernel.LEAK, 1e-6)}),
)
"""Terms in the order of the catalogue."""


@dataclass(frozen=True)
class GasEffect:
    """An effect with its parameters, by the catalogue's names."""

    term: GasTerm
    parameters: Mapping[str, float]

    @property
    def coordinates(self) -> tuple[float, ...]:
        """Coordinates of the fit: each parameter divided by its scale; for a parameter with trial
        values, the logarithm of this ratio.
        """
        return tuple(
            math.log(self.parameters[name] / size.scale)
            if size.trials
            else self.parameters[name] / size.scale
            for name, size in self.term.sizes.items()
        )


def effect_at(term: GasTerm, coordinates: tuple[float, ...]) -> GasEffect:
    """Return the effect at fitted coordinates; the inverse of :attr:`GasEffect.coordinates`."""
    sizes = zip(term.sizes.items(), coordinates, strict=True)
    return GasEffect(
        term, {n: s.scale * (math.exp(min(x, 20.0)) if s.trials else x) for (n, s), x in sizes}
    )
