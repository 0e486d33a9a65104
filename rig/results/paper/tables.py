"""Tables 1 and 2, Fig. 12 and 13: the paper's verification on the literal bench."""

from __future__ import annotations

import math
import statistics
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import GasGenerator, Machine
from identification.numerics.arrays import Progress, finite
from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.plots.fit import spread
from identification.recording import Array, Bench, Dataset, Recording
from identification.result import Identification
from rig.common.provenance import Provenance
from rig.common.tables import number, percent
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.results.document import (
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    SideBySide,
    Table,
    provenance_section,
)
from rig.results.identify.identify import METHODS
from rig.results.paper import figures
from rig.results.paper.figures import Exhibit, columns, files_of, true_machine
from rig.runs.recorded_inputs import true_parameters
from rig.runs.run import bench_constants

CONTACT_FORCE_N = 3000.0
"""Contact force F_P of Case 2 (Sec. 4.2.2), N."""
DURATION_S = 5.0
RATE_HZ = 1000.0
"""Duration, s (one period of the command), and sample rate, Hz, which the paper does not state. The
fitness sqrt(sum e^2) is the sum over all samples of this duration.
"""
WRONG_BASIN_PERCENT = 20.0  # largest error, %, of a parameter but J in the right basin


@dataclass(frozen=True)
class Printed:
    """One column of Table 1 or 2 with the printed values."""

    original: float
    identified: float
    error_percent: float


TABLE_1: Mapping[str, Printed] = {
    "Mc": Printed(6.8250, 6.7478, 1.13),
    "Ms": Printed(12.025, 11.935, 0.74),
    "omega_sf": Printed(0.0577, 0.0577, 0.0),  # 0.0557 in the text, which is what is simulated
    "sigma_2": Printed(5.3462, 5.5400, 3.62),
    "J": Printed(0.000204, 0.0002048, 0.39),
}
TABLE_2: Mapping[str, Printed] = {
    "mu_c": Printed(0.0520, 0.0524, 0.77),
    "mu_s": Printed(0.0860, 0.0869, 1.05),
    "omega_sL": Printed(0.0326, 0.0318, 2.45),
    "mu_2": Printed(0.032, 0.031, 3.12),
}


@dataclass(frozen=True)
class Reproduction:
    """Result of ``rig paper``."""

    dataset: Dataset
    truth: Mapping[str, float]
    runs: Mapping[str, Mapping[int, Identification]]

    def found(self, method: str, name: str) -> dict[int, float | None]:
        """Return the estimates of one parameter by one method, one for each seed.

        A genetic search always ends with some value of J, which the result withholds if the data do
        not determine J; for the comparison with Table 1, the value is read from the search history.
        """
        return {seed: _value(result, name) for seed, result in self.runs[method].items()}

    def errors(self, method: str, name: str) -> dict[int, float]:
        """Return the error for each seed, percent; infinite without an estimate."""
        return {
            seed: math.inf if value is None else 100.0 * abs(value / self.truth[name] - 1.0)
            for seed, value in self.found(method, name).items()
        }

    def worst_seed(self, method: str, name: str) -> int:
        """Return the seed with the largest error in one parameter."""
        errors = self.errors(method, name)
        return max(errors, key=lambda seed: errors[seed])

    def wrong_basins(self, method: str) -> list[int]:
        """Return the seeds that ended far from the true value of a parameter other than J."""
        worst = {seed: 0.0 for seed in self.runs[method]}
        for name in (*TABLE_1, *TABLE_2):
            if name != "J":
                worst = {
                    seed: max(worst[seed], error)
                    for seed, error in self.errors(method, name).items()
                }
        return [seed for seed, error in worst.items() if error > WRONG_BASIN_PERCENT]


