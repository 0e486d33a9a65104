"""Output of ``rig identify`` as a document, for one or several methods."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from identification.estimate.ladder import Rung, Transfer
from identification.estimate.paper_method import Contender
from identification.estimate.simulated_ladder import PER_VOLT, Constant, SimulatedRung
from identification.model.parameters import LADDER, LINEAR, SIMULATED
from identification.plots import fit as fit_plots
from identification.plots import signals
from identification.result import (
    HEADLINES,
    Convergence,
    Identification,
    KnownConstant,
    Parameter,
    Profile,
)
from rig.common.places import source_name
from rig.common.provenance import RESULT_FILE
from rig.common.tables import CHANGED, NO_CHANGE, interval, number, percent
from rig.results.document import (
    PAGE_FILE,
    Document,
    Note,
    Picture,
    Section,
    Table,
    Verdict,
    columns,
    few_of_each_role,
    provenance_section,
    reading_notes,
    write_page,
    write_record,
)
from rig.results.identify.identify import Outcome, outcome_record
from rig.results.measured import facts_of

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
_MOVED = 4  # largest number of parameters in a row of the table of constants


def uncertainty_notes(result: Identification) -> list[str]:
    """Return lines on trade-offs, active bounds, and starts that reached the best optimum."""
    lines = [pair.statement for pair in result.tradeoffs]
    if result.least_pinned:
        lines.append(result.least_pinned)
    hit = [p.name for p in result.parameters.values() if p.at_bound]
    ends = ", ".join(hit) or "none"
    lines.append(f"parameters at an end of the range in which they are sought: {ends}")
    if noise := result.noise:
        torque = f"torque {number(noise.torque, 3)} {noise.unit} rms, new in each sample"
        if noise.correlated:
            over = f"which persists for {number(1e3 * noise.correlation_s, 2)} ms"
            torque += f", and {number(noise.correlated, 3)} {noise.unit} rms, {over}"
        factor, unit = (1e6, "um") if result.motion == LINEAR else (math.degrees(1.0), "deg")
        step, beyond = (number(factor * x, 3) for x in (noise.encoder_step_rad, noise.angle_rad))
        angle = f"encoder step {step} {unit}, and {beyond} {unit} rms beside it"
        lines.append(f"noise of the recordings: {torque}; {angle}")
    lines += [
        f"{s.best} of {len(s.ends)} searches of the {s.stage} parameters, each from other start "
        f"values, ended {'at a solution' if s.absolute else 'at the best fit'}"
        for s in result.starts
    ]
    return [f"{result.method}: {line}" for line in lines]


def profile_table(result: Identification) -> Table:
    """Return one row for each profile: the 90 % range of the profile and the interval."""

    def skew(curve: Profile) -> float | None:
        if curve.low is None or curve.high is None:
            return None
        here = result.fitted[curve.name]
        return (curve.high - here) / (here - curve.low)

    def ends(curve: Profile) -> str:
        """Return the range of a profile as text; an end beyond the scanned values is open."""
        if skew(curve) is not None:
            return interval(curve.low, curve.high)
        low = f"< {curve.values[0]:.4g}" if curve.low is None else f"{curve.low:.4g}"
        high = f"> {curve.values[-1]:.4g}" if curve.high is None else f"{curve.high:.4g}"
        return f"[{low}, {high}]"

    known = result.parameters
    return columns(
        result.profiles,
        (1, 2, 3, 4),
        ("parameter", lambda c: c.name),
        ("90 % interval", lambda c: interval(known[c.name].low, known[c.name].high)),
        ("profile", ends),
        ("skew", lambda c: number(skew(c), 3)),
        ("scaled", lambda c: number(c.scale, 3)),
        ("unit", lambda c: c.unit),
    )


def uncertainty_tables(result: Identification) -> list[tuple[Table, str]]:
    """Return the requested tables, each with its note."""
    made = (
        (result.priors, _priors_table, PRIORS_NOTE),
        (result.known_constants, _constants_table, CONSTANTS_NOTE),
        (result.profiles, profile_table, PROFILE_NOTE),
        (result.resampled, bootstrap_table, BOOTSTRAP_NOTE),
    )
    return [(table(result), note) for given, table, note in made if given]


def _priors_table(result: Identification) -> Table:
    return columns(
        result.priors,
        (1, 2, 3),
        ("parameter", lambda p: p.name),
        ("prior", lambda p: f"{number(p.value)} +- {number(p.uncertainty, 2)}"),
        ("recordings alone", lambda p: f"{number(p.alone)} +- {number(p.alone_uncertainty, 2)}"),
        ("both", lambda p: f"{number(p.posterior)} +- {number(p.posterior_uncertainty, 2)}"),
        ("unit", lambda p: result.parameters[p.name].unit),
    )


def _constants_table(result: Identification) -> Table:
    """Return value, uncertainty and most changed parameters of each constant."""

    def most(constant: KnownConstant) -> str:
        known = {name: result.parameters[name].value for name in constant.shifts}
        shares = {name: constant.shifts[name] / value for name, value in known.items() if value}
        moved = sorted(shares, key=lambda name: -abs(shares[name]))[:_MOVED]
        return ", ".join(f"{name} {100.0 * shares[name]:+.3g} %" for name in moved) or "nothing"

    return columns(
        result.known_constants,
        (1, 2),
        ("constant", lambda c: c.place),
        ("value", lambda c: number(c.value)),
        ("uncertainty", lambda c: f"+- {number(c.uncertainty, 3)}"),
        ("changed most by one uncertainty", most),
    )


def bootstrap_table(result: Identification) -> Table:
    """Return one row for each parameter: the spread of the bootstrap estimates and the interval."""
    known = result.parameters
    return columns(
        result.resampled,
        (1, 2, 3),
        ("parameter", lambda r: r.name),
        ("90 % interval", lambda r: interval(known[r.name].low, known[r.name].high)),
        ("bootstrap", lambda r: interval(r.low, r.high)),
        ("draws solved", lambda r: f"{r.solved} of {r.draws}"),
        ("unit", lambda r: r.unit),
    )


COMPARISON_NOTE = (
    "All searches minimise the paper's equation error, stage by stage, within common bounds; the "
    "default method then minimises the prediction errors. Failed: searches that ended more than "
    "0.1 % above the least cost found. Errors: of the worst parameter, in the median run."
)


def _fit_tables(results: Sequence[Identification]) -> tuple[Table, Table]:
    """Return the errors over each role, and over each recording."""
    of_roles: list[tuple[Any, ...]] = []
    of_recordings: list[tuple[Any, ...]] = []
    for r in results:
        fit, roles = r.fit, {trace.recording: trace.role for trace in r.traces}
        of_roles.append((r.method, "all", "fit", fit, fit.train_rms, fit.train_relative))
        if fit.validate_rms is not None:
            validated = fit.validate_rms, fit.validate_relative
            of_roles.append((r.method, "all", "validate", fit, *validated))
        of_recordings += [
            (r.method, name, roles[name], own, own.train_rms, own.train_relative)
            for name, own in r.fits_by_recording.items()
        ]

    def table(title: str, rows: Sequence[tuple[Any, ...]]) -> Table:
        return columns(
            rows,
            (3, 4, 5),
            ("method", lambda row: row[0]),
            (title, lambda row: row[1]),
            ("role", lambda row: row[2]),
            ("bandwidth", lambda row: f"{number(row[3].bandwidth_Hz, 4)} Hz"),
            ("error, rms", lambda r: "-" if r[4] is None else f"{number(r[4], 4)} {r[3].unit}"),
            ("relative", lambda row: percent(None if row[5] is None else 100.0 * row[5])),
        )

    return table("recordings", of_roles), table("recording", of_recordings)


def _stage_table(results: Sequence[Identification]) -> Table:

    def target(row: tuple[str, Convergence]) -> str:
        stage = row[1]
        return "-" if stage.target is None else f"{number(stage.target)} {stage.cost_unit}"

    return columns(
        [(result.method, stage) for result in results for stage in result.stages],
        (3, 4, 5, 6),
        ("method", lambda s: s[0]),
        ("stage", lambda s: s[1].stage),
        ("optimiser", lambda s: s[1].method),
        ("evaluations", lambda s: str(s[1].evaluations)),
        ("generations", lambda s: str(s[1].generations)),
        ("cost", lambda s: f"{number(s[1].cost, 4)} {s[1].cost_unit}"),
        ("target", target),
        ("reached", lambda s: {None: "-", True: "yes", False: "no"}[s[1].reached]),
    )


def _comparison_table(contenders: Sequence[Contender]) -> Table:
    """Return one row for each estimator; the true error only if it is known."""

    def worst(error: float | None, name: str) -> str:
        return "-" if error is None else f"{percent(100.0 * error)} ({name})"

    def against_default(c: Contender) -> str:
        return "reference" if c.excess is None else worst(c.error, c.worst)

    true = ("error against truth", lambda c: worst(c.true_error, c.true_worst))
    return columns(
        contenders,
        (1, 2, 3, 4, 5),
        ("estimator", lambda c: c.name),
        ("runs", lambda c: str(c.runs)),
        ("failed", lambda c: str(c.failures)),
        ("evaluations", lambda c: str(c.evaluations)),
        ("s", lambda c: number(c.seconds, 2)),
        ("cost above least", lambda c: "-" if c.excess is None else percent(100.0 * c.excess)),
        ("error against default", against_default),
        *([true] if any(c.true_error is not None for c in contenders) else []),
    )


def _ladder_table(rungs: Sequence[Rung]) -> Table:
    first = rungs[0].result
    unit, small = first.fit.unit, "mrad" if first.motion == "rotary" else "um"
    scale = 1e3 if first.motion == "rotary" else 1e6

    def of_angle(rung: Rung, measure: str) -> str:
        return "-" if rung.angle is None else number(scale * getattr(rung.angle, measure), 3)

    return columns(
        rungs,
        (2, 3, 4, 5),
        ("friction", lambda r: r.friction),
        ("terms", lambda r: ", ".join(LADDER[r.friction])),
        (f"fit ({unit})", lambda r: number(r.result.fit.train_rms, 3)),
        (f"validate ({unit})", lambda r: number(r.result.fit.validate_rms, 3)),
        (f"angle ({small})", partial(of_angle, measure="angle_rms")),
        (f"angle, MAE ({small})", partial(of_angle, measure="angle_mae")),
    )


def _ladder_notes(rungs: Sequence[Rung]) -> list[str]:
    first = rungs[0]
    fit = first.result.fit
    where = "the recordings set aside" if fit.validate_rms is not None else "the recordings fitted"
    lines = [f"Torque errors are at {number(fit.bandwidth_Hz, 3)} Hz."]
    if first.angle is not None:
        lines.append(
            f"Angle: rms and mean absolute error of the closed loop simulated from its command and "
            f"first sample, on {where}."
        )
    return lines


def _transfer_table(found: Transfer) -> Table:
    findings = {None: "not identifiable on both", False: NO_CHANGE, True: CHANGED}
    return columns(
        found.parameters,
        (1, 2, 3, 4),
        ("parameter", lambda m: m.name),
        ("here", lambda m: number(m.first.value)),
        ("there", lambda m: number(m.second.value)),
        ("difference", lambda m: number(m.difference, 3)),
        ("90 %", lambda m: "-" if m.joint is None else f"+- {number(m.joint, 3)}"),
        ("unit", lambda m: m.unit),
        ("finding", lambda m: findings[m.moved]),
    )


def _transfer_notes(found: Transfer) -> list[str]:
    fit, own = found.fit, found.own
    line = (
        "on the other source, the error of the model with the parameters of this source is "
        f"{number(fit.train_rms, 3)} {fit.unit} rms ({percent(100.0 * fit.train_relative)}) at "
        f"{number(fit.bandwidth_Hz, 3)} Hz; with parameters identified on the other source it is "
        f"{number(own.train_rms, 3)} {own.unit}"
    )
    said = (
        "the noise floor of the other source is unknown: no motion is repeated under the same "
        "command"
    )
    if (floor := found.floor) is not None:
        counts = ((floor.periods, "periodic"), (floor.repeats, "repeated"))
        ways = " and ".join(f"{count} {what}" for count, what in counts if count)
        said = (
            f"the noise floor of the other source is {number(floor.rms, 3)} {fit.unit}, from "
            f"{floor.samples} pairs of samples of {ways} recordings: the error is "
            f"{number(fit.train_rms / floor.rms, 3)} times this floor"
        )
    return [line, said]


def parameter_table(
    results: Sequence[Identification], truth: Mapping[str, float] | None = None
) -> Table:
    """Return one row per parameter, with value and 90 % interval by each method; columns without
    content are left out.

    The column ``floor`` is the least half width of the interval by the Cramer-Rao bound.
    """
    true = truth or {}
    prefix = {r.method: f"{r.method}: " if len(results) > 1 else "" for r in results}

    def cell(result: Identification, words: Callable[[Parameter], str]) -> Callable[[str], str]:
        known = result.parameters
        return lambda name: words(known[name]) if name in known else "-"

    def floor(parameter: Parameter) -> str:
        return "-" if parameter.floor is None else f"+-{number(parameter.floor, 2)}"

    def error(parameter: Parameter) -> str:
        value, exact = parameter.value, true.get(parameter.name)
        return percent(100.0 * (value / exact - 1.0) if value is not None and exact else None)

    def unit(name: str) -> str:
        return [r.parameters[name].unit for r in results if name in r.parameters][-1]

    def remarks(name: str) -> str:
        said = [
            (prefix[r.method], note(r.parameters[name])) for r in results if name in r.parameters
        ]
        return "; ".join(f"{method}{words}" for method, words in said if words)

    titled: list[tuple[str, Callable[[str], str]]] = [("parameter", str)]
    for r in results:
        titled += [
            (f"{prefix[r.method]}value", cell(r, lambda p: number(p.value))),
            (f"{prefix[r.method]}90 % interval", cell(r, lambda p: interval(p.low, p.high))),
            (f"{prefix[r.method]}floor", cell(r, floor)),
            (f"{prefix[r.method]}error", cell(r, error)),
        ]
    titled += [("unit", unit), ("true", lambda name: number(true.get(name))), ("note", remarks)]
    whole = columns(dict.fromkeys(name for r in results for name in r.parameters), (), *titled)
    kept = [k for k, cells in enumerate(zip(*whole.rows, strict=True)) if set(cells) - {"", "-"}]
    texts = ("parameter", "unit", "note")
    numbers = (n for n, k in enumerate(kept) if whole.header[k] not in texts)
    header, *rows = (tuple(row[k] for k in kept) for row in (whole.header, *whole.rows))
    return Table(header, tuple(rows), tuple(numbers))


def parameter_notes(results: Sequence[Identification]) -> list[str]:
    """Return the reasons for the remarks in :func:`parameter_table`, one line per parameter."""
    return [
        f"{r.method}: {p.name}: {p.reason}"
        for r in results
        for p in r.parameters.values()
        if p.reason
    ]


def determined_notes(results: Sequence[Identification]) -> list[str]:
    """Return how many parameters the printed intervals determine, and the least accurate."""
    lines = []
    for result in (r for r in results if r.intervals):
        known = sum(p.determined for p in result.parameters.values())
        line = f"{result.method}: {known} of {len(result.parameters)} parameters are determined"
        widths = {
            n: 0.5 * (high - low) / abs(p.value)
            for n, (low, high) in result.intervals.items()
            if (p := result.parameters[n]).determined and p.value and high > low
        }
        if widths:
            weakest = max(widths, key=lambda n: widths[n])
            line += f"; the least accurate is {weakest}, to +-{percent(100.0 * widths[weakest])}"
        lines.append(line)
    return lines


def note(parameter: Parameter) -> str:
    """Return a remark on an estimate in addition to its numbers."""
    if not parameter.identifiable:
        return "not identifiable"
    if parameter.at_bound:
        return "at the end of the range of the search"
    unknown = parameter.low is not None and not parameter.determined
    return "not determined: the interval is too wide" if unknown else ""


_WORDS = {
    "torque_constant": "torque constant (and back-EMF constant)",
    "resistance": "resistance",
    PER_VOLT: "torque per volt at rest",
}


def _simulated_table(rungs: Sequence[SimulatedRung], motion: str) -> Table:
    """Return the errors of the simulated angle, and the change of each constant."""
    small, scale = ("um", 1e6) if motion == LINEAR else ("mrad", 1e3)
    names = [c.name for c in next((r.constants for r in rungs if r.constants), ())]

    def crossed(rung: SimulatedRung) -> str:
        return "-" if math.isnan(rung.crossed) else number(scale * rung.crossed, 3)

    return columns(
        rungs,
        (3, 4, 5, *range(6, 6 + len(names))),
        ("friction", lambda r: r.friction),
        ("terms", lambda r: ", ".join(SIMULATED[r.friction])),
        ("motor constants", lambda r: "free" if r.free else "declared"),
        (f"fit, MAE ({small})", lambda r: number(scale * r.train, 3)),
        ("cross-validated", crossed),
        ("validate", lambda r: "-" if r.scored is None else number(scale * r.scored, 3)),
        *((name, partial(_change, name=name)) for name in names),
        ("by cross-validation", lambda r: "least" if r.chosen else "tied" if r.tied else ""),
    )


def _simulated_notes(rungs: Sequence[SimulatedRung]) -> list[str]:
    def line(c: Constant, friction: str) -> str:
        prior = "" if c.prior is None else f", prior +- {100.0 * c.prior:.3g} %"
        return (
            f"{friction}: {_WORDS[c.name]} {number(c.declared, 4)} declared{prior}; "
            f"{number(c.value, 4)} {interval(c.low, c.high)} {c.unit} found, "
            f"{100.0 * c.change:+.1f} %: {CHANGED if c.moved else NO_CHANGE}"
        )

    longest = max(rung.horizon_s for rung in rungs)
    return [
        f"Fitted to the simulated angle over up to {number(longest, 3)} s from a measured state; "
        f"MAE: mean absolute error of that angle. Cross-validated: error on each third of the "
        f"recordings, predicted by a fit to the other two thirds; tied: not distinguished from "
        f"the least cross-validated error.",
        *(line(c, rung.friction) for rung in rungs if rung.tied for c in rung.constants),
    ]


def _change(rung: SimulatedRung, name: str) -> str:
    found = next((c for c in rung.constants if c.name == name), None)
    if found is None:
        return "-"
    return f"{100.0 * found.change:+.1f} %{f' {CHANGED}' if found.moved else ''}"


_SHOWN_PER_ROLE = 6
_TRUTH = (
    'The column "true" has the parameters of the simulated bench, which are read from its file '
    "after the fit, for this table only."
)


def identify_document(
    name: str,
    outcome: Outcome,
    truth: Mapping[str, float] | None = None,
    facts: tuple[tuple[str, str], ...] = (),
) -> Document:
    """Return an identification as a document."""
    results = outcome.results
    return Document(
        f"Identification of {name}",
        f"Identification by the {' and the '.join(r.method for r in results)} method",
        tuple(_summary(outcome, truth)),
        tuple(_sections(outcome, truth)),
        facts,
    )


def write_identification(
    source: Path,
    outcome: Outcome,
    truth: Mapping[str, float] | None,
    folder: Path,
    json_file: Path | None = None,
) -> tuple[dict[str, Any], Document]:
    """Write result file and page of an identification into a folder; return record and document."""
    record = outcome_record(outcome)
    write_record(record, folder / RESULT_FILE, json_file)
    document = identify_document(source_name(source), outcome, truth, facts_of(source))
    write_page(document, folder / PAGE_FILE)
    return record, document


def _summary(outcome: Outcome, truth: Mapping[str, float] | None) -> Iterator[Section]:
    results = outcome.results
    if verdicts := _misfits(results):
        yield Section("", verdicts)
    yield Section("", (parameter_table(results, truth),))
    lines = [*map(_fit_line, results), *determined_notes(results)]
    lines += [line for result in results for line in uncertainty_notes(result)]
    yield Section("", tuple(map(Note, lines)))
    for cells, line in (each for result in results for each in uncertainty_tables(result)):
        yield Section("", (cells, Note(line)))
    if outcome.comparison:
        yield Section("", (_comparison_table(outcome.comparison), Note(COMPARISON_NOTE)))
    yield from _extras(outcome, "plain")
    last = (
        *map(Note, reading_notes(outcome.dataset.recordings)),
        *(Note(line, "aside") for line in parameter_notes(results)),
        *_warnings(results),
    )
    if last:
        yield Section("", last)


def _sections(outcome: Outcome, truth: Mapping[str, float] | None) -> Iterator[Section]:
    results, recordings = outcome.results, outcome.dataset.recordings
    moments = {
        r.name: None if r.hot_fire else r.contact_force * (r.bench.moment_arm or 0.0)
        for r in recordings
    }
    what = "friction against speed, measured (dots) and identified (black); below it the recordings"
    drawn = fit_plots.result(results[0], moments, recordings)
    lead = Picture.of("result", f"Result: {what}", drawn, lead=True)
    yield Section("", (*_misfits(results), lead))
    if warnings := _warnings(results):
        yield Section("Warnings", tuple(warnings))
    yield Section("Parameters", tuple(_parameters(results, truth)))
    yield Section("How sure", tuple(_how_sure(results)))
    if outcome.comparison:
        cells = _comparison_table(outcome.comparison)
        yield Section("Estimators side by side", (cells, Note(COMPARISON_NOTE, "aside")))
    curves = (
        Picture.of(
            f"stribeck_{result.method}",
            f"Friction against speed, measured and fitted by the {result.method} method",
            fit_plots.stribeck(result, moments),
        )
        for result in results
    )
    yield Section("Fit", (*_fit_tables(results), *curves))
    yield from _extras(outcome, "aside")
    convergence = (
        Picture.of(
            f"convergence_{result.method}_{stage.stage}",
            f"Convergence of the {stage.stage} stage, {result.method} method",
            fit_plots.convergence(stage, truth),
        )
        for result in results
        for stage in result.stages
        if stage.cost_history is not None and stage.parameter_history
    )
    yield Section("Stages and convergence", (_stage_table(results), *convergence))
    yield Section("Recordings", tuple(_recordings(outcome)))
    yield provenance_section(outcome.provenance)


def _misfits(results: Sequence[Identification]) -> tuple[Verdict, ...]:
    """Return the verdict on each model that does not describe the recordings."""
    return tuple(
        Verdict(
            HEADLINES[r.misfit[0]],
            f"{r.method}: {r.misfit_words}. `rig diagnose` seeks what is missing.",
            "open",
        )
        for r in results
        if r.misfit
    )


def _warnings(results: Sequence[Identification]) -> list[Note]:
    return [Note(f"{r.method}: {line}", "warning") for r in results for line in r.warnings]


def _extras(outcome: Outcome, tone: Literal["plain", "aside"]) -> Iterator[Section]:
    """Yield the optional parts of the result, each with explanatory lines."""

    def section(title: str, table: Table, lines: Iterable[str]) -> Section:
        return Section(title, (table, *(Note(line, tone) for line in lines)))

    if rungs := outcome.ladder:
        yield section("Ladder of friction models", _ladder_table(rungs), _ladder_notes(rungs))
    if simulated := outcome.simulated:
        table = _simulated_table(simulated, outcome.results[0].motion)
        title = "Friction models fitted to the simulated angle"
        yield section(title, table, _simulated_notes(simulated))
    if (found := outcome.transfer) is not None:
        yield section("Transfer", _transfer_table(found), _transfer_notes(found))


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
    if fit.noise_floor_rms is not None:
        line += f"; noise floor {number(fit.noise_floor_rms, 3)} {fit.unit}"
    return f"{line}; {result.evaluations} evaluations, {result.seconds:.1f} s"


def _parameters(
    results: Sequence[Identification], truth: Mapping[str, float] | None
) -> Iterator[Table | Note | Picture]:
    yield parameter_table(results, truth)
    for line in (*determined_notes(results), *parameter_notes(results)):
        yield Note(line, "aside")
    if truth is not None:
        yield Note(_TRUTH, "aside")
    yield Picture.of("intervals", "Parameters", fit_plots.intervals(results, truth))


def _how_sure(results: Sequence[Identification]) -> Iterator[Table | Note | Picture]:
    for line in (line for result in results for line in uncertainty_notes(result)):
        yield Note(line, "aside")
    for cells, line in (each for result in results for each in uncertainty_tables(result)):
        yield cells
        yield Note(line, "aside")
    for result in results:
        if result.profiles:
            made = fit_plots.profiles(result.profiles, list(result.parameters.values()))
            yield Picture.of(f"profiles_{result.method}", "Likelihood profiles", made)
        if several := [s for s in result.starts if len(s.ends) > 1]:
            made = fit_plots.waterfall(several)
            yield Picture.of(f"starts_{result.method}", "Where the starts ended", made)


def _recordings(outcome: Outcome) -> Iterator[Table | Note | Picture]:
    recordings = {r.name: r for r in outcome.dataset.recordings}
    yield columns(
        recordings.values(),
        (3, 4, 5),
        ("recording", lambda r: r.name),
        ("role", lambda r: r.role),
        ("stage", lambda r: r.stage),
        ("weight", lambda r: "gas generator" if r.hot_fire else f"{number(r.weight_mass)} kg"),
        ("samples", lambda r: str(len(r.time))),
        ("rate", lambda r: f"{number(1.0 / r.period, 4)} Hz"),
        ("corrections", lambda r: "; ".join(r.notes) or "none"),
    )
    first = outcome.results[0]
    shown = few_of_each_role(first.traces, lambda trace: trace.role, _SHOWN_PER_ROLE)
    if hidden := len(first.traces) - len(shown):
        yield Note(
            f"Figures of {hidden} more recordings are left out; their fits are in the table above.",
            "aside",
        )
    for trace in shown:
        name, recording = trace.recording, recordings[trace.recording]
        response = signals.response(trace, recording, first.torque_unit)
        yield Picture.of(f"response_{name}", f"{name}: response", response)
        residual = signals.residual(trace, recording.bench.motion, first.torque_unit)
        yield Picture.of(f"residual_{name}", f"{name}: residual of the model", residual)
