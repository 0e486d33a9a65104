"""The paper's Fig. 2 to 5, 9 and 11, and eq. 14, each with our result."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from drivers.mock.plant.gas import impacted_area, steady_pressure, throat_area
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import record
from identification.estimate.equation_error import (
    UNIFORM,
    UniformPoint,
    errors_percent,
    fit_uniform,
    uniform_points,
)
from identification.model.friction import load_coefficient, system_friction
from identification.plots import regulator
from identification.recording import Array, Recording
from identification.signals import Tracking, track, tracking_error
from rig.common.tables import number, percent
from rig.config.bench import load_bench
from rig.config.configuration import Document, load_located
from rig.config.sequence import FlowSection, load_sequence
from rig.config.sequence import Sequence as SequenceFile
from rig.control.session import run_simulated
from rig.planning.hot_fire import nominal_generator, pressure_for
from rig.results.document import Picture, Table
from rig.runs.recorded_inputs import true_parameters

Rows = tuple[tuple[str, ...], Sequence[Sequence[float | str]]]
"""Column titles with their units, and the rows of the table."""


@dataclass(frozen=True)
class Exhibit:
    """Content of the page under one heading."""

    name: str  # key in the result file, and file name of its data: `fig_2`
    title: str  # heading
    paper: str  # what the paper prints or shows, as text
    found: tuple[str, ...]  # our results, one sentence each
    pictures: tuple[Picture, ...] = ()  # figures; the first is named like the exhibit
    data: Mapping[str, Rows] | None = None  # plotted data by the name of the picture
    table: Table | None = None  # values side by side, if any


def columns(**named: Array) -> Rows:
    """Return arrays of one length as rows; each title is a ``name`` with its unit (``time_s``)."""
    return tuple(named), list(zip(*(values.tolist() for values in named.values()), strict=True))


def _exhibit(
    name: str,
    title: str,
    paper: str,
    found: Sequence[str],
    caption: str,
    figure: regulator.Figure,
    data: Rows,
    table: Table | None = None,
) -> Exhibit:
    """Return an exhibit with one figure."""
    pictures = (Picture.of(name, caption, figure),)
    return Exhibit(name, title, paper, tuple(found), pictures, {name: data}, table)


def _thinned(**named: Array) -> Rows:
    return columns(**{name: values[::_THIN] for name, values in named.items()})


def data_files(exhibits: Sequence[Exhibit]) -> dict[str, str]:
    """Return the numbers of every picture as CSV, by the file's name relative to the page."""
    return {
        _DATA_FILE.format(name): _csv(rows)
        for exhibit in exhibits
        for name, rows in (exhibit.data or {}).items()
    }


def files_of(exhibits: Sequence[Exhibit]) -> dict[str, list[str]]:
    """Return the files of each picture and its data, relative to the page."""
    files = {picture.name: [picture.file] for e in exhibits for picture in e.pictures}
    for exhibit in exhibits:
        for name in exhibit.data or {}:
            files.setdefault(name, []).append(_DATA_FILE.format(name))
    return files


def _csv(rows: Rows) -> str:
    titles, lines = rows
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(titles)
    writer.writerows(
        [cell if isinstance(cell, str) else f"{cell:.9g}" for cell in line] for line in lines
    )
    return text.getvalue()


def true_machine(name: str) -> Machine:
    """Return the simulated machine of a packaged bench."""
    machine = load_bench(name).value.mock
    if machine is None:
        raise ValueError(f"the packaged bench {name!r} has no simulated machine")
    return machine


RAMP_BENCH, RAMP_SEQUENCE = "practical_soft", "slow_ramp"
_SPEED_SPAN_S = 0.02  # the plotted speed is a mean over this time
_THIN = 10  # the data files contain every tenth sample
_DATA_FILE = "data/{}.csv"