def reproduce(seeds: Sequence[int], progress: Progress) -> Reproduction:
    """Simulate the literal bench without noise, and identify it by both methods per seed."""
    progress("simulating the literal bench", 0.0)
    dataset, truth = simulate_cases()
    runs: dict[str, dict[int, Identification]] = {method: {} for method in METHODS}
    jobs = [(method, seed) for method in METHODS for seed in seeds]
    for done, (method, seed) in enumerate(jobs):
        progress(f"{method} method, seed {seed}", done / len(jobs))
        rng = np.random.default_rng(seed)
        runs[method][seed] = METHODS[method](dataset, bandwidth_Hz=0.5 * RATE_HZ, rng=rng)
    progress("done", 1.0)
    return Reproduction(dataset, truth, runs)


def simulate_cases() -> tuple[Dataset, dict[str, float]]:
    """Return Case 1 and 2 on the literal bench as recordings, and the true parameters."""
    machine, constants = true_machine("literal"), bench_constants(load_bench("literal").value)
    cases = (
        _case(machine, constants, "Case 1", 0.0),
        _case(machine, constants, "Case 2", CONTACT_FORCE_N),
    )
    return Dataset(cases), true_parameters(machine)


def command(time: Array) -> Array:
    """Return theta_c = 20 deg sin(0.4 pi t), rad (Sec. 4.2.1; "0.4 pi r t" there is a misprint)."""
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))


def _case(machine: Machine, bench: Bench, name: str, force_N: float) -> Recording:
    """Simulate one case; the current is sampled instantaneously, and no channel is quantised."""
    out = simulate(machine, command, DURATION_S, RATE_HZ, contact_force_N=force_N)
    return Recording(
        name=name,
        channels={
            channel: out[channel] for channel in ("time", "command", "angle", "velocity", "current")
        },
        bench=bench,
        stage="loaded" if force_N else "unloaded",
        weight_mass=force_N / (bench.lever_ratio * bench.gravity),
        notes=("simulated, literal bench, no noise",),
    )


def _value(result: Identification, name: str) -> float | None:
    parameter = result.parameters[name]
    if parameter.value is not None:
        return parameter.value
    for stage in result.stages:
        if name in stage.parameter_history:
            return float(stage.parameter_history[name][-1])
    return None


PRINTED = {**TABLE_1, **TABLE_2}
_TITLES = {
    "Table 1: system load and inertia, Case 1": TABLE_1,
    "Table 2: working load, Case 2": TABLE_2,
}
_PAPER = (
    "Fig. 12: the parameters of Case 1 converge in the genetic algorithm; the cost reaches the "
    "target of 0.01 N m in generation 469. Table 1: errors of 0 to 3.62 %.",
    "Fig. 13: the parameters of Case 2 (3000 N) converge; the cost reaches the target of 0.015 N m "
    "in generation 152. Table 2: errors of 0.77 to 3.12 %.",
)
_THIN = 5  # the data files contain every fifth sample


def tables(found: Reproduction) -> dict[str, Table]:
    """Return Tables 1 and 2, with the printed values and the values of this program."""
    header = ["parameter", "printed original", "simulated", "printed identified", "printed error"]
    for method in found.runs:
        header += [f"{method}: worst value", "worst error", "median error"]
    right = tuple(range(1, len(header)))
    return {
        title: Table(
            tuple(header),
            tuple(_row(found, name, printed) for name, printed in rows.items()),
            right,
        )
        for title, rows in _TITLES.items()
    }


