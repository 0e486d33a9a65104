"""The result of an investigation: JSON record, and document for terminal and page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Literal

from identification.diagnosis.result import Verdict as Outcomes
from identification.plots import mismatch as plots
from rig.common.tables import number, percent
from rig.investigate.choice import spoken
from rig.investigate.confirmation import BAND, Confirmation
from rig.investigate.investigation import Judgement, State
from rig.results.diagnose.model_file import INVESTIGATE_SCHEMA
from rig.results.document import (
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    Table,
    Verdict,
    provenance_section,
)

PAGE_FILE = "investigation.html"
RESULT_FILE = "investigate.json"
_KEYS = (
    "run",
    "sequence",
    "reason",
    "seconds",
    "weight_changes",
    "state",
    "purpose",
    "odds",
    "verdict",
)
_CONFIRMED = ("predicted_sha256", "band_held", "error_rms", "floor_rms")


def investigation_record(state: State, judged: Judgement) -> dict[str, Any]:
    """Return the record of ``rig investigate --json``: that of ``rig diagnose`` on all recordings
    but the confirming ones, and the experiments.
    """
    refuted, confirmed = (
        [{k: found.get(k) for k in _CONFIRMED} for found in every if found]
        for every in (state.refuted, [state.confirmation])
    )
    return {
        **judged.outcome.record(),
        "schema": INVESTIGATE_SCHEMA,
        "odds": judged.weighed.odds,
        "ended": state.ended,
        "experiments": [{k: asdict(e)[k] for k in _KEYS} for e in state.experiments],
        "bench_seconds": state.bench_seconds,
        "confirmation": confirmed[0] if confirmed else None,
        "refuted": refuted,
        "cannot_separate": state.cannot_separate,
    }


def investigation_document(
    name: str,
    state: State,
    judged: Judgement,
    confirmation: Confirmation | None,
    files: tuple[tuple[str, str], ...],
    facts: tuple[tuple[str, str], ...] = (),
) -> Document:
    """Return an investigation as a document.

    Args:
        name: Name of the investigation.
        state: Its state at the end.
        judged: Diagnosis of all recordings but the confirming ones.
        confirmation: Outcome of the prediction sealed before its experiment, or None.
        files: Name and use of each file beside the page.
        facts: Facts at the top of the page.
    """
    minutes = f"{len(state.experiments)} experiments, {state.bench_seconds / 60.0:.1f} min"
    return Document(
        f"Investigation: {name}",
        f"{minutes} of the bench; {state.ended}",
        tuple(_summary(state, judged, confirmation)),
        tuple(_sections(state, judged, confirmation, files)),
        facts,
    )


def _summary(
    state: State, judged: Judgement, confirmation: Confirmation | None
) -> Iterator[Section]:
    head = f"verdict: {judged.diagnosis.verdict.value.replace('_', ' ')}"
    yield Section(head, (Paragraph(judged.diagnosis.statement),))
    yield Section("", (_experiments(state),))
    yield Section("", (_odds(judged),))
    lines = [f"ended: {state.ended}; {state.bench_seconds / 60.0:.1f} min of the bench"]
    lines += [
        f"a sealed band held {r['band_held']:.0%} only: its recording is evidence since"
        for r in state.refuted
    ]
    if confirmation is not None:
        lines.append(_confirmed(confirmation))
    lines += [f"cannot separate {_apart(p)}" for p in state.cannot_separate]
    yield Section("", tuple(map(Note, lines)))


def _sections(
    state: State,
    judged: Judgement,
    confirmation: Confirmation | None,
    files: tuple[tuple[str, str], ...],
) -> Iterator[Section]:
    verdict = judged.diagnosis.verdict
    tone: Literal["good", "found", "open"]
    tone = "good" if verdict is Outcomes.NOTHING_MISSING else "found"
    open_end = verdict in (Outcomes.AMBIGUOUS, Outcomes.OUTSIDE_CATALOGUE)
    headline = verdict.value.replace("_", " ").capitalize()
    shown = Verdict(headline, judged.diagnosis.statement, "open" if open_end else tone)
    drawn = [e for e in state.experiments if e.odds]
    caption = "Probability of each hypothesis after each experiment"
    figure = plots.odds(
        [e.run.partition("-")[0] for e in drawn],
        [{spoken(n): p for n, p in e.odds.items()} for e in drawn],
    )
    yield Section("", (shown, Picture.of("odds", caption, figure)))
    yield Section("Experiments", (_experiments(state), *_reasons(state)))
    yield Section("Odds", (_odds(judged),))
    if confirmation is not None:
        unit = judged.found.baseline.unit
        caption = "Torque predicted before the confirming experiment, and measured in steady motion"
        picture = Picture.of("sealed", caption, plots.sealed(confirmation.traces, unit))
        digest = Note(f"SHA-256 of the prediction: {state.confirmation['predicted_sha256']}")
        yield Section("Sealed prediction", (Paragraph(_confirmed(confirmation)), digest, picture))
    if state.cannot_separate:
        lines = tuple(Paragraph(_apart(p)) for p in state.cannot_separate)
        yield Section("Not separated on this bench", lines)
    yield Section("Beside this page", (Items(files),))
    yield provenance_section(judged.outcome.provenance)


def _experiments(state: State) -> Table:
    rows = tuple(
        (
            e.run,
            e.state,
            f"{e.seconds / 60.0:.1f}",
            str(e.weight_changes),
            e.verdict.replace("_", " "),
            _first(e.odds),
        )
        for e in state.experiments
    )
    header = ("experiment", "state", "min", "weights", "verdict after it", "most likely")
    return Table(header, rows, (2, 3))


def _first(odds: dict[str, float]) -> str:
    return next((f"{spoken(n)} {p:.0%}" for n, p in odds.items()), "")


def _reasons(state: State) -> Iterator[Paragraph]:
    for e in state.experiments:
        yield Paragraph(e.reason, f"{e.run}:")


def _odds(judged: Judgement) -> Table:
    preferred = {h.name: h.preference for h in judged.weighed.hypotheses}
    rows = tuple(
        (spoken(n), "< 0.01 %" if p < 1e-4 else percent(100.0 * p), number(preferred.get(n), 3))
        for n, p in judged.weighed.odds.items()
    )
    return Table(("hypothesis", "probability", "rejected by, sigma"), rows, (1, 2))


def _confirmed(found: Confirmation) -> str:
    return (
        f"The sealed {BAND:.0%} band held {found.band_held:.0%} of the {found.samples} samples in "
        f"which the joint moved steadily, of {found.predicted} predicted; error "
        f"{found.error_rms:.3g} N m rms, noise floor {found.floor_rms:.3g} N m."
    )


def _apart(pair: dict[str, Any]) -> str:
    return f"{' from '.join(map(spoken, pair['names']))}, because {pair['why']}: {pair['needs']}"
