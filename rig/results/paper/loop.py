"""Fig. 5 and 11: the closed loop of valve and gas generator, with mutual disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from drivers.mock.plant.gas import impacted_area, throat_area
from identification.plots import regulator
from identification.recording import Array
from rig.config.bench import load_bench
from rig.config.sequence import FlowSection, load_sequence
from rig.control.session import run_simulated
from rig.planning.hot_fire import nominal_generator, pressure_for
from rig.results.document import Picture
from rig.results.paper.exhibit import Exhibit, Rows, columns, true_machine

BENCH, SEQUENCE, STAGE = "practical_hot", "hotfire", "flow"
SETTLED = 0.02
"""Relative deviation from the commanded flow up to which a flow counts as settled."""
_SMOOTHING_S = (
    0.05  # settling is judged on means over this time, so that sensor noise has little influence
)
_THIN = 10  # the data file contains every tenth sample


@dataclass(frozen=True)
class Firing:
    """The closed-loop stage of a hot firing; each array of shape (n,).

    Attributes:
        flow: Flow command of the stage.
        period: Sampling period, s.
        time: Time since the start of the stage, s.
        flows: Commanded flow, and flow computed from pressure and angle, kg/s.
        pressures: Commanded and measured pressure, Pa.
        angles: Commanded and measured valve angle, rad.
        current: Motor current, A.
        force: Contact force, N.
    """

    flow: FlowSection
    period: float
    time: Array
    flows: tuple[Array, Array]
    pressures: tuple[Array, Array]
    angles: tuple[Array, Array]
    current: Array
    force: Array


def fire(scratch: Path, seed: int) -> Firing:
    """Run the packaged hot firing and return its closed-loop stage."""
    bench, sequence = load_bench(BENCH), load_sequence(SEQUENCE)
    dataset = run_simulated(bench, sequence, seed, scratch / "hotfire")
    recording = next(r for r in dataset.recordings if r.name == STAGE)
    flow = next(stage.flow for stage in sequence.value.stages if stage.name == STAGE)
    generator = nominal_generator(bench.value)
    if flow is None or generator is None:
        raise ValueError(f"{SEQUENCE} has no flow command, or {BENCH} no gas generator")
    machine = true_machine(BENCH)
    time = recording.time - recording.time[0]
    commanded = flow.command(len(time) * recording.period, recording.period)[: len(time)]
    angle, pressure = recording.channels["angle"], recording.channels["pressure"]
    gas = machine.gas
    outflow = pressure * throat_area(machine, angle) / gas.characteristic_velocity_m_s
    return Firing(
        flow,
        recording.period,
        time,
        (commanded, outflow),
        (pressure_for(commanded, generator), pressure),
        (recording.channels["command"], angle),
        recording.channels["current"],
        (pressure - gas.back_pressure_Pa) * impacted_area(machine, angle),
    )


def exhibit(scratch: Path, seed: int) -> Exhibit:
    """Run the packaged hot firing and return its closed-loop stage: flow, pressure, angle, current
    and load.
    """
    found = fire(scratch, seed)
    caption = (
        "Fig. 5 and 11: flow steps in the closed loop; the flow is p A_t / C_r of measured "
        "pressure and angle"
    )
    return Exhibit(
        "fig_11",
        "Fig. 5 and 11: the closed loop of controller, motor, valve and gas generator",
        "Block diagrams of the loop, in which pressure and valve angle determine the load on the "
        "motor, and "
        "the angle determines the pressure. The paper gives no controller and no response.",
        (
            f"{SEQUENCE} on {BENCH}, stage {STAGE}: steps of the flow command through the whole "
            f"simulated chain, "
            "pressure measured by a transmitter.",
            _settling(found),
            "The flow first changes in the wrong direction: when the throat opens, more gas flows "
            "out until the pressure falls. " + _hunting(found),
            f"Contact force {np.min(found.force):.0f} to {np.max(found.force):.0f} N, which varies "
            f"only with pressure and angle; the motor "
            f"current that holds and moves the valve against its friction reaches "
            f"{np.max(np.abs(found.current)):.1f} A.",
        ),
        (Picture.of("fig_11", caption, _figure(found)),),
        {"fig_11": _data(found)},
    )


def _figure(found: Firing) -> regulator.Figure:
    asked, pressure = (1e-6 * signal for signal in found.pressures)
    return regulator.closed_loop(
        found.time,
        dict(zip(("command", "flow"), found.flows, strict=True)),
        {"command": asked, "measured": pressure},
        dict(zip(("command", "measured"), found.angles, strict=True)),
        found.current,
        found.force,
    )


def _data(found: Firing) -> Rows:
    few = slice(None, None, _THIN)
    return columns(
        time_s=found.time[few],
        flow_command_kg_s=found.flows[0][few],
        flow_kg_s=found.flows[1][few],
        pressure_command_Pa=found.pressures[0][few],
        pressure_Pa=found.pressures[1][few],
        angle_command_rad=found.angles[0][few],
        angle_rad=found.angles[1][few],
        current_A=found.current[few],
        contact_force_N=found.force[few],
    )


def _hunting(found: Firing) -> str:
    """Return text on the current oscillation at steady flow, before the first step."""
    time = found.time
    before = found.current[(time >= 1.0) & (time < found.flow.steps[1].at_s)]
    return (
        f"Before the first step, at steady flow, the current swings from {np.min(before):+.1f} to "
        f"{np.max(before):+.1f} A: the integrators of the loop hunt across static friction, one of "
        "the limit cycles of which the paper warns."
    )


def _settling(found: Firing) -> str:
    """Return text on the settling time of each step."""
    flow, time, (_, outflow) = found.flow, found.time, found.flows
    n = max(1, round(_SMOOTHING_S / found.period))
    smooth = np.convolve(
        np.pad(outflow, (n // 2, n - 1 - n // 2), mode="edge"), np.full(n, 1.0 / n), mode="valid"
    )
    ends = [step.at_s for step in flow.steps[1:]] + [float(time[-1])]
    words = []
    for (before, step), end in zip(pairwise(flow.steps), ends[1:], strict=True):
        part = (time >= step.at_s) & (time < end)
        off = np.flatnonzero(np.abs(smooth[part] / step.flow_kg_s - 1.0) > SETTLED)
        if off.size and off[-1] + 1 == np.count_nonzero(part):
            took = "not before the next step"
        else:
            took = f"{(off[-1] + 1) * found.period if off.size else 0.0:.2f} s"
        words.append(f"{before.flow_kg_s:g} to {step.flow_kg_s:g} kg/s {took}")
    return f"Time to stay within {SETTLED:.0%} of the commanded flow: {', '.join(words)}."
