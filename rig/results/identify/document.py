"""Output of ``rig identify`` as a document, for one or several methods."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from identification.estimate.ladder import Interval, Rung, Transfer
from identification.estimate.paper_method import Contender
from identification.estimate.simulated_ladder import PER_VOLT, Constant, SimulatedRung
from identification.model.parameters import LADDER, LINEAR, SIMULATED
from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.recording import Recording
from identification.result import (
    Fit,
    Identification,
    MeasuredNoise,
    Parameter,
    Profile,
    Resampled,
    Trace,
)
from rig.common.tables import CHANGED, NO_CHANGE, interval, number, percent
from rig.results.document import (
    Document,
    Note,
    Picture,
    Section,
    Table,
    few_of_each_role,
    provenance_section,
    reading_notes,
)
from rig.results.identify.identify import Outcome

PROFILE_NOTE = (
    "Profile: the range in which -2 log likelihood rises by at most 2.71, with all other "
    "parameters optimised. Scaled: factor on the likelihood, because the scatter of the scores "
    "contradicts the curvature of the likelihood. Skew: distance of the estimate from the upper "
    "end of the range over its distance from the lower end."
)


BOOTSTRAP_NOTE = (
    "Bootstrap: the central 90 % of estimates from motion segments drawn with replacement. "
    "The bootstrap assumes only that the errors of different segments are independent; with few "
    "segments its ranges are somewhat too narrow."
)


CONSTANTS_NOTE = (
    "The 90 % intervals of the parameters contain the uncertainty (one standard deviation) of "
    "these constants; the values of the parameters are for the constants as given. Floor, "
    "profiles and bootstrap do not contain this uncertainty."
)
PRIORS_NOTE = (
    "Prior and recordings are combined as independent; +- is one standard deviation, which for the "
    "recordings includes the uncertainty of the constants. A prior also changes the values and "
    "intervals of the parameters that correlate with its parameter. Trade-offs, profiles and "
    "bootstrap are from the recordings alone."
)
_MOVED = 4
"""Largest number of parameters in a row of the table of constants."""


def uncertainty_notes(result: Identification) -> list[str]:
    """Return lines on trade-offs, active bounds, and the number of starts that reached the best
    optimum.
    """
    lines = [pair.statement for pair in result.tradeoffs]
    if result.least_pinned:
        lines.append(result.least_pinned)
    hit = [p.name for p in result.parameters.values() if p.at_bound]
    lines.append(f"bounds hit: {', '.join(hit)}" if hit else "bounds hit: none")
    if result.noise:
        lines.append(_noise_statement(result.noise, result.motion))
    lines += [
        f"starts of the {s.stage} stage: {s.best} of {len(s.ends)} "
        + (
            f"solved its estimating equations (chi-square up to {number(s.reached)})"
            if s.absolute
            else "ended at the best"
        )
        for s in result.starts
    ]
    return [f"{result.method}: {line}" for line in lines]


def _noise_statement(noise: MeasuredNoise, motion: str) -> str:
    """Return text on the estimated noise of the recordings."""
    torque = f"torque {number(noise.torque, 3)} {noise.unit} rms, white"
    if noise.correlated:
        over = f"correlated over {number(1e3 * noise.correlation_s, 2)} ms"
        torque += f", and {number(noise.correlated, 3)} {noise.unit} rms, {over}"
    factor, unit = (1e6, "um") if motion == LINEAR else (math.degrees(1.0), "deg")
    step, beyond = (
        f"{number(factor * each, 3)} {unit}" for each in (noise.encoder_step_rad, noise.angle_rad)
    )
    return (
        f"noise estimated from the prediction errors: {torque}; encoder step {step}, and "
        f"{beyond} rms in addition"
    )


def profile_table(result: Identification) -> Table:
    """Return one row for each profile: the 90 % range of the profile and the interval."""
    rows = [_profile_row(curve, result) for curve in result.profiles]
    return Table(
        ("parameter", "90 % interval", "profile", "skew", "scaled", "unit"),
        tuple(rows),
        (1, 2, 3, 4),
    )


def _profile_row(curve: Profile, result: Identification) -> tuple[str, ...]:
    p = result.parameters[curve.name]
    skew = None
    if curve.low is not None and curve.high is not None:
        here = result.fitted[curve.name]
        skew = (curve.high - here) / (here - curve.low)
    reach = interval(curve.low, curve.high) if skew is not None else _open(curve)
    return (
        curve.name,
        interval(p.low, p.high),
        reach,
        number(skew, 3),
        number(curve.scale, 3),
        curve.unit,
    )


def _open(curve: Profile) -> str:
    """Return the range of a profile as text; an end beyond the scanned values is open."""
    low = f"< {curve.values[0]:.4g}" if curve.low is None else f"{curve.low:.4g}"
    high = f"> {curve.values[-1]:.4g}" if curve.high is None else f"{curve.high:.4g}"
    return f"[{low}, {high}]"


def uncertainty_tables(result: Identification) -> list[tuple[Table, str]]:
    """Return the requested tables, each with its note."""
    tables = []
    if result.priors:
        tables.append((priors_table(result), PRIORS_NOTE))
    if result.known_constants:
        tables.append((constants_table(result), CONSTANTS_NOTE))
    if result.profiles:
        tables.append((profile_table(result), PROFILE_NOTE))
    if result.resampled:
        tables.append((bootstrap_table(result), BOOTSTRAP_NOTE))
    return tables


def priors_table(result: Identification) -> Table:
    """Return one row for each prior: the prior, the estimate from the recordings alone, and the
    combined estimate.
    """
    rows = tuple(
        (
            p.name,
            f"{number(p.value)} +- {number(p.uncertainty, 2)}",
            f"{number(p.alone)} +- {number(p.alone_uncertainty, 2)}",
            f"{number(p.posterior)} +- {number(p.posterior_uncertainty, 2)}",
            result.parameters[p.name].unit,
        )
        for p in result.priors
    )
    return Table(("parameter", "prior", "recordings alone", "both", "unit"), rows, (1, 2, 3))


def constants_table(result: Identification) -> Table:
    """Return one row for each uncertain constant: value, uncertainty, and the parameters that it
    changes most.
    """
    rows = []
    for constant in result.known_constants:
        shares = {
            name: shift / value
            for name, shift in constant.shifts.items()
            if (value := result.parameters[name].value)
        }
        most = sorted(shares, key=lambda name: -abs(shares[name]))[:_MOVED]
        rows.append(
            (
                constant.place,
                number(constant.value),
                f"+- {number(constant.uncertainty, 3)}",
                ", ".join(f"{name} {100.0 * shares[name]:+.3g} %" for name in most) or "nothing",
            )
        )
    return Table(
        ("constant", "value", "uncertainty", "changed most by one uncertainty"), tuple(rows), (1, 2)
    )


def bootstrap_table(result: Identification) -> Table:
    """Return one row for each parameter: the spread of the bootstrap estimates and the interval."""
    rows = [_bootstrap_row(r, result) for r in result.resampled]
    return Table(
        ("parameter", "90 % interval", "bootstrap", "draws solved", "unit"), tuple(rows), (1, 2, 3)
    )


def _bootstrap_row(r: Resampled, result: Identification) -> tuple[str, ...]:
    p = result.parameters[r.name]
    return (
        r.name,
        interval(p.low, p.high),
        interval(r.low, r.high),
        f"{r.solved} of {r.draws}",
        r.unit,
    )


def uncertainty_pictures(results: Sequence[Identification]) -> list[Picture]:
    """Return figures of profiles and of costs over starts (for more than one start)."""
    pictures = []
    for result in results:
        several = [s for s in result.starts if len(s.ends) > 1]
        if result.profiles:
            made = fit_plots.profiles(result.profiles, list(result.parameters.values()))
            pictures.append(Picture.of(f"profiles_{result.method}", "Likelihood profiles", made))
        if several:
            made = fit_plots.waterfall(several)
            pictures.append(Picture.of(f"starts_{result.method}", "Where the starts ended", made))
    return pictures


COMPARISON_NOTE = (
    "All searches minimise the paper's equation error, stage by stage, within common bounds; the "
    "default method then minimises the prediction errors. Failed: searches that ended more than "
    "0.1 % above the least cost found. Errors: of the worst parameter, in the median run."
)
_FIT_HEADER = ("bandwidth", "error, rms", "relative")


def fit_table(results: Sequence[Identification]) -> Table:
    """Return one row for each fit: the error of the fit, and the error on the recordings with role
    validate.
    """
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


def recording_fit_table(results: Sequence[Identification]) -> Table:
    """Return the error of each method on each recording."""
    rows = []
    for result in results:
        roles = {trace.recording: trace.role for trace in result.traces}
        rows += [
            (result.method, name, roles[name], *_fit_cells(fit, fit.train_rms, fit.train_relative))
            for name, fit in result.fits_by_recording.items()
        ]
    return Table(("method", "recording", "role", *_FIT_HEADER), tuple(rows), (3, 4, 5))


def stage_table(results: Sequence[Identification]) -> Table:
    """Return the number of evaluations and the final state of each stage of each method."""
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


def recording_table(recordings: Sequence[Recording]) -> Table:
    """Return the identified recordings, and the corrections that were made on reading."""
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


def comparison_table(contenders: Sequence[Contender]) -> Table:
    """Return one row for each estimator; the error column is omitted if the true values are
    unknown.
    """
    known = any(c.true_error is not None for c in contenders)
    header = (
        "estimator",
        "runs",
        "failed",
        "evaluations",
        "s",
        "cost above least",
        "error against default",
    )
    rows = [
        (
            c.name,
            str(c.runs),
            str(c.failures),
            str(c.evaluations),
            number(c.seconds, 2),
            "-" if c.excess is None else percent(100.0 * c.excess),
            "reference" if c.excess is None else f"{percent(100.0 * c.error)} ({c.worst})",
            *([_true(c)] if known else []),
        )
        for c in contenders
    ]
    return Table(
        (*header, *(["error against truth"] if known else [])), tuple(rows), (1, 2, 3, 4, 5)
    )


def ladder_table(rungs: Sequence[Rung]) -> Table:
    """Return one row for each rung of the ladder: the error of the fit, the error on the recordings
    with role validate, and the error of the simulated angle on the recordings with role validate.
    """
    first = rungs[0].result
    unit, small = first.fit.unit, "mrad" if first.motion == "rotary" else "um"
    scale = 1e3 if first.motion == "rotary" else 1e6
    header = (
        "friction",
        "terms",
        f"fit ({unit})",
        "90 %",
        f"validate ({unit})",
        "90 %",
        f"angle ({small})",
        "90 %",
        f"angle, MAE ({small})",
        "90 %",
        "best in",
    )
    rows = [
        (
            rung.friction,
            ", ".join(LADDER[rung.friction]),
            *_cells(rung.train, 1.0),
            *_cells(rung.scored, 1.0),
            *_cells(rung.angle, scale),
            *_cells(rung.angle_mae, scale),
            percent(100.0 * rung.best),
        )
        for rung in rungs
    ]
    return Table(header, tuple(rows), (2, 4, 6, 8, 10))


def ladder_notes(rungs: Sequence[Rung]) -> list[str]:
    """Return explanations of the table's columns."""
    first = rungs[0]
    where = "the recordings set aside" if first.scored is not None else "the recordings fitted"
    lines = [
        f"Torque errors are at {number(first.result.fit.bandwidth_Hz, 3)} Hz; intervals are from "
        "bootstrap draws of the recordings to fit and of the recordings to score.",
        f"Best in: share of the draws in which a rung has the least torque error on {where}.",
    ]
    if first.angle is not None:
        lines.append(
            f"Angle: rms and mean absolute error of the closed loop simulated from its command and "
            f"first sample, on {where}."
        )
    return lines