def remarks(found: Reproduction) -> list[str]:
    """Return remarks on the tables."""
    lines = [
        f"Literal bench: gear ratio 1, J as printed, no noise; {DURATION_S:g} s at {RATE_HZ:g} Hz "
        f"per case; the fitness is the sum over all samples of a case.",
        "omega_sf is 0.0577 in Table 1 and 0.0557 in the text; 0.0557 is simulated.",
    ]
    for method, runs in found.runs.items():
        wrong = found.wrong_basins(method)
        line = f"{method} method: {len(wrong)} of {len(runs)} seeds in a wrong basin"
        lines.append(
            f"{line} (a parameter other than J off by more than {WRONG_BASIN_PERCENT:g} %)."
        )
        withheld = [result for result in runs.values() if not result.parameters["J"].identifiable]
        if withheld:
            lines.append(
                f"{method} method: J is not identifiable for {len(withheld)} of {len(runs)} seeds: "
                f"{withheld[0].parameters['J'].reason}."
            )
        for same in zip(*(result.stages for result in runs.values()), strict=True):
            first, reached = same[0], sum(bool(s.reached) for s in same)
            if first.target is not None:
                cost = statistics.median(s.cost for s in same)
                generations = statistics.median(s.generations for s in same)
                lines.append(
                    f"{method} method, {first.stage}: target {first.target:g} reached by {reached} "
                    f"of {len(runs)} seeds; median cost {number(cost, 3)} {first.cost_unit} after "
                    f"{generations:.0f} generations."
                )
    return lines


def exhibits(found: Reproduction) -> list[Exhibit]:
    """Return Table 1 with Fig. 12, and Table 2 with Fig. 13 and with the errors over the seeds."""
    made = []
    for k, (title, table) in enumerate(tables(found).items()):
        fig = f"fig_{12 + k}"
        seed, first = next(iter(found.runs["paper"].items()))
        caption = f"Fig. {12 + k}: convergence of the genetic algorithm, seed {seed}"
        recording, trace = found.dataset.recordings[k], first.traces[k]
        response = f"response_case_{k + 1}"
        pictures = [
            Picture.of(fig, caption, fit_plots.convergence(first.stages[k], found.truth)),
            Picture.of(
                response, f"{recording.name}: response", signals.response(trace, recording, "N m")
            ),
        ]
        few = slice(None, None, _THIN)
        signal = columns(
            time_s=trace.time[few],
            angle_rad=trace.angle[few],
            velocity_rad_s=trace.velocity[few],
            torque_N_m=trace.torque[few],
            torque_model_N_m=trace.torque_model[few],
        )
        stage = first.stages[k]
        costs = np.array([stage.cost]) if stage.cost_history is None else stage.cost_history
        generation, history = np.arange(1.0, len(costs) + 1.0), dict(stage.parameter_history)
        search = columns(generation=generation, fitness=costs, **history)
        data = {fig: search, response: signal}
        said = (*_worst(found, list(_TITLES[title])), *(remarks(found) if k == 0 else ()))
        made.append(Exhibit(f"table_{k + 1}", title, _PAPER[k], said, tuple(pictures), data, table))
    made.append(_over_seeds(found))
    return made


def _worst(found: Reproduction, names: Sequence[str]) -> Iterator[str]:
    """Yield the worst parameter of each method in a table but J, whose errors are separate."""
    for method, runs in found.runs.items():
        errors = {name: max(found.errors(method, name).values()) for name in names if name != "J"}
        worst = max(errors, key=lambda name: errors[name])
        off = percent(finite(errors[worst]))
        yield f"{method} method, worst of {len(runs)} seeds: {worst} by {off}."


def _over_seeds(found: Reproduction) -> Exhibit:
    first = next(iter(found.runs["paper"].values()))
    moments = {
        r.name: r.contact_force * (r.bench.moment_arm or 0.0) for r in found.dataset.recordings
    }
    errors = {m: {n: list(found.errors(m, n).values()) for n in PRINTED} for m in found.runs}
    printed = {name: entry.error_percent for name, entry in PRINTED.items()}
    rows = [
        (method, str(seed), name, error)
        for method in found.runs
        for name in PRINTED
        for seed, error in found.errors(method, name).items()
    ]
    stribeck = "Friction against speed, fitted by the paper's method"
    return Exhibit(
        "errors",
        "Tables 1 and 2 over the seeds",
        "One identification of each case; the paper reports no others.",
        ("One point for each seed and method; a bar is the error that the paper states.",),
        (
            Picture.of("errors", "Errors over the seeds", spread(errors, printed, list(PRINTED))),
            Picture.of("stribeck", stribeck, fit_plots.stribeck(first, moments)),
        ),
        {
            "errors": (("method", "seed", "parameter", "error_percent"), rows),
            "stribeck": (
                ("recording", "velocity_rad_s", "friction_N_m"),
                [
                    (trace.recording, v, m)
                    for trace in first.traces
                    for v, m in zip(
                        trace.velocity[::_THIN].tolist(),
                        trace.friction[::_THIN].tolist(),
                        strict=True,
                    )
                ],
            ),
        },
    )


