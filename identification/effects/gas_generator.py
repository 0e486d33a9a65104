"""Effects that the paper's gas generator omits (Sec. 3.2, assumptions G1, G4, G5, and the throat of
eq. 3): they show in pressure and valve angle.
"""

from __future__ import annotations

from typing import Any

from identification.effects.effect import (
    EXACT,
    Coefficients,
    Dimension,
    Effect,
    Quantity,
    Shape,
    rows,
)
from identification.model import gas_generator as kernel
from identification.recording import Array

_ALIKE = (
    "Steps of the valve between its least and its greatest throat area, early and late in the "
    "burn, and a second burn at another pressure: with the valve at rest, changes of throat area, "
    "temperature and burning area have equal effects; in transients the pressure changes faster "
    "with a wider throat and more slowly with a colder gas; and the effect of a deposit depends on "
    "time, that of the grain on the burnt length."
)


class GasGeneratorEffect(Effect):
    """An effect of the gas generator, which the kernel of the burn simulates.

    Attributes:
        slots: Indices of the parameters in the kernel's vector of effects: of the size, which is
            zero if the effect is absent, and of the nonlinear parameters.
        scale: A typical observable size; the fit uses multiples of it too.
    """

    shows_in = "pressure"
    enters = ("pressure",)
    varies = ("pressure",)
    one_sided = True
    simulated = True
    shape_error = EXACT
    not_simulated = "the gas generator is another model; its constants are a block of a campaign"
    slots: tuple[int, ...]

    def pressure(self, view: Any, nominal: Any, shape: Shape) -> Array:
        """Return the change of the pressure over the size of the effect, Pa, shape (1, n)."""
        return rows(nominal.response(view, self, shape))

    def feeds_back(self, nominal: Any, shape: Shape, coefficients: Coefficients) -> Any:
        return nominal.with_effect(self, coefficients[0], shape)


class ThroatDeposition(GasGeneratorEffect):
    """Deposit that grows on the rims of the throat."""

    equation = "m_g = p_g A_t(theta; d - 2 h, D - 2 h) / C_r, dh/dt = k"
    assumption = "the implied assumption of eq. 3 and Fig. 3 that the throat keeps its diameters"
    coordinate = """time: the pressure rises during the burn at every angle, most where the throat
        is narrowest"""
    parameters = (Quantity("rate_m_s", Dimension.LAYER_RATE, 0.0, 2e-4),)
    look_alikes = ("burning_area_change", "heat_loss", "leakage")
    experiment = _ALIKE
    sentence = "a deposit grows on the rims of the throat at {rate_m_s:mm/min}"
    slots = (kernel.LAYER_RATE,)
    scale = 1e-6


class BurningAreaChange(GasGeneratorEffect):
    """Burning area that changes with the burnt length."""

    equation = "A_b = (pi D_P^2/4) (1 + t w)^2, w = integral of r dt"
    assumption = "assumption G1: end burning, the burning area constant (eq. 2)"
    coordinate = """web burnt: the pressure changes with the burnt length, by the same share at
        every angle"""
    parameters = (Quantity("taper_per_m", Dimension.TAPER, -2.0, 2.0),)
    look_alikes = ("throat_deposition", "heat_loss", "erosive_burning")
    experiment = _ALIKE
    sentence = """the grain's diameter {taper_per_m:?grows/shrinks} by {taper_per_m:abs %/m} of
        burnt length"""
    slots = (kernel.TAPER,)
    scale = 0.01
    one_sided = False


class ErosiveBurning(GasGeneratorEffect):
    """Burning rate that grows with the speed of the gas at the surface."""

    equation = """r = a p_g^n (1 + k u), u = A_t R_g T_g / (C_r A_b), the speed at which the gas
        leaves the surface"""
    assumption = "assumption G5: the burning rate depends on pressure alone (eq. 2)"
    coordinate = """throat area: at wide throats more pressure than eq. 2 gives, immediately when
        the valve opens"""
    parameters = (Quantity("coefficient_s_m", Dimension.EROSION, 0.0, 0.5),)
    look_alikes = ("leakage", "heat_loss", "burning_area_change")
    experiment = """Steps over the whole range of throat areas, with pauses at five or more areas.
        In a logarithmic plot of the steady pressure over the throat area, erosion bends the line
        upward at wide throats, a leak bends the line downward at narrow throats, and with a wrong
        exponent the line stays straight."""
    sentence = "the burning rate grows by {coefficient_s_m:%/(m/s)} of gas speed at the surface"
    slots = (kernel.EROSION,)
    scale = 1e-3


class HeatLoss(GasGeneratorEffect):
    """Heat that cold walls take from the gas."""

    equation = """m ds/dt = m_r (1 - s) - s Q / h_g, T_g = s T, Q = Q_0 exp(-t / tau), h_g =
        gamma/(gamma - 1) R_g T_g"""
    assumption = "assumption G4: the gas temperature remains unchanged (eq. 5, 6)"
    coordinate = """time: too little pressure at first, with a difference that falls as the walls
        warm, and is greatest where little propellant burns"""
    parameters = (
        Quantity("heat_flow_W", Dimension.HEAT_FLOW, 0.0, 1e6),
        Quantity("time_s", Dimension.TIME, 0.2, 200.0),
    )
    look_alikes = ("throat_deposition", "burning_area_change", "leakage")
    experiment = """A second burn soon after the first, while the walls are still warm: there is no
        heat loss to the walls, but effects of deposits and grain remain. If there is only one burn:
        steps early and late in the burn."""
    sentence = "cold walls take {heat_flow_W:kW} from the gas at first, and warm in {time_s:s}"
    nonlinear = ("time_s",)
    trials = ((1.0,), (3.0,), (10.0,), (30.0,))
    refine = {0: 0.0}
    slots = (kernel.HEAT_FLOW, kernel.HEAT_TIME)
    scale = 1e4


class Leakage(GasGeneratorEffect):
    """Gas that leaks beside the throat."""

    equation = "m_g = p_g (A_t + A_l) / C_r"
    assumption = "the implied assumption of eq. 3 that all gas leaves through the valve's throat"
    coordinate = """throat area: where the throat is narrowest, the pressure is too low and changes
        faster"""
    parameters = (Quantity("area_m2", Dimension.AREA, 0.0, 2e-4),)
    look_alikes = ("erosive_burning", "throat_deposition", "heat_loss")
    experiment = """Pauses at five or more throat areas between the least and the greatest: the area
        of a leak is constant, so that its share is greatest at the least throat area. A pressure
        test of the cold chamber shows a leak too."""
    sentence = "gas leaks beside the throat through {area_m2:mm^2}"
    slots = (kernel.LEAK,)
    scale = 1e-6