def transfer_table(found: Transfer) -> Table:
    """Return one row for each parameter: its value from either source, the difference, and whether
    the difference exceeds the joint interval.
    """
    rows = tuple(
        (
            m.name,
            number(m.first.value),
            number(m.second.value),
            number(m.difference, 3),
            "-" if m.joint is None else f"+- {number(m.joint, 3)}",
            m.unit,
            {None: "not identifiable on both", False: NO_CHANGE, True: CHANGED}[m.moved],
        )
        for m in found.parameters
    )
    return Table(
        ("parameter", "here", "there", "difference", "90 %", "unit", "finding"), rows, (1, 2, 3, 4)
    )


def transfer_notes(found: Transfer) -> list[str]:
    """Return the errors of the transfer as text."""
    fit, own = found.fit, found.own
    line = (
        "on the other source, the error of the model with the parameters of this source is "
        f"{number(fit.train_rms, 3)} {fit.unit} rms "
        f"({percent(100.0 * fit.train_relative)}) at {number(fit.bandwidth_Hz, 3)} Hz; with "
        "parameters identified on the other source it is "
        f"{number(own.train_rms, 3)} {own.unit}"
    )
    floor = found.floor
    if floor is None:
        return [
            line,
            "the noise floor of the other source is unknown: no motion is repeated under the "
            "same command",
        ]
    ways = [
        f"{count} {what}"
        for count, what in ((floor.periods, "periodic"), (floor.repeats, "repeated"))
        if count
    ]
    return [
        line,
        f"the noise floor of the other source is {number(floor.rms, 3)} {fit.unit}, from "
        f"{floor.samples} pairs of samples of {' and '.join(ways)} recordings: the error is "
        f"{number(fit.train_rms / floor.rms, 3)} times this floor",
    ]