def _row(found: Reproduction, name: str, printed: Printed) -> tuple[str, ...]:
    cells = [
        name,
        number(printed.original),
        number(found.truth[name]),
        number(printed.identified),
        percent(printed.error_percent),
    ]
    for method in found.runs:
        errors = found.errors(method, name)
        worst = found.worst_seed(method, name)
        cells += [
            number(found.found(method, name)[worst]),
            percent(finite(errors[worst])),
            percent(finite(statistics.median(errors.values()))),
        ]
    return tuple(cells)


def chosen() -> list[str]:
    """Return one line for each chosen value."""
    gas = GasGenerator()
    practical, soft, literal = (
        true_machine(name) for name in ("practical", "practical_soft", "literal")
    )
    ramp = load_sequence("slow_ramp").value.stages[0].ramp
    if ramp is None:
        raise ValueError("the packaged sequence 'slow_ramp' has no ramp")
    stiff = practical.loops
    share = math.sqrt(gas.energy_J_kg) / gas.characteristic_velocity_m_s
    return [
        "Gear ratio: with the printed motor constants friction would require 228 to 401 A; "
        "assumption 5, theta = i theta_r, is missing from eq. 1 and 15. The literal bench has i = "
        "1 and no current limit, and is used for the tables; the practical bench has i = "
        f"{practical.motor.gear_ratio:g}, {stiff.voltage_limit_V:g} V and "
        f"{stiff.current_limit_A:g} A.",
        f"Inertia of the practical bench: {practical.joint.inertia_kg_m2:g} kg m^2 at the joint, "
        f"in place of the printed {literal.joint.inertia_kg_m2:g} kg m^2.",
        f"Position loop: stiff gains {stiff.position_gain:g} 1/s, "
        f"{stiff.velocity_gain_N_m_s_rad:g} N m s/rad, {stiff.velocity_integral_1_s:g} 1/s; soft "
        f"gains, position P only, {soft.loops.position_gain:g} N m/rad.",
        "omega_sf = 0.0557 rad/s as in the text, not the 0.0577 of Table 1; mu = 0.086 is read as "
        "mu_s, 0.4 pi r t as 0.4 pi t, and the amplitude 20 as 20 degrees.",
        "sgn(omega) in eq. 12, 13 and 15, without which friction would drive the joint; at rest "
        "friction balances the drive torque up "
        f"to the static limit. alpha = {practical.joint.alpha:g} in eq. 9 as in eq. 13.",
        f"Samples of the identification: {DURATION_S:g} s at {RATE_HZ:g} Hz in each case.",
        f"Ramp of Fig. 2 and 9: {ramp.travel_deg:g} deg at {ramp.speed_deg_s:g} deg/s and back.",
        f"Gas generator: C_r = {gas.characteristic_velocity_m_s:g} m/s; R_g T_g = ({share:.3f} "
        f"C_r)^2 = {gas.energy_J_kg:.4g} J/kg; V_0 = {gas.free_volume_m3:g} m^3; p_c0 = "
        f"{1e-6 * gas.back_pressure_Pa:g} MPa; r = a p^n in mm/s with p in MPa.",
        "Valve: the plate swings in its own plane on L1 = 0.095 m, its hole over the opening's "
        "centre at 0 deg.",
        "Flow controller of Fig. 5 and 11: flow command to pressure command (eq. 2), PI on the "
        "logarithm of the pressure, anti-windup; its gains are in the sequence file.",
    ]


