"""Fig. 5 and 11: the closed loop of valve and gas generator, with mutual disturbance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from drivers.mock.plant import gas_direct
from drivers.mock.plant.gas_direct import impacted_area, throat_area
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import record
from identification.plots import regulator
from identification.recording import Array
from rig.config.bench import load_bench
from rig.config.sequence import FlowSection, load_sequence
from rig.control.session import run_simulated
from rig.planning.hot_fire import nominal_generator, pressure_for
from rig.results.document import Picture
from rig.results.paper.exhibit import Exhibit, Rows, columns, true_machine

LOOP_BENCH, LOOP_SEQUENCE, LOOP_STAGE = "practical_hot", "hotfire", "flow"
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
    bench, sequence = load_bench(LOOP_BENCH), load_sequence(LOOP_SEQUENCE)
    dataset = run_simulated(bench, sequence, seed, scratch / "hotfire")
    recording = next(r for r in dataset.recordings if r.name == LOOP_STAGE)
    flow = next(stage.flow for stage in sequence.value.stages if stage.name == LOOP_STAGE)
    generator = nominal_generator(bench.value)
    if flow is None or generator is None:
        raise ValueError(f"{LOOP_SEQUENCE} has no flow command, or {LOOP_BENCH} no gas generator")
    machine = true_machine(LOOP_BENCH)
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


def loop_exhibit(scratch: Path, seed: int) -> Exhibit:
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
            f"{LOOP_SEQUENCE} on {LOOP_BENCH}, stage {LOOP_STAGE}: steps of the flow command "
            "through the whole simulated chain, "
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


PAPER_DEG_S = 50.0
"""Opening speed in the paper, deg/s."""
SLOW_DEG_S = 5.0
"""Speed, deg/s, at which the pressure follows the throat area within 7 % and the joint does not
stick.
"""
OPEN_DEG = 30.0
CYCLE_S = 0.001
UNIFORM = 0.05
"""Relative deviation of the speed up to which the motion counts as uniform."""
SMOOTHING_S = 0.020
"""Time, s, over which the speed is computed from the joint encoder."""
REST_S = 0.2


@dataclass(frozen=True)
class Sweep:
    """One opening of the valve as measured by the sensors of the bench; arrays of shape (n,), from
    the start of the motion.

    Attributes:
        speed_deg_s: Commanded speed.
        time: Time, s.
        angle: Angle of the joint encoder, rad.
        current: Mean current over each cycle, A.
        pressure: Pressure by the transmitter, Pa.
        area: Impacted area A_s at the angle, m^2.
        steady_pressure: Steady pressure at that angle, Pa.
        uniform: Samples at the commanded speed.
        rank_pressure: Spearman's rank correlation of current and pressure over the samples in
            ``uniform``.
        rank_area: Spearman's rank correlation of current and area over the samples in ``uniform``.
    """

    speed_deg_s: float
    time: Array
    angle: Array
    current: Array
    pressure: Array
    area: Array
    steady_pressure: Array
    uniform: NDArray[np.bool_]
    rank_pressure: float
    rank_area: float

    @property
    def lag(self) -> float:
        """Greatest relative excess of the pressure over the steady pressure."""
        return float(np.max(self.pressure[self.uniform] / self.steady_pressure[self.uniform]) - 1.0)

    def at(self, degrees: Array) -> Array:
        """Return angle (deg), current (A), pressure (MPa) and area (mm^2) at these angles, shape
        (m, 4).

        Means over the samples within half a degree in uniform motion, or NaN if there are none.
        """
        angle = np.rad2deg(self.angle)
        rows = np.full((len(degrees), 4), np.nan)
        for row, degree in zip(rows, degrees, strict=True):
            near = self.uniform & (np.abs(angle - degree) <= 0.5)
            row[0] = degree
            if near.any():
                row[1:] = [
                    np.mean(v[near]) for v in (self.current, self.pressure * 1e-6, self.area * 1e6)
                ]
        return rows


def sweep(machine: constants.Machine, speed_deg_s: float, seed: int = 0) -> Sweep:
    """Open the valve of a burning gas generator from 0 to 30 deg at constant speed.

    Args:
        machine: The bench; its gas generator burns steadily at the closed valve when the motion
            starts.
        speed_deg_s: Commanded speed.
        seed: Seed of the sensor noise.

    Raises:
        ValueError: The joint sticks, or is in stick-slip, during the whole motion.
    """
    noise, transmitter = np.random.default_rng(seed).spawn(2)
    plant = SimulatedMachine(machine, noise)
    plant.power(True)
    plant.advance(round(REST_S * 1e9))
    plant.ignite()
    plant.latch()
    time = np.asarray(
        np.arange(math.ceil(OPEN_DEG / speed_deg_s / CYCLE_S)) * CYCLE_S, dtype=np.float64
    )
    samples = record(plant, np.deg2rad(speed_deg_s) * time, CYCLE_S, pressure_rng=transmitter)
    area = gas_direct.impacted_area(machine, samples.angle)
    uniform = _uniform(samples.angle, math.radians(speed_deg_s))
    if not uniform.any():
        raise ValueError(
            f"at {speed_deg_s:g} deg/s the joint never moves uniformly; sweep faster, or stiffen "
            f"the drive"
        )
    ranks = [
        float(spearmanr(samples.current[uniform], v[uniform]).statistic)
        for v in (samples.pressure, area)
    ]
    return Sweep(
        speed_deg_s,
        time,
        samples.angle,
        samples.current,
        samples.pressure,
        area,
        gas_direct.steady_pressure(machine, samples.angle),
        uniform,
        *ranks,
    )


def _uniform(angle: Array, wanted: float) -> NDArray[np.bool_]:
    """Return a mask of the samples at this speed (rad/s)."""
    width = round(SMOOTHING_S / CYCLE_S)
    kernel = np.ones(width) / width
    speed = np.convolve(np.gradient(angle, CYCLE_S), kernel, mode="same")
    marks = np.abs(speed - wanted) <= UNIFORM * wanted
    marks[:width] = marks[-width:] = False
    return np.asarray(marks)


_ENDS_DEG = np.array([5.0, 29.0])


def sweep_exhibit(seed: int) -> Exhibit:
    """Return Fig. 4 at the speed of the paper, and at a lower speed, at which the pressure follows
    the throat area.
    """
    machine = true_machine("practical_hot")
    sweeps = [sweep(machine, speed, seed) for speed in (PAPER_DEG_S, SLOW_DEG_S)]
    return Exhibit(
        "fig_4",
        "Fig. 4: the motor's current falls with pressure and impacted area",
        "The valve turns from 0 to 30 deg at 50 deg/s under a stable pressure; the curve of the "
        "current falls as the "
        "pressure and the impacted area fall. The text gives no values of the curve.",
        tuple(_words(found) for found in sweeps),
        (
            Picture.of(
                "fig_4",
                "Fig. 4: an opening valve, at the speed of the paper and slowly",
                _sweep_figure(sweeps),
            ),
        ),
        {
            name: _sweep_data(found)
            for name, found in zip(("fig_4", "fig_4_slow"), sweeps, strict=True)
        },
    )


def _words(found: Sweep) -> str:
    (_, current, pressure, area), (_, last_current, last_pressure, last_area) = found.at(_ENDS_DEG)
    return (
        f"At {found.speed_deg_s:g} deg/s: from {_ENDS_DEG[0]:g} to {_ENDS_DEG[1]:g} deg the "
        f"current falls from "
        f"{current:.2f} to {last_current:.2f} A, the pressure from {pressure:.2f} to "
        f"{last_pressure:.2f} MPa, the area "
        f"from {area:.0f} to {last_area:.0f} mm^2. Rank correlation of the current with the "
        f"pressure "
        f"{found.rank_pressure:.3f}, with the area {found.rank_area:.3f}. The pressure stays up to "
        f"{100.0 * found.lag:.0f} % above the steady pressure."
    )


def _sweep_figure(sweeps: list[Sweep]) -> regulator.Figure:
    return regulator.sweep(
        [
            (
                f"{found.speed_deg_s:g} deg/s",
                np.rad2deg(found.angle),
                np.where(found.uniform, found.current, np.nan),
                1e-6 * found.pressure,
                1e-6 * found.steady_pressure,
                1e6 * found.area,
            )
            for found in sweeps
        ]
    )


def _sweep_data(found: Sweep) -> Rows:
    return columns(
        time_s=found.time,
        angle_rad=found.angle,
        current_A=found.current,
        pressure_Pa=found.pressure,
        steady_pressure_Pa=found.steady_pressure,
        impacted_area_m2=found.area,
        uniform=found.uniform.astype(np.float64),
    )


GREATEST_DEG = 30.0
_STEP_DEG = 0.1


def clear_deg(machine: Machine) -> float:
    """Return the angle at which the plate has left the opening, L1 sin(theta) = (b + D)/2, deg."""
    valve = machine.gas.valve
    beside = 0.5 * (valve.plate_width_m + valve.opening_diameter_m)
    return math.degrees(math.asin(beside / machine.joint.moment_arm_m))


def valve_exhibit() -> Exhibit:
    """Return Fig. 3 from the closed form of the plant's valve."""
    machine = true_machine("practical_hot")
    angle_deg = np.arange(0.0, GREATEST_DEG + 0.5 * _STEP_DEG, _STEP_DEG)
    angle = np.deg2rad(angle_deg)
    throat, impacted = throat_area(machine, angle), impacted_area(machine, angle)
    total = 0.25 * math.pi * machine.gas.valve.opening_diameter_m**2
    clear = clear_deg(machine)
    return Exhibit(
        "fig_3",
        "Fig. 3: impacted and effective throat area",
        "The platform, and the schematic of the impacted area: d = 25 mm, D = 40 mm, b = 54 mm; "
        "the greatest throat is the sum of both areas; the valve turns from 0 to 30 deg. The "
        "paper announces the curve of the throat area, but does not print this curve.",
        (
            f"A_s = {impacted[0]:.4g} m^2 and A_t = {throat[0]:.4g} m^2 at 0 deg; the plate has "
            f"left the opening at {clear:.2f} deg, by the paper at 30 deg; A_s + A_t = "
            f"{total:.5g} m^2 at every angle.",
        ),
        (
            Picture.of(
                "fig_3",
                "Fig. 3: areas against the valve angle",
                regulator.areas(angle_deg, impacted, throat, clear),
            ),
        ),
        {"fig_3": columns(angle_deg=angle_deg, impacted_area_m2=impacted, throat_area_m2=throat)},
    )
