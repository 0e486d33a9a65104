"""Plans hot firings: flow command, expected pressure and contact force, limits of the gas."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.model.gas_generator import (
    GasGenerator,
    equilibrium_pressure,
    impacted_area,
    throat_area,
)
from rig.common.sample import Sample
from rig.config.bench import Bench
from rig.config.sequence import Array, FlowController, StageSection
from rig.planning.limits import GasLimits

_LEAST_PRESSURE_PA = 1e3
"""Lower bound of the pressure in the control law, Pa, which avoids the logarithm of zero."""
_ANGLES = 20001


@dataclass(frozen=True)
class FlowLaw:
    """The discrete-time controller for one cycle time, SI."""

    gain: float  # valve angle per unit of ln(p/p_c), rad
    integral: float  # integral gain per cycle, as a share of the gain
    share: float  # weight of a new reading in the low-pass filter
    least: float
    most: float
    step: float  # greatest change in one cycle, rad


@dataclass(frozen=True)
class LawState:
    """State of the controller: filtered pressure (Pa), integral and angle (rad)."""

    pressure: float
    integral: float
    angle: float


def make_law(controller: FlowController, cycle_s: float, speed_rad_s: float) -> FlowLaw:
    """Return the controller of a sequence file for a cycle time and a speed limit."""
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
    """Return the state of the controller after a cycle with pressure command and reading, Pa."""
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
    """The controller in the control cycle: it yields a target, gets the sample, yields the next."""

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
    """Return the steady valve angle for a flow (kg/s), eq. 3, rad, as near as the valve can."""
    angles = np.linspace(0.0, g.valve.clearing_angle, _ANGLES)
    areas = throat_area(angles, g.valve)
    opening = np.flatnonzero(np.diff(areas) > 0.0)
    moving = slice(int(opening[0]), int(opening[-1]) + 2)
    return np.interp(flow * g.C_r / pressure_for(flow, g), areas[moving], angles[moving])


NEEDS_PRESSURE = (
    "a hot firing is loaded by its chamber pressure, and this bench has no pressure transmitter; "
    "add the sections "
    "`pressure` and `gas_generator` to the bench file, or use the bench practical_hot"
)


@dataclass(frozen=True)
class FlowPlan:
    """A closed-loop excitation: pressure commands, Pa, and expected valve angles, rad, (n,)."""

    law: FlowLaw
    pressures: Array
    angles: Array


def nominal_generator(bench: Bench) -> GasGenerator | None:
    """Return the nominal gas generator of the bench file, or None."""
    section = bench.gas_generator
    return None if section is None else section.generator(bench.machine.moment_arm_m)


def plan_flow(section: StageSection, bench: Bench, speed_rad_s: float) -> FlowPlan | None:
    """Return the closed-loop excitation of a stage, or None if it commands no flow."""
    generator = nominal_generator(bench)
    if section.flow is None:
        return None
    flow = section.flow.command(section.duration_s, bench.cycle_s)
    law = make_law(section.flow.controller, bench.cycle_s, speed_rad_s)
    if generator is None:
        return FlowPlan(law, np.full(len(flow), np.nan), np.zeros(len(flow)))
    return FlowPlan(law, pressure_for(flow, generator), angle_for(flow, generator))


def expected_force(targets: Array, bench: Bench) -> float:
    """Return the greatest contact force over these joint angles at steady pressure, N."""
    return float(np.max(steady_force(targets, bench), initial=0.0))


def steady_force(targets: Array, bench: Bench) -> Array:
    """Return the contact force at steady pressure, N, shape (n,); zero without a gas generator."""
    generator = nominal_generator(bench)
    if generator is None or not len(targets):
        return np.zeros(len(targets))
    return np.asarray(
        (_steady(targets, generator) - generator.p_c0) * impacted_area(targets, generator.valve)
    )


def _steady(targets: Array, generator: GasGenerator) -> Array:
    return equilibrium_pressure(throat_area(targets, generator.valve), generator)


def hot_objections(
    section: StageSection, targets: Array, bench: Bench
) -> Iterator[tuple[tuple[str | int, ...], str, object]]:
    """Yield key, message and value for each quantity of a hot firing that exceeds a limit."""
    if section.stage != "hot_fire":
        return
    generator, limit_MPa = nominal_generator(bench), bench.limits.pressure_MPa
    if bench.pressure is None or generator is None or limit_MPa is None:
        yield ("stage",), NEEDS_PRESSURE, section.stage
        return
    peak_MPa = float(np.max(_steady(targets, generator))) * 1e-6
    if peak_MPa > limit_MPa:
        text = (
            f"the pressure would rise to {peak_MPa:.3g} MPa, above the bench limit "
            f"pressure_MPa {limit_MPa:g} MPa"
        )
        yield ("stage",), f"{text}; keep the valve further open", section.stage
    force = expected_force(targets, bench)
    if force > bench.limits.contact_force_N:
        yield (
            ("stage",),
            f"contact force {force:.0f} N is above the bench limit contact_force_N "
            f"{bench.limits.contact_force_N:g} N; keep the valve further open",
            section.stage,
        )
    if section.flow is not None:
        least, most = np.sort(_flow_range(section, generator))
        for index, step in enumerate(section.flow.steps):
            if not least <= step.flow_kg_s <= most:
                text = (
                    f"outside {least:.4g} to {most:.4g} kg/s, the range of the valve within the "
                    "angles of the controller"
                )
                yield ("flow", "steps", index, "flow_kg_s"), text, step.flow_kg_s


def _flow_range(section: StageSection, generator: GasGenerator) -> Array:
    """Return the steady flow at both ends of the controller's range, kg/s."""
    assert section.flow is not None
    controller = section.flow.controller
    ends = np.deg2rad([controller.angle_min_deg, controller.angle_max_deg])
    return np.asarray(
        generator.rho_b
        * generator.A_b
        * generator.a
        * (1e-6 * _steady(ends, generator)) ** generator.n
    )


def gas_limits(bench: Bench) -> GasLimits | None:
    """Return the limits on the gas generator; None for a bench without pressure transmitter."""
    generator, limit_MPa = nominal_generator(bench), bench.limits.pressure_MPa
    if bench.pressure is None or generator is None or limit_MPa is None:
        return None
    valve = generator.valve

    def area(angle: float) -> float:
        return float(impacted_area(np.asarray(angle), valve))

    return GasLimits(limit_MPa * 1e6, bench.limits.contact_force_N, generator.p_c0, area)


def hot_fire_words(stage: str, simulated: bool) -> str:
    """Return the message before a hot firing; the prompt of the firing asks for an empty lever."""
    lights = (
        "This program ignites the gas generator"
        if simulated
        else "Ignite the gas generator yourself, and answer when its pressure is steady"
    )
    return (
        f"Stage {stage} is a hot firing: a gas generator loads the valve, and no weight is hung. "
        f"{lights}."
    )