def _fit_cells(fit: Fit, rms: float | None, relative: float | None) -> tuple[str, str, str]:
    return (
        f"{number(fit.bandwidth_Hz, 4)} Hz",
        "-" if rms is None else f"{number(rms, 4)} {fit.unit}",
        percent(None if relative is None else 100.0 * relative),
    )


def _true(c: Contender) -> str:
    return "-" if c.true_error is None else f"{percent(100.0 * c.true_error)} ({c.true_worst})"


def _cells(found: Interval | None, scale: float) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    return number(scale * found.value, 3), interval(scale * found.low, scale * found.high)


def parameter_table(
    results: Sequence[Identification], truth: Mapping[str, float] | None = None
) -> Table:
    """Return one row per parameter, with value and 90 % interval by each method; columns without
    content are left out.

    The column ``floor`` is the least half width of the interval by the Cramer-Rao bound.

    Args:
        results: One per method; the first names the rows.
        truth: True values of a simulated bench, if known; adds the columns ``true`` and ``error``.
    """
    header = ["parameter"]
    for result in results:
        prefix = "" if len(results) == 1 else f"{result.method}: "
        header += [
            f"{prefix}value",
            f"{prefix}90 % interval",
            f"{prefix}floor",
            *([f"{prefix}error"] if truth else []),
        ]
    header += ["unit", *(["true"] if truth else []), "note"]
    names = dict.fromkeys(name for result in results for name in result.parameters)
    rows = [_row(name, results, truth) for name in names]
    kept = [i for i in range(len(header)) if any(row[i] not in ("", "-") for row in rows)]
    numbers = [k for k, i in enumerate(kept) if header[i] not in ("parameter", "unit", "note")]
    return Table(
        tuple(header[i] for i in kept),
        tuple(tuple(row[i] for i in kept) for row in rows),
        tuple(numbers),
    )