def ramp_exhibits(scratch: Path, seed: int) -> list[Exhibit]:
    """Return Fig. 2 (angle, steady-state error) and Fig. 9 (speed, without and with load)."""
    plan = load_sequence(RAMP_SEQUENCE)
    ramps = run_simulated(load_bench(RAMP_BENCH), plan, seed, scratch / RAMP_BENCH).recordings
    ramp = f"{RAMP_SEQUENCE} on {RAMP_BENCH}: 8 deg at 1 deg/s and back"
    first, time = ramps[0], _time(ramps[0])
    command, angle = first.channels["command"], first.channels["angle"]
    commanded = np.gradient(command, first.period)
    fig_2 = _exhibit(
        "fig_2",
        "Fig. 2: low-speed ramp, stick-slip and steady-state error",
        "Angle against time while the regulator follows a low-speed ramp, gas generator not "
        "working: the valve waits, jumps and waits, and comes to rest with an error. The paper "
        "gives no speed and no gains.",
        [_words(f"{ramp}, no weight", track(first))],
        f"Fig. 2: {ramp}, no weight",
        regulator.tracking(time, command, angle, tracking_error(first)),
        _thinned(
            time_s=time,
            command_rad=command,
            angle_rad=angle,
            current_A=first.channels["current"],
        ),
    )
    named = dict(zip(("no weight", "30.6 kg (3000 N)"), ramps, strict=True))
    panels = [(name, _time(each), commanded, _speed(each)) for name, each in named.items()]
    speeds = {f"{each.stage}_rad_s": _speed(each) for each in ramps}
    fig_9 = _exhibit(
        "fig_9",
        "Fig. 9: a position loop that should turn uniformly",
        "The regulator is commanded to move uniformly, but sticks and slips. For this reason the "
        "paper regards the conventional identification (eq. 14) as impossible for this regulator.",
        [_words(name, track(each)) for name, each in named.items()],
        "Fig. 9: joint speed on the same ramp, mean over 20 ms",
        regulator.speeds(panels),
        _thinned(time_s=time, command_rad_s=commanded, **speeds),
    )
    return [fig_2, fig_9]


def _words(what: str, t: Tracking) -> str:
    return (
        f"{what}: tracking error {1e3 * t.rms:.3g} mrad rms, {1e3 * t.largest:.3g} mrad at most; "
        f"at rest {100.0 * t.waiting:.0f} % of the time in which the command moves; "
        f"{1e3 * t.at_end:+.3g} mrad off at the end; {t.energy:.0f} J electrical."
    )


def _time(recording: Recording) -> Array:
    return np.asarray(recording.time - recording.time[0])