PAPER_SCHEMA = "loadrig.paper/1"
RESULT_FILE = "paper.json"


def paper_record(
    found: Reproduction, exhibits: Sequence[Exhibit], provenance: Provenance
) -> dict[str, Any]:
    """Return the record of ``rig paper --json``."""
    return {
        **provenance.record(PAPER_SCHEMA),
        "tables": {
            method: {
                name: _entry(found, method, name, printed) for name, printed in PRINTED.items()
            }
            for method in found.runs
        },
        "wrong_basins": {method: found.wrong_basins(method) for method in found.runs},
        "figures": files_of(exhibits),
        "remarks": remarks(found),
        "findings": {exhibit.name: list(exhibit.found) for exhibit in exhibits},
        "chosen": chosen(),
    }


def _entry(found: Reproduction, method: str, name: str, printed: Printed) -> dict[str, Any]:
    values, errors = found.found(method, name), found.errors(method, name)
    worst = found.worst_seed(method, name)
    return {
        "true": found.truth[name],
        "printed": printed.identified,
        "identified": finite(values[worst]),
        "error_percent": finite(errors[worst]),
        "printed_true": printed.original,
        "printed_error_percent": printed.error_percent,
        "median_error_percent": finite(statistics.median(errors.values())),
        "identifiable": all(
            result.parameters[name].identifiable for result in found.runs[method].values()
        ),
        "seeds": {str(seed): finite(value) for seed, value in values.items()},
    }


PAGE_FILE = "paper.html"


def paper_document(
    found: Reproduction,
    figures: Sequence[Exhibit],
    of_tables: Sequence[Exhibit],
    provenance: Provenance,
) -> Document:
    """Return the reproduction of the paper as a document."""
    sections = (
        *map(_section, (*figures, *of_tables)),
        Section("Chosen here, because the paper does not state it", (_listed(chosen()),), "chosen"),
        provenance_section(provenance),
    )
    return Document(
        "The paper's figures and tables, reproduced",
        "Load Characteristics and Modeling Methods for the Flow Regulator of a Solid Ducted Rocket",
        tuple(_summary(found, figures)),
        sections,
    )


def _summary(found: Reproduction, figures: Sequence[Exhibit]) -> Iterator[Section]:
    for title, cells in tables(found).items():
        yield Section(title, (cells,))
    yield Section("", tuple(map(Note, remarks(found))))
    for exhibit in figures:
        yield Section(exhibit.title, (_listed(exhibit.found),))


def _section(exhibit: Exhibit) -> Section:
    paper = Section("The paper", (Paragraph(exhibit.paper),))
    here = Section("Here", tuple(map(Paragraph, exhibit.found)))
    values = () if exhibit.table is None else (exhibit.table,)
    return Section(
        exhibit.title, (SideBySide(paper, here), *values, *exhibit.pictures), exhibit.name
    )


def _listed(lines: Sequence[str]) -> Items:
    return Items(tuple(("", line) for line in lines))


def study(seed: int, progress: Progress) -> list[Exhibit]:
    """Make the runs and draw all figures except those of the tables, in the order of the paper."""
    with tempfile.TemporaryDirectory(prefix="rig-paper-") as name:
        scratch = Path(name)
        progress("Fig. 2 and 9: slow ramps", 0.0)
        fig_2, fig_9 = figures.ramp_exhibits(scratch, seed)
        progress("eq. 14: uniform motion on two gain sets", 0.1)
        eq_14 = figures.uniform_exhibit(figures.measure(scratch, seed))
        progress("Fig. 4: the opening valve", 0.85)
        fig_4 = figures.sweep_exhibit(seed)
        progress("Fig. 5 and 11: the closed loop", 0.9)
        fig_11 = figures.loop_exhibit(scratch, seed)
    return [fig_2, figures.valve_exhibit(), fig_4, fig_11, fig_9, eq_14]
