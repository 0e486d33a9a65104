"""Eq. 14: the conventional method on ramps of many speeds, with stiff and with soft gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.estimate.equation_error import (
    UNIFORM,
    UniformPoint,
    errors_percent,
    fit_uniform,
    uniform_points,
)
from identification.model.friction import load_coefficient, system_friction
from identification.plots import regulator
from rig.common.tables import number, percent
from rig.config.bench import load_bench
from rig.config.configuration import Document, load_located
from rig.config.sequence import Sequence as SequenceFile
from rig.control.session import run_simulated
from rig.results.document import Picture, Table
from rig.results.paper.exhibit import Exhibit, Rows, true_machine
from rig.runs.recorded_inputs import true_parameters

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
                f"{-0.5 * travel:g}, "
                f"ramp: {ramp}, duration_s: {duration:.9g}}}"
            )
    path = scratch / "uniform.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_located(path, SequenceFile)


def measure(scratch: Path, seed: int) -> UniformStudy:
    """Run the ramps with both gain sets of the practical bench; return a point for each interval of
    constant speed.
    """
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
    """Return the points with the true friction, and the parameters of a Stribeck curve fitted to
    the points.
    """
    sets = {
        "stiff gains, no weight": [p for p in study.points["stiff"] if not p.moment],
        "stiff gains, all points": study.points["stiff"],
        "stiff gains, uniform points": [p for p in study.points["stiff"] if p.uniform],
        "soft gains, all points": study.points["soft"],
        "soft gains, uniform points": [p for p in study.points["soft"] if p.uniform],
    }
    fits = {name: fit_uniform(points) for name, points in sets.items()}
    return Exhibit(
        "eq_14",
        "Eq. 14: the conventional method, friction from uniform motion",
        "J domega/dt = M_T - M_f(omega) = 0: the motor's torque at constant speed is the "
        "friction. The paper calls this method almost impossible for the regulator, because "
        "stick-slip prevents uniform motion; the paper gives no figures.",
        tuple(_words(gains, study.points[gains]) for gains in study.points)
        + _verdict(fits, study.truth),
        (
            Picture.of(
                "eq_14",
                f"Eq. 14: mean torque against commanded speed; hollow points: the speed varies by "
                f"more than {UNIFORM:.0%}",
                _figure(study),
            ),
        ),
        {"eq_14": _data(study)},
        _table(fits, study.truth),
    )


def _words(gains: str, points: Sequence[UniformPoint]) -> str:
    def count(loaded: bool) -> str:
        chosen = [p for p in points if (p.moment > 0.0) is loaded]
        return f"{sum(p.uniform for p in chosen)} of {len(chosen)}"

    return (
        f"{gains.capitalize()} gains: the motion was uniform in {count(False)} intervals without "
        f"weight, in {count(True)} under 3000 N."
    )


def _verdict(
    fits: Mapping[str, Mapping[str, float]], truth: Mapping[str, float]
) -> tuple[str, ...]:
    lines = []
    for name, found in fits.items():
        if not found:
            lines.append(f"{name.capitalize()}: too few points for a Stribeck curve.")
            continue
        errors = errors_percent(found, truth)
        worst = max(errors, key=lambda key: abs(errors[key]))
        lines.append(f"{name.capitalize()}: worst parameter {worst}, {errors[worst]:+.3g} %.")
    return tuple(lines)


def _table(fits: Mapping[str, Mapping[str, float]], truth: Mapping[str, float]) -> Table:
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


def _data(study: UniformStudy) -> Rows:
    titles = ("gains", "stage", "speed_rad_s", "mean_torque_N_m", "spread", "contact_moment_N_m")
    return titles, [
        (gains, p.recording, p.speed, p.torque, p.spread, p.moment)
        for gains, points in study.points.items()
        for p in points
    ]