def parameter_notes(results: Sequence[Identification]) -> list[str]:
    """Return the reasons for the remarks in :func:`parameter_table`, one line per parameter."""
    return [
        f"{r.method}: {p.name}: {p.reason}"
        for r in results
        for p in r.parameters.values()
        if p.reason
    ]


def pinned_notes(results: Sequence[Identification]) -> list[str]:
    """Return for each method with intervals the number of determined parameters, and the least
    accurate parameter.
    """
    lines = []
    for result in results:
        widths = {
            n: 0.5 * (p.high - p.low) / abs(p.value)
            for n, p in result.parameters.items()
            if p.value and p.low is not None and p.high is not None and p.high > p.low
        }
        if widths:
            weakest = max(widths, key=lambda n: widths[n])
            count = f"{len(widths)} of {len(result.parameters)} parameters"
            lines.append(
                f"{result.method}: determines {count}; the weakest is {weakest}, to "
                f"{percent(100.0 * widths[weakest])}"
            )
    return lines


def note(parameter: Parameter) -> str:
    """Return a remark on an estimate in addition to its numbers."""
    if not parameter.identifiable:
        return "not identifiable"
    return "at the bound of the search" if parameter.at_bound else ""


def _floor(parameter: Parameter) -> str:
    return "-" if parameter.floor is None else f"+-{number(parameter.floor, 2)}"


