"""Controls the gas flow by the valve angle: PI controller of the chamber pressure (Fig. 5, 11).

Each gas flow corresponds to a chamber pressure (eq. 2). The PI controller turns the valve, by the
position servo, until the chamber has the pressure of the commanded flow. Valve and gas generator
are coupled: pressure and area
load the valve (eq. 10), and friction under this load delays the valve.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.model.gas_generator import GasGenerator
from identification.model.valve import throat_area
from rig.common.sample import Sample
from rig.config.flow import Array, FlowController

_LEAST_PRESSURE_PA = 1e3
"""Lower bound of the pressure in the control law, Pa, which avoids the logarithm of zero."""
_ANGLES = 20001


@dataclass(frozen=True)
class FlowLaw:
    """The discrete-time controller for one cycle time, SI.

    Attributes:
        gain: Valve angle per unit of ln(p/p_c), rad.
        integral: Integral gain per cycle, as a share of the gain.
        share: Weight of a new reading in the low-pass filter.
        least: Least angle, rad.
        most: Greatest angle, rad.
        step: Greatest change in one cycle, rad.
    """

    gain: float
    integral: float
    share: float
    least: float
    most: float
    step: float


@dataclass(frozen=True)
class LawState:
    """State of the controller: filtered pressure (Pa), integral and angle (rad)."""

    pressure: float
    integral: float
    angle: float


def make_law(controller: FlowController, cycle_s: float, speed_rad_s: float) -> FlowLaw:
    """Return the controller of a sequence file for the cycle time ``cycle_s``, with the speed limit
    ``speed_rad_s``.
    """
    gain = math.radians(controller.gain_deg)
    return FlowLaw(
        gain=gain,
        integral=gain * controller.integral_1_s * cycle_s,
        share=-math.expm1(-2.0 * math.pi * controller.filter_Hz * cycle_s),
        least=math.radians(controller.angle_min_deg),
        most=math.radians(controller.angle_max_deg),
        step=min(math.radians(controller.speed_deg_s), speed_rad_s) * cycle_s,
    )


def control(law: FlowLaw, state: LawState, wanted: float, reading: float) -> LawState:
    """Return the state of the controller after one cycle.

    Args:
        law: The controller.
        state: State after the previous cycle.
        wanted: Pressure command p_c, Pa.
        reading: Measured pressure, Pa.
    """
    pressure = state.pressure + law.share * (max(reading, _LEAST_PRESSURE_PA) - state.pressure)
    error = math.log(pressure / wanted)
    integral = state.integral + law.integral * error
    asked = law.gain * error + integral
    angle = min(max(asked, law.least, state.angle - law.step), law.most, state.angle + law.step)
    # Anti-windup: at a bound the integral changes only away from the bound.
    if (asked - angle) * error > 0.0:
        integral = state.integral
    return LawState(pressure, integral, angle)


class Regulator:
    """The controller in the control cycle: it yields a target, receives the resulting sample, and
    yields the next target.

    Args:
        law: The controller.
        pressures: Pressure command of each cycle, Pa.
        angle: Valve angle at the start, rad.
    """

    def __init__(self, law: FlowLaw, pressures: Sequence[float], angle: float) -> None:
        self._law = law
        self._pressures = pressures
        self._state = LawState(0.0, angle, angle)
        self._wanted = 0.0

    def targets(self) -> Iterator[float]:
        """Yield the angle of each cycle, rad; :meth:`see` must be called after each angle."""
        for wanted in self._pressures:
            self._wanted = wanted
            yield self._state.angle

    def see(self, sample: Sample) -> None:
        """Process the sample that followed the last target."""
        state = self._state
        if state.pressure == 0.0:
            state = replace(state, pressure=max(sample.pressure, _LEAST_PRESSURE_PA))
        self._state = control(self._law, state, self._wanted, sample.pressure)


def pressure_for(flow: Array, g: GasGenerator) -> Array:
    """Return the steady pressure for a flow (kg/s), eq. 2, Pa."""
    return np.asarray(1e6 * (flow / (g.rho_b * g.A_b * g.a)) ** (1.0 / g.n))


def angle_for(flow: Array, g: GasGenerator) -> Array:
    """Return the steady valve angle for a flow (kg/s), eq. 3, rad; for a flow outside the valve's
    range, the angle with the nearest throat area.
    """
    angles = np.linspace(0.0, g.valve.clearing_angle, _ANGLES)
    areas = throat_area(angles, g.valve)
    opening = np.flatnonzero(np.diff(areas) > 0.0)
    moving = slice(int(opening[0]), int(opening[-1]) + 2)
    return np.interp(flow * g.C_r / pressure_for(flow, g), areas[moving], angles[moving])
