"""Plans hot firings: flow command, expected pressure and contact force, limits of the gas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identification.model.gas_generator import GasGenerator, equilibrium_pressure
from identification.model.valve import impacted_area, throat_area
from rig.config.bench import Bench
from rig.config.sequence import Array, StageSection
from rig.planning.flow_control import FlowLaw, angle_for, make_law, pressure_for
from rig.planning.limits import GasLimits

NEEDS_PRESSURE = (
    "a hot firing is loaded by its chamber pressure, and this bench has no pressure transmitter; "
    "add the sections "
    "`pressure` and `gas_generator` to the bench file, or use the bench practical_hot"
)


@dataclass(frozen=True)
class FlowPlan:
    """A closed-loop excitation, ready to run.

    Attributes:
        law: The controller.
        pressures: Pressure command of each cycle, Pa, shape (n,).
        angles: Expected valve angles, rad, shape (n,).
    """

    law: FlowLaw
    pressures: Array
    angles: Array


def nominal_generator(bench: Bench) -> GasGenerator | None:
    """Return the nominal gas generator of the bench file, or None."""
    section = bench.gas_generator
    return None if section is None else section.generator(bench.machine.moment_arm_m)


def plan_flow(section: StageSection, bench: Bench, speed_rad_s: float) -> FlowPlan | None:
    """Return the closed-loop excitation of a stage, or None if the stage has no flow command or the
    bench no gas generator.
    """
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
    """Return the contact force at these joint angles at steady pressure, N, shape (n,).

    The force is zero on a bench without a gas generator.
    """
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
            f"{bench.limits.contact_force_N:g} N; "
            "keep the valve further open",
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