def _speed(recording: Recording) -> Array:
    n = round(_SPEED_SPAN_S / recording.period)
    padded = np.pad(recording.channels["angle"], (n // 2, n - n // 2), mode="edge")
    return np.asarray((padded[n:] - padded[:-n]) / (n * recording.period))


SPEEDS_DEG_S = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 18.0, 25.0)
WEIGHT_KG = 30.6
TRAVEL_DEG = {0.0: 8.0, WEIGHT_KG: 14.0}
"""Travel, deg, for each weight, kg: it exceeds the deflection of a soft drive before breakaway,
1.7 deg without weight and 5.2 deg with weight.
"""
LEAST_LEG_S = 0.6
GAINS = {"stiff": "practical", "soft": "practical_soft"}


@dataclass(frozen=True)
class UniformStudy:
    """Points of both gain sets, with the machine's true parameters for comparison."""

    points: Mapping[str, Sequence[UniformPoint]]
    truth: Mapping[str, float]
    moment: float


def sequence(scratch: Path) -> Document[SequenceFile]:
    """Write a sequence file with ramps out and back at every speed, unloaded and loaded."""
    lines = ["sequence: 1", "name: uniform", "stages:"]
    for weight, least in TRAVEL_DEG.items():
        load = "loaded" if weight else "unloaded"
        for speed in SPEEDS_DEG_S:
            travel = max(least, LEAST_LEG_S * speed)
            ramp = f"{{travel_deg: {travel:g}, speed_deg_s: {speed:g}, rest_s: 0.3}}"
            duration = 2.0 * travel / speed + 0.6
            lines.append(
                f"  - {{name: {load}-{speed:g}, stage: {load}, weight_kg: {weight:g}, center_deg: "
                f"{-0.5 * travel:g}, ramp: {ramp}, duration_s: {duration:.9g}}}"
            )
    path = scratch / "uniform.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_located(path, SequenceFile)


def measure(scratch: Path, seed: int) -> UniformStudy:
    """Run the ramps with both gain sets; return a point for each interval of constant speed."""
    plan = sequence(scratch)
    points = {}
    for gains, name in GAINS.items():
        dataset = run_simulated(load_bench(name), plan, seed, scratch / name)
        points[gains] = [
            point for recording in dataset.recordings for point in uniform_points(recording)
        ]
    moment = max(p.moment for p in points["stiff"])
    return UniformStudy(points, true_parameters(true_machine("practical")), moment)


def uniform_exhibit(study: UniformStudy) -> Exhibit:
    """Return the points with the true friction, and a Stribeck curve fitted to them."""
    stiff, soft = study.points["stiff"], study.points["soft"]
    sets = {
        "stiff gains, no weight": [p for p in stiff if not p.moment],
        "stiff gains, all points": stiff,
        "stiff gains, uniform points": [p for p in stiff if p.uniform],
        "soft gains, all points": soft,
        "soft gains, uniform points": [p for p in soft if p.uniform],
    }
    fits = {name: fit_uniform(points) for name, points in sets.items()}
    lines = []
    for gains, points in study.points.items():
        loaded = [p.uniform for p in points if p.moment > 0.0]
        bare = [p.uniform for p in points if not p.moment > 0.0]
        lines.append(
            f"{gains.capitalize()} gains: the motion was uniform in {sum(bare)} of {len(bare)} "
            f"intervals without weight, in {sum(loaded)} of {len(loaded)} under 3000 N."
        )
    titles = ("gains", "stage", "speed_rad_s", "mean_torque_N_m", "spread", "contact_moment_N_m")
    data = [
        (gains, p.recording, p.speed, p.torque, p.spread, p.moment)
        for gains, points in study.points.items()
        for p in points
    ]
    return _exhibit(
        "eq_14",
        "Eq. 14: the conventional method, friction from uniform motion",
        "J domega/dt = M_T - M_f(omega) = 0: the motor's torque at constant speed is the "
        "friction. The paper calls this method almost impossible for the regulator, because "
        "stick-slip prevents uniform motion; the paper gives no figures.",
        (*lines, *_verdict(fits, study.truth)),
        f"Eq. 14: mean torque against commanded speed; hollow points: the speed varies by more "
        f"than {UNIFORM:.0%}",
        _figure(study),
        (titles, data),
        _uniform_table(fits, study.truth),
    )


def _verdict(fits: Mapping[str, Mapping[str, float]], truth: Mapping[str, float]) -> Iterator[str]:
    for name, found in fits.items():
        if not found:
            yield f"{name.capitalize()}: too few points for a Stribeck curve."
            continue
        errors = errors_percent(found, truth)
        worst = max(errors, key=lambda key: abs(errors[key]))
        yield f"{name.capitalize()}: worst parameter {worst}, {errors[worst]:+.3g} %."


def _uniform_table(fits: Mapping[str, Mapping[str, float]], truth: Mapping[str, float]) -> Table:
    header = ["parameter", "true"]
    for name in fits:
        header += [name, "error"]
    rows = []
    for parameter in ("Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2"):
        cells = [parameter, number(truth[parameter])]
        for found in fits.values():
            value = found.get(parameter)
            error = None if value is None else 100.0 * (value / truth[parameter] - 1.0)
            cells += [number(value), percent(error)]
        rows.append(tuple(cells))
    return Table(tuple(header), tuple(rows), tuple(range(1, len(header))))


def _figure(study: UniformStudy) -> regulator.Figure:
    speed = np.geomspace(0.5 * np.deg2rad(SPEEDS_DEG_S[0]), 1.3 * np.deg2rad(SPEEDS_DEG_S[-1]), 400)
    unloaded = system_friction(speed, study.truth, 2.0)
    loaded = unloaded + study.moment * load_coefficient(speed, study.truth, 2.0)
    panels = []
    for title, curve, is_loaded in (
        ("no weight", unloaded, False),
        ("30.6 kg (3000 N)", loaded, True),
    ):
        chosen = {
            f"{gains} gains": [
                (abs(p.speed), p.friction, p.uniform)
                for p in points
                if (p.moment > 0.0) is is_loaded
            ]
            for gains, points in study.points.items()
        }
        panels.append((title, curve, chosen))
    return regulator.uniform(speed, panels)


LOOP_BENCH, LOOP_SEQUENCE, LOOP_STAGE = "practical_hot", "hotfire", "flow"
SETTLED = 0.02  # relative deviation from the commanded flow up to which a flow counts as settled
_SMOOTHING_S = 0.05  # time of the means on which settling is judged, because of the sensor noise, s


def loop_exhibit(scratch: Path, seed: int) -> Exhibit:
    """Run the packaged hot firing and return its closed-loop stage."""
    bench, sequence = load_bench(LOOP_BENCH), load_sequence(LOOP_SEQUENCE)
    dataset = run_simulated(bench, sequence, seed, scratch / "hotfire")
    recording = next(r for r in dataset.recordings if r.name == LOOP_STAGE)
    flow = next(stage.flow for stage in sequence.value.stages if stage.name == LOOP_STAGE)
    generator = nominal_generator(bench.value)
    if flow is None or generator is None:
        raise ValueError(f"{LOOP_SEQUENCE} has no flow command, or {LOOP_BENCH} no gas generator")
    machine, channels = true_machine(LOOP_BENCH), recording.channels
    time, current = _time(recording), channels["current"]
    commanded = flow.command(len(time) * recording.period, recording.period)[: len(time)]
    angle, pressure = channels["angle"], channels["pressure"]
    gas, asked = machine.gas, pressure_for(commanded, generator)
    # The flow computed from pressure and angle, kg/s, and the contact force, N.
    outflow = pressure * throat_area(machine, angle) / gas.characteristic_velocity_m_s
    force = (pressure - gas.back_pressure_Pa) * impacted_area(machine, angle)
    before = current[(time >= 1.0) & (time < flow.steps[1].at_s)]
    return _exhibit(
        "fig_11",
        "Fig. 5 and 11: the closed loop of controller, motor, valve and gas generator",
        "Block diagrams of the loop, in which pressure and valve angle determine the load on the "
        "motor, and the angle determines the pressure. The paper gives no controller and no "
        "response.",
        (
            f"{LOOP_SEQUENCE} on {LOOP_BENCH}, stage {LOOP_STAGE}: steps of the flow command "
            "through the whole simulated chain, pressure measured by a transmitter.",
            _settling(flow, recording.period, time, outflow),
            "The flow first changes in the wrong direction: when the throat opens, more gas flows "
            "out until the pressure falls. Before the first step, at steady flow, the current "
            f"swings from {np.min(before):+.1f} to {np.max(before):+.1f} A: the integrators of the "
            "loop hunt across static friction, one of the limit cycles of which the paper warns.",
            f"Contact force {np.min(force):.0f} to {np.max(force):.0f} N, which varies "
            "only with pressure and angle; the motor current that holds and moves the valve "
            f"against its friction reaches {np.max(np.abs(current)):.1f} A.",
        ),
        "Fig. 5 and 11: flow steps in the closed loop; the flow is p A_t / C_r of measured "
        "pressure and angle",
        regulator.closed_loop(
            time,
            {"command": commanded, "flow": outflow},
            {"command": 1e-6 * asked, "measured": 1e-6 * pressure},
            {"command": channels["command"], "measured": angle},
            current,
            force,
        ),
        _thinned(
            time_s=time,
            flow_command_kg_s=commanded,
            flow_kg_s=outflow,
            pressure_command_Pa=asked,
            pressure_Pa=pressure,
            angle_command_rad=channels["command"],
            angle_rad=angle,
            current_A=current,
            contact_force_N=force,
        ),
    )


def _settling(flow: FlowSection, period: float, time: Array, outflow: Array) -> str:
    """Return text on the settling time of each step."""
    n = max(1, round(_SMOOTHING_S / period))
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
            took = f"{(off[-1] + 1) * period if off.size else 0.0:.2f} s"
        words.append(f"{before.flow_kg_s:g} to {step.flow_kg_s:g} kg/s {took}")
    return f"Time to stay within {SETTLED:.0%} of the commanded flow: {', '.join(words)}."


PAPER_DEG_S = 50.0  # opening speed in the paper, deg/s
SLOW_DEG_S = 5.0  # speed, deg/s: the pressure follows within 7 %, and the joint does not stick
OPEN_DEG = 30.0
CYCLE_S = 0.001
STEADY = 0.05  # relative deviation of the speed up to which the motion counts as uniform
SMOOTHING_S = 0.020  # time, s, over which the speed is computed from the joint encoder
REST_S = 0.2


@dataclass(frozen=True)
class Sweep:
    """One opening of the valve as the bench's sensors measure it; arrays of shape (n,)."""

    speed_deg_s: float  # commanded speed
    time: Array  # time, s
    angle: Array  # angle of the joint encoder, rad
    current: Array  # mean current over each cycle, A
    pressure: Array  # pressure by the transmitter, Pa
    area: Array  # impacted area A_s at the angle, m^2
    steady_pressure: Array  # steady pressure at that angle, Pa
    uniform: NDArray[np.bool_]  # samples at the commanded speed
    # Spearman's rank correlation of current and pressure over the samples in `uniform`.
    rank_pressure: float
    # Spearman's rank correlation of current and area over the samples in `uniform`.
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


def sweep(machine: Machine, speed_deg_s: float, seed: int = 0) -> Sweep:
    """Open the valve of a burning gas generator from 0 to 30 deg at constant speed."""
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
    area = impacted_area(machine, samples.angle)
    wanted = math.radians(speed_deg_s)
    width = round(SMOOTHING_S / CYCLE_S)
    kernel = np.ones(width) / width
    speed = np.convolve(np.gradient(samples.angle, CYCLE_S), kernel, mode="same")
    marks = np.abs(speed - wanted) <= STEADY * wanted
    marks[:width] = marks[-width:] = False
    uniform = np.asarray(marks)
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
        steady_pressure(machine, samples.angle),
        uniform,
        *ranks,
    )


