"""What ``rig paper`` leaves behind: tables, result file, page."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.plots.spread import spread
from identification.recording import Dataset
from rig.errors import InputError
from rig.figures import Picture, save
from rig.paper import DURATION_S, RATE_HZ, TABLE_1, TABLE_2, WRONG_BASIN_PERCENT, Printed, Reproduction
from rig.parameter_table import Table
from rig.places import write_json, write_text
from rig.report import provenance_tables, render
from rig.results import PAPER_SCHEMA, Provenance, finite
from rig.tables import number, percent

RESULT_FILE = "paper.json"
_PRINTED = {**TABLE_1, **TABLE_2}
_TITLES = {"Table 1: system load and inertia, Case 1": TABLE_1, "Table 2: working load, Case 2": TABLE_2}


def tables(found: Reproduction) -> dict[str, Table]:
    """Return Tables 1 and 2, printed values beside ours."""
    header = ["parameter", "printed original", "simulated", "printed identified", "printed error"]
    for method in found.runs:
        header += [f"{method}: worst value", "worst error", "median error"]
    right = tuple(range(1, len(header)))
    return {
        title: Table(tuple(header), tuple(_row(found, name, printed) for name, printed in rows.items()), right)
        for title, rows in _TITLES.items()
    }


def remarks(found: Reproduction) -> list[str]:
    """Return what the tables need said beside them."""
    lines = [
        f"Literal bench: gear ratio 1, J as printed, no noise; {DURATION_S:g} s at {RATE_HZ:g} Hz per case, and the "
        "fitness is over those samples.",
        "omega_sf is 0.0577 in Table 1 and 0.0557 in the text; 0.0557 is simulated.",
    ]
    for method, runs in found.runs.items():
        wrong = found.wrong_basins(method)
        line = f"{method} method: {len(wrong)} of {len(runs)} seeds in a wrong basin"
        lines.append(f"{line} (a parameter other than J off by more than {WRONG_BASIN_PERCENT:g} %).")
        withheld = [result for result in runs.values() if not result.parameters["J"].identifiable]
        if withheld:
            lines.append(
                f"{method} method: J is not identifiable for {len(withheld)} of {len(runs)} seeds: "
                f"{withheld[0].parameters['J'].reason}."
            )
        lines += [
            f"{method} method, {stage}: target {target:g} reached by {reached} of {len(runs)} seeds; "
            f"median cost {number(cost, 3)} {unit} after {generations:.0f} generations."
            for stage, target, reached, cost, unit, generations in _searches(found, method)
        ]
    return lines


def record(found: Reproduction, provenance: Provenance, figures: Mapping[str, str]) -> dict[str, Any]:
    """Return the record of ``rig paper --json``."""
    return {
        **provenance.record(PAPER_SCHEMA),
        "tables": {
            method: {name: _entry(found, method, name, printed) for name, printed in _PRINTED.items()}
            for method in found.runs
        },
        "wrong_basins": {method: found.wrong_basins(method) for method in found.runs},
        "figures": {name: [file] for name, file in figures.items()},
        "remarks": remarks(found),
    }


def write(folder: Path, found: Reproduction, provenance: Provenance, json_file: Path | None) -> Path:
    """Write result file, figures and page into ``folder``, and the result once more where asked; return the page.

    Raises:
        InputError: A place cannot be written.
    """
    pictures = _pictures(found)
    sections = [{"title": title, "table": table, "pictures": pictures[title]} for title, table in tables(found).items()]
    page = render(
        "paper.html.j2",
        title="The paper's tables and figures, reproduced",
        subtitle="Load Characteristics and Modeling Methods for the Flow Regulator of a Solid Ducted Rocket, Sec. 4.2",
        notes=remarks(found),
        sections=sections,
        **provenance_tables(provenance),
    )
    try:
        figures = save([picture for group in pictures.values() for picture in group], folder)
        result = record(found, provenance, figures)
        for place in filter(None, (folder / RESULT_FILE, json_file)):
            write_json(place, result)
        path = folder / "report.html"
        write_text(path, page)
    except OSError as error:
        places = " or ".join(str(place) for place in (folder, json_file) if place)
        raise InputError(
            f"{places}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error
    return path


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
        "identifiable": all(result.parameters[name].identifiable for result in found.runs[method].values()),
        "seeds": {str(seed): finite(value) for seed, value in values.items()},
    }


def _searches(found: Reproduction, method: str) -> list[tuple[str, float, int, float, str, float]]:
    """Return stage, target, seeds that reached it, median cost, unit and median generations of every search."""
    runs = list(found.runs[method].values())
    out = []
    for k, stage in enumerate(runs[0].stages):
        if stage.target is not None:
            stages = [result.stages[k] for result in runs]
            cost = statistics.median(s.cost for s in stages)
            generations = statistics.median(s.generations for s in stages)
            out.append(
                (stage.stage, stage.target, sum(bool(s.reached) for s in stages), cost, stage.cost_unit, generations)
            )
    return out


def _pictures(found: Reproduction) -> dict[str, list[Picture]]:
    first = next(iter(found.runs["paper"].values()))
    groups = {
        title: [_convergence(found, figure, k), _response(found.dataset, found, k)]
        for k, (title, figure) in enumerate(zip(_TITLES, ("fig_12", "fig_13"), strict=True))
    }
    moments: dict[str, float | None] = {
        r.name: r.contact_force * (r.bench.moment_arm or 0.0) for r in found.dataset.recordings
    }
    errors = {m: {n: list(found.errors(m, n).values()) for n in _PRINTED} for m in found.runs}
    printed = {name: entry.error_percent for name, entry in _PRINTED.items()}
    groups[list(_TITLES)[-1]] += [
        Picture.of(
            "stribeck", "Friction against speed, fitted by the paper's method", fit_plots.stribeck(first, moments)
        ),
        Picture.of("errors", "Errors over the seeds", spread(errors, printed, list(_PRINTED))),
    ]
    return groups


def _convergence(found: Reproduction, name: str, stage: int) -> Picture:
    seed, result = next(iter(found.runs["paper"].items()))
    made = fit_plots.convergence(result.stages[stage], found.truth)
    return Picture.of(
        name, f"Fig. {name.removeprefix('fig_')}: convergence of the genetic algorithm, seed {seed}", made
    )


def _response(dataset: Dataset, found: Reproduction, case: int) -> Picture:
    trace = next(iter(found.runs["paper"].values())).traces[case]
    recording = dataset.recordings[case]
    return Picture.of(
        f"response_case_{case + 1}", f"{recording.name}: response", signals.response(trace, recording, "N m")
    )
