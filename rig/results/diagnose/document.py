"""Output of ``rig diagnose`` as a document."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from identification.diagnosis.result import Diagnosis, Fit, IdentifiedEffect, ResidualTrace
from identification.export.model import COORDINATES
from identification.plots import mismatch
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.exports import Exports
from rig.results.diagnose.tables import (
    effect_table,
    fit_table,
    rival_table,
    shift_table,
    step_table,
    where_table,
)
from rig.results.document import (
    Block,
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    Table,
    Verdict,
)
from rig.results.sections import few_of_each_role, provenance_section, reading_notes

_VERDICTS = {
    "nothing_missing": "nothing missing",
    "named": "named",
    "ambiguous": "ambiguous",
    "outside_catalogue": "outside the catalogue",
}
_HEADLINES = {
    "nothing_missing": "Nothing is missing",
    "named": "The missing physics is identified",
    "ambiguous": "These recordings cannot distinguish several effects",
    "outside_catalogue": "Something is missing that no effect of the catalogue explains",
}
_TONES: dict[str, Literal["good", "found", "open"]] = {
    "nothing_missing": "good",
    "named": "found",
    "ambiguous": "open",
    "outside_catalogue": "open",
}
_SHOWN_PER_ROLE = 4


def diagnose_document(
    name: str, outcome: Outcome, exports: Exports, facts: tuple[tuple[str, str], ...] = ()
) -> Document:
    """Return a diagnosis as a document.

    Args:
        name: Name of the source.
        outcome: The result.
        exports: The files next to the page.
        facts: Facts at the top of the page, such as bench, date and operator.
    """
    found = outcome.diagnosis
    return Document(
        f"Diagnosis of {name}",
        f"{len(outcome.dataset.recordings)} recordings; the test that anything is missing at all "
        f"has p = {found.p_value:.2g}",
        tuple(_summary(outcome)),
        tuple(_sections(outcome, exports)),
        facts,
    )


def _summary(outcome: Outcome) -> Iterator[Section]:
    found = outcome.diagnosis
    yield Section(f"verdict: {_VERDICTS[found.verdict.value]}", (Paragraph(found.statement),))
    for effect in found.effects:
        if effect.statement not in found.statement:
            yield Section("", (Paragraph(effect.statement, f"{effect.name}:"),))
    tables = (
        _effect_table(outcome),
        where_table(found),
        rival_table(found),
        fit_table(found),
        shift_table(found),
    )
    for table in tables:
        if shown := _if_any(table):
            yield Section("", shown)
    for effect in found.effects:
        if len(effect.alias_group) > 1:
            lead = f"to split {', '.join(effect.alias_group)}:"
            yield Section("", (Paragraph(effect.separating_experiment, lead),))
    notes = (*map(Note, reading_notes(outcome.dataset.recordings)), *_warnings(found))
    if notes:
        yield Section("", notes)


def _effect_table(outcome: Outcome) -> Table:
    return effect_table(outcome.diagnosis, outcome.dataset.recordings[0].bench.motion)


def _sections(outcome: Outcome, exports: Exports) -> Iterator[Section]:
    found = outcome.diagnosis
    verdict = found.verdict.value
    yield Section(
        "",
        (
            Verdict(_HEADLINES[verdict], found.statement, _TONES[verdict]),
            *_errors(found),
            *_warnings(found),
        ),
    )
    if found.effects:
        effects = (_effect(effect, found) for effect in found.effects)
        yield Section("Identified effects", (_effect_table(outcome), *effects))
    yield Section("Error before and after", (fit_table(found),))
    yield Section(
        "Location of the mismatch", (*_if_any(where_table(found)), *_curve(found), *_maps(found))
    )
    if rivals := _if_any(rival_table(found)):
        yield Section("Rivals", (*rivals, *_rivals(found)))
    if shifts := _if_any(shift_table(found)):
        note = Note("Nominal parameters fitted without and with the correction.", "aside")
        yield Section("Change of the nominal parameters", (note, *shifts))
    if steps := _if_any(step_table(found)):
        yield Section("Steps of the search", steps)
    yield Section("Recordings", tuple(_recordings(found)))
    if exports.files:
        files = tuple((file.name, file.use) for file in exports.files)
        yield Section("Beside this page", (Items(files),))
    if exports.notes:
        yield Section("", tuple(Note(line, "aside") for line in exports.notes))
    yield provenance_section(outcome.provenance)


def _if_any(cells: Table) -> tuple[Table, ...]:
    """Return a tuple with the table, or an empty tuple if the table has no rows."""
    return (cells,) if cells.rows else ()


def _warnings(found: Diagnosis) -> list[Note]:
    return [Note(line, "warning") for line in found.warnings]


def _effect(effect: IdentifiedEffect, found: Diagnosis) -> Section:
    """Return the text on one effect that accompanies the table."""
    blocks: list[Block] = []
    others = [name for name in effect.alias_group if name != effect.name]
    if effect.statement not in found.statement:
        blocks.append(Paragraph(effect.statement))
    if others:
        blocks.append(
            Paragraph(
                f"These recordings cannot distinguish {effect.name} from {', '.join(others)}."
            )
        )
    if effect.separating_experiment:
        lead = "To distinguish them:" if others else "To confirm it:"
        blocks.append(Paragraph(effect.separating_experiment, lead))
    return Section(effect.name, tuple(blocks))


def _recordings(found: Diagnosis) -> Iterator[Note | Picture]:
    mismatched = [t for t in found.traces if t.equation == found.fit.equation]
    order = ("validate", "fit")
    shown = few_of_each_role(mismatched, lambda t: t.role, _SHOWN_PER_ROLE, order)
    if hidden := len(mismatched) - len(shown):
        yield Note(f"Figures of {hidden} more recordings are left out.", "aside")
    for trace in shown:
        yield _trace(trace, found)


def _errors(found: Diagnosis) -> list[Picture]:
    if not any(fit.noise_floor_rms > 0.0 for fit in found.fits):
        return []
    caption = (
        "Error of each equation over its noise floor, before and after the correction; fitted "
        "recordings, and recordings that were set aside"
    )
    return [Picture.of("errors", caption, mismatch.errors(found.fits), lead=True)]


def _maps(found: Diagnosis) -> list[Picture]:
    equations = dict.fromkeys(m.equation for m in found.maps)
    return [
        Picture.of(
            f"maps_{equation}",
            f"Mismatch of the {equation} equation against each coordinate, largest share first, "
            f"with simultaneous 90 % "
            "bands, before and after the correction",
            mismatch.maps([m for m in found.maps if m.equation == equation]),
        )
        for equation in equations
    ]


def _rivals(found: Diagnosis) -> list[Picture]:
    return [
        Picture.of(
            f"rivals_{e.name}",
            f"{e.name} and the effects that were considered instead",
            mismatch.rivals(e),
        )
        for e in found.effects
        if e.rivals
    ]


def _curve(found: Diagnosis) -> list[Picture]:
    if found.curve is None:
        return []
    caption = f"The missing physics as a smooth curve over {found.curve.coordinate}"
    if found.curve.coordinate in COORDINATES:
        caption += "; a simulation can use this curve"
    return [Picture.of("missing", caption, mismatch.curve(found.curve))]


def _trace(trace: ResidualTrace, found: Diagnosis) -> Picture:
    fits: dict[str, Fit] = {fit.equation: fit for fit in (*found.fits, found.fit)}
    fit = fits.get(trace.equation)
    role = "set aside" if trace.role == "validate" else "fitted"
    return Picture.of(
        f"mismatch_{trace.equation}_{trace.recording}",
        f"{trace.recording} ({role}): mismatch of the {trace.equation} equation before and after",
        mismatch.trace(trace, None if fit is None else fit.noise_floor_rms),
    )