_ENDS_DEG = np.array([5.0, 29.0])


def sweep_exhibit(seed: int) -> Exhibit:
    """Return Fig. 4 at the paper's speed, and where the pressure follows the throat area."""
    machine = true_machine("practical_hot")
    sweeps = [sweep(machine, speed, seed) for speed in (PAPER_DEG_S, SLOW_DEG_S)]
    lines, curves = [], []
    for found in sweeps:
        (_, current, pressure, area), (_, *last) = found.at(_ENDS_DEG)
        lines.append(
            f"At {found.speed_deg_s:g} deg/s: from {_ENDS_DEG[0]:g} to {_ENDS_DEG[1]:g} deg the "
            f"current falls from {current:.2f} to {last[0]:.2f} A, the pressure from "
            f"{pressure:.2f} to {last[1]:.2f} MPa, the area from {area:.0f} to {last[2]:.0f} "
            f"mm^2. Rank correlation of the current with the pressure {found.rank_pressure:.3f}, "
            f"with the area {found.rank_area:.3f}. The pressure stays up to "
            f"{100.0 * found.lag:.0f} % above the steady pressure."
        )
        curves.append(
            (
                f"{found.speed_deg_s:g} deg/s",
                np.rad2deg(found.angle),
                np.where(found.uniform, found.current, np.nan),
                1e-6 * found.pressure,
                1e-6 * found.steady_pressure,
                1e6 * found.area,
            )
        )
    caption = "Fig. 4: an opening valve, at the speed of the paper and slowly"
    return Exhibit(
        "fig_4",
        "Fig. 4: the motor's current falls with pressure and impacted area",
        "The valve turns from 0 to 30 deg at 50 deg/s under a stable pressure; the curve of the "
        "current falls as the pressure and the impacted area fall. The text gives no values of the "
        "curve.",
        tuple(lines),
        (Picture.of("fig_4", caption, regulator.sweep(curves)),),
        {
            name: columns(
                time_s=found.time,
                angle_rad=found.angle,
                current_A=found.current,
                pressure_Pa=found.pressure,
                steady_pressure_Pa=found.steady_pressure,
                impacted_area_m2=found.area,
                uniform=found.uniform.astype(np.float64),
            )
            for name, found in zip(("fig_4", "fig_4_slow"), sweeps, strict=True)
        },
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
    return _exhibit(
        "fig_3",
        "Fig. 3: impacted and effective throat area",
        "The platform, and the schematic of the impacted area: d = 25 mm, D = 40 mm, b = 54 mm; "
        "the greatest throat is the sum of both areas; the valve turns from 0 to 30 deg. The "
        "paper announces the curve of the throat area, but does not print this curve.",
        [
            f"A_s = {impacted[0]:.4g} m^2 and A_t = {throat[0]:.4g} m^2 at 0 deg; the plate has "
            f"left the opening at {clear:.2f} deg, by the paper at 30 deg; A_s + A_t = "
            f"{total:.5g} m^2 at every angle."
        ],
        "Fig. 3: areas against the valve angle",
        regulator.areas(angle_deg, impacted, throat, clear),
        columns(angle_deg=angle_deg, impacted_area_m2=impacted, throat_area_m2=throat),
    )
