"""Output of ``rig identify`` as a document, for one or several methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from identification.plots import fit as fit_plots
from identification.plots import result as opening
from identification.plots import signals
from identification.recording import Recording
from identification.result import Identification, Trace
from rig.common.tables import number, percent
from rig.results.document import Document, Note, Picture, Section, Table
from rig.results.identify.identify import Outcome
from rig.results.identify.parameters import parameter_notes, parameter_table, pinned_notes
from rig.results.identify.simulated_tables import simulated_notes, simulated_table
from rig.results.identify.tables import (
    COMPARISON_NOTE,
    comparison_table,
    fit_table,
    ladder_notes,
    ladder_table,
    recording_fit_table,
    recording_table,
    stage_table,
    transfer_notes,
    transfer_table,
)
from rig.results.identify.uncertainty import (
    uncertainty_notes,
    uncertainty_pictures,
    uncertainty_tables,
)
from rig.results.sections import few_of_each_role, provenance_section, reading_notes

_SHOWN_PER_ROLE = 6
_TRUTH = (
    'The column "true" has the parameters of the simulated bench, which are read from its file '
    "after the fit, for this table only."
)


class Extra(NamedTuple):
    """An optional part of the result: title, table and explanatory lines."""

    title: str
    table: Table
    notes: Sequence[str]


def identify_document(
    name: str,
    outcome: Outcome,
    truth: Mapping[str, float] | None = None,
    facts: tuple[tuple[str, str], ...] = (),
) -> Document:
    """Return an identification as a document.

    Args:
        name: Name of the source.
        outcome: The result; figures of single recordings show the result of the first method.
        truth: True values of a simulated bench, only for display.
        facts: Facts at the top of the page, such as bench, date and operator.
    """
    results = outcome.results
    return Document(
        f"Identification of {name}",
        f"Identification by the {' and the '.join(r.method for r in results)} method",
        tuple(_summary(outcome, truth)),
        tuple(_sections(outcome, truth)),
        facts,
    )


def _summary(outcome: Outcome, truth: Mapping[str, float] | None) -> Iterator[Section]:
    results = outcome.results
    yield Section("", (parameter_table(results, truth),))
    lines = [*map(_fit_line, results), *pinned_notes(results)]
    lines += [line for result in results for line in uncertainty_notes(result)]
    yield Section("", tuple(map(Note, lines)))
    for cells, line in (each for result in results for each in uncertainty_tables(result)):
        yield Section("", (cells, Note(line)))
    if outcome.comparison:
        yield Section("", (comparison_table(outcome.comparison), Note(COMPARISON_NOTE)))
    for extra in _extras(outcome):
        yield Section(extra.title, (extra.table, *map(Note, extra.notes)))
    last = (
        *map(Note, reading_notes(outcome.dataset.recordings)),
        *(Note(line, "aside") for line in parameter_notes(results)),
        *_warnings(results),
    )
    if last:
        yield Section("", last)


def _sections(outcome: Outcome, truth: Mapping[str, float] | None) -> Iterator[Section]:
    results = outcome.results
    yield Section("", (_lead(outcome),))
    if warnings := _warnings(results):
        yield Section("Warnings", tuple(warnings))
    yield Section("Parameters", tuple(_parameters(results, truth)))
    yield Section("How sure", tuple(_how_sure(results)))
    if outcome.comparison:
        cells = comparison_table(outcome.comparison)
        yield Section("Estimators side by side", (cells, Note(COMPARISON_NOTE, "aside")))
    recordings = {r.name: r for r in outcome.dataset.recordings}
    yield Section(
        "Fit",
        (
            fit_table(results),
            recording_fit_table(results),
            *(_stribeck(result, recordings) for result in results),
        ),
    )
    for extra in _extras(outcome):
        yield Section(extra.title, (extra.table, *(Note(line, "aside") for line in extra.notes)))
    yield Section("Stages and convergence", (stage_table(results), *_convergence(results, truth)))
    yield Section("Recordings", tuple(_recordings(outcome, recordings)))
    yield provenance_section(outcome.provenance)


def _warnings(results: Sequence[Identification]) -> list[Note]:
    return [Note(f"{r.method}: {line}", "warning") for r in results for line in r.warnings]


def _extras(outcome: Outcome) -> Iterator[Extra]:
    if rungs := outcome.ladder:
        yield Extra("Ladder of friction models", ladder_table(rungs), ladder_notes(rungs))
    if simulated := outcome.simulated:
        yield Extra(
            "Friction models fitted to the simulated angle",
            simulated_table(simulated, outcome.results[0].motion),
            simulated_notes(simulated),
        )
    if (found := outcome.transfer) is not None:
        yield Extra("Transfer", transfer_table(found), transfer_notes(found))


def _fit_line(result: Identification) -> str:
    fit = result.fit
    line = (
        f"{result.method}: torque error {number(fit.train_rms, 3)} {fit.unit} rms "
        f"({percent(100.0 * fit.train_relative)}) at {number(fit.bandwidth_Hz, 3)} Hz"
    )
    if fit.validate_rms is not None and fit.validate_relative is not None:
        line += (
            f"; validate {number(fit.validate_rms, 3)} {fit.unit} rms "
            f"({percent(100.0 * fit.validate_relative)})"
        )
    return f"{line}; {result.evaluations} evaluations, {result.seconds:.1f} s"


def _parameters(
    results: Sequence[Identification], truth: Mapping[str, float] | None
) -> Iterator[Table | Note | Picture]:
    yield parameter_table(results, truth)
    for line in (*pinned_notes(results), *parameter_notes(results)):
        yield Note(line, "aside")
    if truth is not None:
        yield Note(_TRUTH, "aside")
    yield Picture.of("intervals", "Parameters", fit_plots.intervals(results, truth))


def _how_sure(results: Sequence[Identification]) -> Iterator[Table | Note | Picture]:
    for result in results:
        for line in uncertainty_notes(result):
            yield Note(line, "aside")
    for result in results:
        for cells, line in uncertainty_tables(result):
            yield cells
            yield Note(line, "aside")
    yield from uncertainty_pictures(results)


def _lead(outcome: Outcome) -> Picture:
    """Return the figure at the top of the page."""
    recordings, first = outcome.dataset.recordings, outcome.results[0]
    drawn = opening.result(first, _moments(recordings), recordings)
    what = "friction against speed, measured (dots) and identified (black); below it the recordings"
    return Picture.of("result", f"Result: {what}", drawn, lead=True)


def _moments(recordings: Sequence[Recording]) -> dict[str, float | None]:
    return {
        r.name: None if r.hot_fire else r.contact_force * (r.bench.moment_arm or 0.0)
        for r in recordings
    }


def _stribeck(result: Identification, recordings: Mapping[str, Recording]) -> Picture:
    moments = _moments(list(recordings.values()))
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


def _recordings(
    outcome: Outcome, recordings: Mapping[str, Recording]
) -> Iterator[Table | Note | Picture]:
    yield recording_table(outcome.dataset.recordings)
    first = outcome.results[0]
    shown = few_of_each_role(first.traces, lambda trace: trace.role, _SHOWN_PER_ROLE)
    if hidden := len(first.traces) - len(shown):
        yield Note(
            f"Figures of {hidden} more recordings are left out; their fits are in the table above.",
            "aside",
        )
    for trace in shown:
        yield from _of_recording(trace, recordings[trace.recording], first.torque_unit)


def _of_recording(trace: Trace, recording: Recording, unit: str) -> tuple[Picture, Picture]:
    return (
        Picture.of(
            f"response_{trace.recording}",
            f"{trace.recording}: response",
            signals.response(trace, recording, unit),
        ),
        Picture.of(
            f"residual_{trace.recording}",
            f"{trace.recording}: residual of the model",
            signals.residual(trace, recording.bench.motion, unit),
        ),
    )