def _error(value: float | None, true: float | None) -> str:
    return percent(None if value is None or not true else 100.0 * (value / true - 1.0))


def _row(
    name: str, results: Sequence[Identification], truth: Mapping[str, float] | None
) -> tuple[str, ...]:
    cells = [name]
    notes: list[str] = []
    unit = ""
    true = (truth or {}).get(name)
    for result in results:
        parameter = result.parameters.get(name)
        if parameter is None:
            cells += ["-"] * (4 if truth else 3)
            continue
        unit = parameter.unit
        cells += [
            number(parameter.value),
            interval(parameter.low, parameter.high),
            _floor(parameter),
        ]
        if truth:
            cells.append(_error(parameter.value, true))
        if said := note(parameter):
            notes.append(said if len(results) == 1 else f"{result.method}: {said}")
    return (*cells, unit, *([number(true)] if truth else []), "; ".join(notes))


_WORDS = {
    "torque_constant": "torque constant (and back-EMF constant)",
    "resistance": "resistance",
    PER_VOLT: "torque per volt at rest",
}


def simulated_table(rungs: Sequence[SimulatedRung], motion: str) -> Table:
    """Return one row for each fit: errors of the simulated angle, and the change of each
    constant.
    """
    small, scale = ("um", 1e6) if motion == LINEAR else ("mrad", 1e3)
    names = [c.name for c in next((r.constants for r in rungs if r.constants), ())]
    header = (
        "friction",
        "terms",
        "motor constants",
        f"fit, MAE ({small})",
        "90 %",
        "cross-validated",
        "validate",
        "90 %",
        "best in",
        *names,
        "by cross-validation",
    )
    rows = [
        (
            rung.friction,
            ", ".join(SIMULATED[rung.friction]),
            "free" if rung.free else "declared",
            *_cells(rung.train, scale),
            "-" if math.isnan(rung.crossed) else number(scale * rung.crossed, 3),
            *_cells(rung.scored, scale),
            f"{100.0 * rung.best:.3g} %",
            *(_changes(rung.constants, names)),
            "least" if rung.chosen else "tied" if rung.tied else "",
        )
        for rung in rungs
    ]
    numbers = (3, 5, 6, 8, *range(9, 9 + len(names)))
    return Table(header, tuple(rows), numbers)


def simulated_notes(rungs: Sequence[SimulatedRung]) -> list[str]:
    """Return explanations of the table, and the change of each constant in the fits that
    cross-validation does not reject.
    """
    longest = max(rung.horizon_s for rung in rungs)
    lines = [
        f"Fitted to the simulated angle over up to {number(longest, 3)} s from a measured state; "
        f"MAE: mean absolute error of that angle. Cross-validated: error on each third of the "
        f"recordings, predicted by a fit to the other two thirds; tied: not distinguished from "
        f"the least cross-validated error.",
    ]
    for rung in rungs:
        if rung.tied and rung.constants:
            lines += [_constant_line(c, rung.friction) for c in rung.constants]
    return lines


def _constant_line(c: Constant, friction: str) -> str:
    prior = "" if c.prior is None else f", prior +- {100.0 * c.prior:.3g} %"
    return (
        f"{friction}: {_WORDS[c.name]} {number(c.declared, 4)} declared{prior}; "
        f"{number(c.value, 4)} {interval(c.low, c.high)} {c.unit} found, "
        f"{100.0 * c.change:+.1f} %: {CHANGED if c.moved else NO_CHANGE}"
    )


def _changes(found: Sequence[Constant], names: Sequence[str]) -> list[str]:
    by_name = {c.name: c for c in found}
    return [
        "-"
        if n not in by_name
        else f"{100.0 * by_name[n].change:+.1f} %{f' {CHANGED}' if by_name[n].moved else ''}"
        for n in names
    ]


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
    drawn = fit_plots.result(first, _moments(recordings), recordings)
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
