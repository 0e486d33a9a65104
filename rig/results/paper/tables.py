"""Tables 1 and 2, Fig. 12 and 13: the paper's verification on the literal bench."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

import numpy as np

from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.plots.spread import spread
from identification.result import Convergence
from rig.common.result_files import finite
from rig.common.tables import number, percent
from rig.results.document import Picture, Table
from rig.results.paper.exhibit import Exhibit, Rows, columns
from rig.results.paper.parameters import (
    DURATION_S,
    RATE_HZ,
    TABLE_1,
    TABLE_2,
    WRONG_BASIN_PERCENT,
    Printed,
    Reproduction,
)

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
        lines += [
            f"{method} method, {stage}: target {target:g} reached by {reached} of {len(runs)} "
            f"seeds; "
            f"median cost {number(cost, 3)} {unit} after {generations:.0f} generations."
            for stage, target, reached, cost, unit, generations in _searches(found, method)
        ]
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
        data = {fig: _history(first.stages[k]), response: signal}
        said = (*_worst(found, list(_TITLES[title])), *(remarks(found) if k == 0 else ()))
        made.append(Exhibit(f"table_{k + 1}", title, _PAPER[k], said, tuple(pictures), data, table))
    made.append(_over_seeds(found))
    return made


def _worst(found: Reproduction, names: Sequence[str]) -> list[str]:
    """Return the worst parameter of each method in a table; J is left out, because its errors are
    reported separately.
    """
    lines = []
    for method, runs in found.runs.items():
        errors = {name: max(found.errors(method, name).values()) for name in names if name != "J"}
        worst = max(errors, key=lambda name: errors[name])
        lines.append(
            f"{method} method, worst of {len(runs)} seeds: {worst} by "
            f"{percent(finite(errors[worst]))}."
        )
    return lines


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
        ("Every seed of both methods, and the printed error as a bar.",),
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


def _history(stage: Convergence) -> Rows:
    costs = stage.cost_history if stage.cost_history is not None else np.array([stage.cost])
    named = dict(stage.parameter_history)
    return columns(generation=np.arange(1.0, len(costs) + 1.0), fitness=costs, **named)


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


def _searches(found: Reproduction, method: str) -> list[tuple[str, float, int, float, str, float]]:
    """Return for every search its stage, target, number of seeds that reached the target, median
    cost, unit and median number of generations.
    """
    runs = list(found.runs[method].values())
    out = []
    for k, stage in enumerate(runs[0].stages):
        if stage.target is not None:
            stages = [result.stages[k] for result in runs]
            cost = statistics.median(s.cost for s in stages)
            generations = statistics.median(s.generations for s in stages)
            out.append(
                (
                    stage.stage,
                    stage.target,
                    sum(bool(s.reached) for s in stages),
                    cost,
                    stage.cost_unit,
                    generations,
                )
            )
    return out
