"""The report: one self-contained HTML page. It renders records and computes nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from identification.estimate.paper_method.comparison import Contender
from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.recording import Dataset, Recording
from identification.result import Fit, Identification, Trace
from rig.common.figures import Picture, save
from rig.common.parameter_table import Table, parameter_notes, parameter_table, pinned_notes
from rig.common.places import write_text
from rig.common.result_files import Provenance
from rig.common.tables import number, percent
from rig.results.comparison_table import COMPARISON_NOTE, comparison_table
from rig.results.uncertainty import uncertainty_notes, uncertainty_pictures, uncertainty_tables

_SHOWN_PER_ROLE = 6
_FIT_HEADER = ("bandwidth", "error, rms", "relative")


def write_report(
    folder: Path,
    title: str,
    dataset: Dataset,
    results: Sequence[Identification],
    provenance: Provenance,
    truth: Mapping[str, float] | None = None,
    extras: Sequence[Mapping[str, Any]] = (),
    comparison: Sequence[Contender] = (),
) -> Path:
    """Write ``report.html`` and ``figures/*.png`` of one identification, by one method or several
    side by side.

    Args:
        folder: Made if it is not there.
        title: Heading.
        dataset: What was identified.
        results: One per method; the first is the one the figures of single recordings show.
        provenance: Seed, inputs, time.
        truth: True values of a simulated bench, for display only.
        extras: Further sections: ``title``, ``table`` and ``notes`` each.
        comparison: All estimators side by side; may be empty.

    Returns:
        The page.

    Raises:
        OSError: The folder cannot be written.
    """
    first = results[0]
    recordings = {r.name: r for r in dataset.recordings}
    shown = _shown(first.traces)
    groups = {
        "parameter_figures": [
            Picture.of("intervals", "Parameters", fit_plots.intervals(results, truth))
        ],
        "uncertainty_figures": uncertainty_pictures(results),
        "fit_figures": [_stribeck(result, recordings) for result in results],
        "convergence_figures": _convergence(results, truth),
        "recording_figures": [
            p
            for trace in shown
            for p in _of_recording(trace, recordings[trace.recording], first.torque_unit)
        ],
    }
    save([picture for group in groups.values() for picture in group], folder)
    hidden = len(first.traces) - len(shown)
    page = render(
        "identify.html.j2",
        title=title,
        subtitle=f"Identification by the {' and the '.join(r.method for r in results)} method",
        warnings=[f"{r.method}: {w}" for r in results for w in r.warnings],
        parameters=parameter_table(results, truth),
        parameter_notes=[*pinned_notes(results), *parameter_notes(results)],
        uncertainty_notes=[line for result in results for line in uncertainty_notes(result)],
        uncertainty_tables=[each for result in results for each in uncertainty_tables(result)],
        has_truth=truth is not None,
        comparison=comparison_table(comparison) if comparison else None,
        comparison_note=COMPARISON_NOTE,
        fits=_fit_table(results),
        extras=extras,
        recording_fits=_recording_fit_table(results),
        stages=_stage_table(results),
        recordings=_recording_table(dataset.recordings),
        left_out=f"Figures of {hidden} more recordings are left out; their fits are in the table "
        f"above."
        if hidden
        else "",
        **groups,
        **provenance_tables(provenance),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def render(template: str, **context: Any) -> str:
    """Fill a packaged template; everything is escaped, and a name the template lacks is an
    error.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    return environment.get_template(template).render(**context)


def provenance_tables(provenance: Provenance) -> dict[str, Table]:
    """Return the tables that end every page."""
    facts = (
        (
            "versions",
            ", ".join(f"{name} {release}" for name, release in provenance.versions.items()),
        ),
        ("created", provenance.created),
        ("seed", str(provenance.seed)),
        ("time spent", f"{provenance.seconds:.3g} s"),
    )
    files = tuple(provenance.inputs.items())
    return {
        "provenance": Table(("fact", "value"), facts, ()),
        "inputs": Table(("input file", "SHA-256"), files, ()),
    }


def _shown(traces: Sequence[Trace]) -> list[Trace]:
    return [
        t
        for role in ("fit", "validate")
        for t in [t for t in traces if t.role == role][:_SHOWN_PER_ROLE]
    ]


def _stribeck(result: Identification, recordings: Mapping[str, Recording]) -> Picture:
    moments = {
        name: None if r.hot_fire else r.contact_force * (r.bench.moment_arm or 0.0)
        for name, r in recordings.items()
    }
    return Picture.of(
        f"stribeck_{result.method}",
        f"Friction against speed, measured and fitted by the {result.method} method",
        fit_plots.stribeck(result, moments),
    )


def _convergence(
    results: Sequence[Identification], truth: Mapping[str, float] | None
) -> list[Picture]:
    return [
        Picture.of(
            f"convergence_{result.method}_{stage.stage}",
            f"Convergence of the {stage.stage} stage, {result.method} method",
            fit_plots.convergence(stage, truth),
        )
        for result in results
        for stage in result.stages
        if stage.cost_history is not None and stage.parameter_history
    ]


def _of_recording(trace: Trace, recording: Recording, unit: str) -> list[Picture]:
    return [
        Picture.of(
            f"response_{trace.recording}",
            f"{trace.recording}: response",
            signals.response(trace, recording, unit),
        ),
        Picture.of(
            f"residual_{trace.recording}",
            f"{trace.recording}: what the model leaves over",
            signals.residual(trace, recording.bench.motion, unit),
        ),
    ]


def _fit_table(results: Sequence[Identification]) -> Table:
    rows = []
    for result in results:
        fit = result.fit
        rows.append(
            (result.method, "all", "fit", *_fit_cells(fit, fit.train_rms, fit.train_relative))
        )
        if fit.validate_rms is not None:
            rows.append(
                (
                    result.method,
                    "all",
                    "validate",
                    *_fit_cells(fit, fit.validate_rms, fit.validate_relative),
                )
            )
    return Table(("method", "recordings", "role", *_FIT_HEADER), tuple(rows), (3, 4, 5))


def _recording_fit_table(results: Sequence[Identification]) -> Table:
    rows = []
    for result in results:
        roles = {trace.recording: trace.role for trace in result.traces}
        rows += [
            (result.method, name, roles[name], *_fit_cells(fit, fit.train_rms, fit.train_relative))
            for name, fit in result.fits_by_recording.items()
        ]
    return Table(("method", "recording", "role", *_FIT_HEADER), tuple(rows), (3, 4, 5))


def _fit_cells(fit: Fit, rms: float | None, relative: float | None) -> tuple[str, str, str]:
    return (
        f"{number(fit.bandwidth_Hz, 4)} Hz",
        "-" if rms is None else f"{number(rms, 4)} {fit.unit}",
        percent(None if relative is None else 100.0 * relative),
    )


def _stage_table(results: Sequence[Identification]) -> Table:
    rows = tuple(
        (
            result.method,
            stage.stage,
            stage.method,
            str(stage.evaluations),
            str(stage.generations),
            f"{number(stage.cost, 4)} {stage.cost_unit}",
            "-" if stage.target is None else f"{number(stage.target)} {stage.cost_unit}",
            {None: "-", True: "yes", False: "no"}[stage.reached],
        )
        for result in results
        for stage in result.stages
    )
    header = (
        "method",
        "stage",
        "optimiser",
        "evaluations",
        "generations",
        "cost",
        "target",
        "reached",
    )
    return Table(header, rows, (3, 4, 5, 6))


def _recording_table(recordings: Sequence[Recording]) -> Table:
    rows = tuple(
        (
            r.name,
            r.role,
            r.stage,
            "gas generator" if r.hot_fire else f"{number(r.weight_mass)} kg",
            str(len(r.time)),
            f"{number(1.0 / r.period, 4)} Hz",
            "; ".join(r.notes) or "none",
        )
        for r in recordings
    )
    return Table(
        ("recording", "role", "stage", "weight", "samples", "rate", "corrections"), rows, (3, 4, 5)
    )
