"""Output of ``rig diagnose`` as a document."""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from identification.diagnosis.diagnose import observable_effects
from identification.diagnosis.observable import Observable
from identification.diagnosis.result import (
    Diagnosis,
    IdentifiedEffect,
    Location,
)
from identification.diagnosis.result import Verdict as Outcomes
from identification.diagnosis.rules import RULES
from identification.diagnosis.statement import FACTORS, readable
from identification.effects import EFFECTS
from identification.effects.effect import Effect
from identification.effects.model import COORDINATES
from identification.effects.own import OwnEffect
from identification.model.parameters import parameter_title, parameter_unit
from identification.numerics.arrays import finite
from identification.plots import mismatch
from identification.prepare import torque_unit
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import source_name
from rig.common.provenance import Provenance, heading
from rig.common.tables import number, percent, table
from rig.config.configuration import nearest
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.own_effects import NO_FILE, OwnFile
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
    columns,
    few_of_each_role,
    provenance_section,
    reading_notes,
)
from rig.results.measured import named_errors
from rig.sources import load_source

if TYPE_CHECKING:
    from rig.results.diagnose.exports import Exports

READABLE = {unit: shown for unit, shown in FACTORS if unit not in ("", "s", "A")}
"""Units that are shown, by the units of the records."""
_SHORT_S = 0.5
_DEG = math.degrees(1.0)


def _effect_table(outcome: Outcome) -> Table:
    """Return one row for each parameter of each effect, named as for the motion of the bench."""
    found, motion = outcome.diagnosis, outcome.dataset.recordings[0].bench.motion
    rows = []
    for effect in found.effects:
        lead = (effect.name, number(effect.confidence, 3))
        for name, estimate in effect.parameters.items():
            unit = READABLE.get(estimate.unit, "")
            if estimate.unit == "s" and abs(estimate.value) < _SHORT_S:
                unit = "ms"
            rows.append((*lead, parameter_title(motion, name), readable(estimate, unit)))
            lead = ("", "")
    return Table(("effect", "confidence", "parameter", "value (90 % interval)"), tuple(rows), (1,))


def _fit_table(found: Diagnosis) -> Table:
    """Return the errors of both models, one row per equation and role."""
    rows = []
    for fit in found.fits if found.fit in found.fits else (found.fit, *found.fits):
        factor, unit = (_DEG, "deg") if fit.unit == "rad" else (1.0, fit.unit)
        pairs = [("fitted", fit.baseline_rms, fit.final_rms)]
        if fit.validate_baseline_rms is not None and fit.validate_final_rms is not None:
            pairs.append(("set aside", fit.validate_baseline_rms, fit.validate_final_rms))
        for role, *rms in pairs:
            numbers = (number(factor * each, 3) for each in (*rms, fit.noise_floor_rms))
            hertz = f"{number(fit.bandwidth_Hz, 3)} Hz"
            rows.append((fit.equation, role, *numbers, unit, hertz))
    rms_header = ("rms before", "rms after", "noise floor")
    header = ("equation", "recordings", *rms_header, "unit", "bandwidth")
    return Table(header, tuple(rows), (2, 3, 4, 6))


def _rival_table(found: Diagnosis) -> Table:
    return columns(
        [(effect, rival) for effect in found.effects for rival in effect.rivals],
        (2,),
        ("effect", lambda pair: pair[0].name),
        ("rival", lambda pair: pair[1].name),
        ("confidence", lambda pair: number(pair[1].confidence, 2)),
        ("why not", lambda pair: pair[1].why_not or "these recordings cannot reject it"),
    )


def _shift_table(found: Diagnosis) -> Table:
    """Return the nominal parameters in both models; no rows if none changed."""

    def change(before: float | None, after: float | None) -> str:
        if before is None or after is None or before == 0.0:
            return "-"
        return f"{100.0 * (after / before - 1.0):+.2f} %"

    moved = any(s.before != s.after for s in found.parameter_shift.values())
    return columns(
        found.parameter_shift.items() if moved else (),
        (1, 2, 3),
        ("parameter", lambda s: s[0]),
        ("before", lambda s: number(s[1].before)),
        ("after", lambda s: number(s[1].after)),
        ("change", lambda s: change(s[1].before, s[1].after)),
        ("unit", lambda s: "" if s[1].unit == "1" else s[1].unit),
    )


def _where_table(found: Diagnosis) -> Table:
    """Return the location of each effect and, if they are no or a part, of the whole mismatch."""
    places = [(e.name, e.where) for e in found.effects]
    outside = found.verdict is Outcomes.OUTSIDE_CATALOGUE
    if (outside or not places) and found.location is not None:
        places.append(("the whole mismatch", found.location))
    return columns(
        places,
        (3,),
        ("what", lambda p: p[0]),
        ("against", lambda p: p[1].coordinate),
        ("where", lambda p: _ranges(p[1])),
        ("share of the mismatch", lambda p: percent(100.0 * p[1].share_of_mismatch)),
        ("recordings", lambda p: _names(p[1].recordings)),
    )


def _ranges(where: Location) -> str:
    shown, factor = ("deg", _DEG) if where.unit == "rad" else (where.unit, 1.0)
    unit = "" if shown in ("", "1") else f" {shown}"
    ends = ", ".join(f"{low * factor:.3g} to {high * factor:.3g}" for low, high in where.ranges)
    return ends + unit if ends else "-"


def _names(recordings: tuple[str, ...]) -> str:
    rest = len(recordings) - _SHOWN_NAMES
    return ", ".join(recordings[:_SHOWN_NAMES]) + (f" and {rest} more" if rest > 0 else "")


_VERDICTS: dict[Outcomes, tuple[str, str, Literal["good", "found", "open"]]] = {
    Outcomes.NOTHING_MISSING: ("nothing missing", "Nothing is missing", "good"),
    Outcomes.NAMED: ("named", "The missing physics is identified", "found"),
    Outcomes.AMBIGUOUS: (
        "ambiguous",
        "These recordings cannot distinguish several effects",
        "open",
    ),
    Outcomes.OUTSIDE_CATALOGUE: (
        "outside the catalogue",
        "Something is missing that no effect of the catalogue explains",
        "open",
    ),
}
"""Verdict to its word in the terminal, and to headline and tone of the page."""
_SHOWN_PER_ROLE = _SHOWN_NAMES = 4


def diagnose_document(
    name: str, outcome: Outcome, exports: Exports, facts: tuple[tuple[str, str], ...] = ()
) -> Document:
    """Return a diagnosis as a document."""
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
    yield Section(f"verdict: {_VERDICTS[found.verdict][0]}", (Paragraph(found.statement),))
    for effect in found.effects:
        if effect.statement not in found.statement:
            yield Section("", (Paragraph(effect.statement, f"{effect.name}:"),))
    tables = (_where_table, _rival_table, _fit_table, _shift_table)
    for shown in (_effect_table(outcome), *(make(found) for make in tables)):
        if shown.rows:
            yield Section("", (shown,))
    for effect in found.effects:
        if len(effect.alias_group) > 1:
            lead = f"to split {', '.join(effect.alias_group)}:"
            yield Section("", (Paragraph(effect.separating_experiment, lead),))
    notes = (*map(Note, reading_notes(outcome.dataset.recordings)), *_warnings(found))
    if notes:
        yield Section("", notes)


def _sections(outcome: Outcome, exports: Exports) -> Iterator[Section]:
    found = outcome.diagnosis
    _, headline, tone = _VERDICTS[found.verdict]
    head: list[Block] = [Verdict(headline, found.statement, tone)]
    if any(fit.noise_floor_rms > 0.0 for fit in found.fits):
        caption = (
            "Error of each equation over its noise floor, before and after the correction; fitted "
            "recordings, and recordings that were set aside"
        )
        head.append(Picture.of("errors", caption, mismatch.errors(found.fits), lead=True))
    yield Section("", (*head, *_warnings(found)))
    if found.effects:
        effects = (Section(e.name, tuple(_texts(e, found))) for e in found.effects)
        yield Section("Identified effects", (_effect_table(outcome), *effects))
    yield Section("Error before and after", (_fit_table(found),))
    yield Section("Location of the mismatch", tuple(_located(found)))
    if (rivals := _rival_table(found)).rows:
        caption = "and the effects that were considered instead"
        pictures = (
            Picture.of(f"rivals_{e.name}", f"{e.name} {caption}", mismatch.rivals(e))
            for e in found.effects
            if e.rivals
        )
        yield Section("Rivals", (rivals, *pictures))
    if (shifts := _shift_table(found)).rows:
        note = Note("Nominal parameters fitted without and with the correction.", "aside")
        yield Section("Change of the nominal parameters", (note, shifts))
    steps = columns(
        enumerate(found.steps, 1),
        (0, 3, 4),
        ("step", lambda s: str(s[0])),
        ("what was done", lambda s: s[1].action),
        ("with", lambda s: s[1].name),
        ("p", lambda s: "-" if s[1].p_value is None else f"{s[1].p_value:.2g}"),
        ("gain", lambda s: number(s[1].gain, 3)),
        ("note", lambda s: s[1].note),
    )
    if steps.rows:
        yield Section("Steps of the search", (steps,))
    yield Section("Recordings", tuple(_traces(found)))
    if exports.files:
        files = tuple((file.name, file.use) for file in exports.files)
        yield Section("Beside this page", (Items(files),))
    if exports.notes:
        yield Section("", tuple(Note(line, "aside") for line in exports.notes))
    yield provenance_section(outcome.provenance)


def _texts(effect: IdentifiedEffect, found: Diagnosis) -> Iterator[Paragraph]:
    """Yield the text on one effect that accompanies the table."""
    others = [name for name in effect.alias_group if name != effect.name]
    if effect.statement not in found.statement:
        yield Paragraph(effect.statement)
    if others:
        words = f"These recordings cannot distinguish {effect.name} from {', '.join(others)}."
        yield Paragraph(words)
    if effect.separating_experiment:
        lead = "To distinguish them:" if others else "To confirm it:"
        yield Paragraph(effect.separating_experiment, lead)


def _warnings(found: Diagnosis) -> list[Note]:
    return [Note(line, "warning") for line in found.warnings]


def _located(found: Diagnosis) -> Iterator[Table | Picture]:
    """Yield the table of places, the curve of the missing physics, and the maps of the mismatch."""
    if (places := _where_table(found)).rows:
        yield places
    if found.curve is not None:
        caption = f"The missing physics as a smooth curve over {found.curve.coordinate}"
        if found.curve.coordinate in COORDINATES:
            caption += "; a simulation can use this curve"
        yield Picture.of("missing", caption, mismatch.curve(found.curve))
    for equation in dict.fromkeys(m.equation for m in found.maps):
        caption = (
            f"Mismatch of the {equation} equation against each coordinate, largest share first, "
            "with simultaneous 90 % bands, before and after the correction"
        )
        mine = [m for m in found.maps if m.equation == equation]
        yield Picture.of(f"maps_{equation}", caption, mismatch.maps(mine))


def _traces(found: Diagnosis) -> Iterator[Note | Picture]:
    mismatched = [t for t in found.traces if t.equation == found.fit.equation]
    order = ("validate", "fit")
    shown = few_of_each_role(mismatched, lambda t: t.role, _SHOWN_PER_ROLE, order)
    if hidden := len(mismatched) - len(shown):
        yield Note(f"Figures of {hidden} more recordings are left out.", "aside")
    for t in shown:
        role = "set aside" if t.role == "validate" else "fitted"
        words = f"mismatch of the {t.equation} equation before and after"
        yield Picture.of(
            f"mismatch_{t.equation}_{t.recording}",
            f"{t.recording} ({role}): {words}",
            mismatch.trace(t, found.fit.noise_floor_rms),
        )


OBSERVABLE_SCHEMA = "loadrig.observable/1"
HIDDEN = 0.01
"""Share of a regressor beyond the nominal parameters, below which an effect is collinear."""


@dataclass(frozen=True)
class Seen:
    """Result of ``rig diagnose --observable``."""

    dataset: Dataset
    effects: tuple[Observable, ...]
    provenance: Provenance
    own: OwnFile = NO_FILE

    def unit(self, effect: str, parameter: str) -> str:
        """Return the unit of an effect's parameter on this bench."""
        first = self.dataset.recordings[0]
        known = next(
            (q.unit for q in self.own.catalogue[effect].parameters if q.name == parameter), ""
        )
        return parameter_unit(first.bench.motion, parameter, known, torque_unit(first) == "A")

    def record(self) -> dict[str, Any]:
        """Return the record of ``rig diagnose --observable --json``."""
        return {
            **self.provenance.record(OBSERVABLE_SCHEMA),
            **self.own.record,
            "effects": [
                {
                    "name": e.name,
                    "shown": bool(e.sizes),
                    "left": finite(e.left),
                    "least": {
                        name: {"value": finite(value), "unit": self.unit(e.name, name)}
                        for name, value in e.sizes.items()
                    },
                    "alike": {name: finite(share) for name, share in e.alike.items()},
                    "separating_experiment": self.own.catalogue[e.name].experiment,
                }
                for e in self.effects
            ],
        }


def observe_source(
    source: Path,
    seed: int,
    bandwidth_Hz: float | None = None,
    own: OwnFile = NO_FILE,
    partial: bool = False,
) -> Seen:
    """Return which effects the recordings of a run folder or campaign file can show.

    Raises:
        InputError: The source cannot be read, or its recordings do not determine the nominal model.
    """
    started = time.perf_counter()
    dataset = load_source(source, partial=partial)
    with named_errors(source):
        effects = observable_effects(dataset, bandwidth_Hz, own.effects)
    seconds = time.perf_counter() - started
    provenance = Provenance.of(seed, dataset.recordings, seconds, source, dataset.tables)
    return Seen(dataset, effects, provenance, own)


def observable_document(source: Path, seen: Seen) -> Document:
    """Return the effects that recordings can show as a document."""

    def least(effect: Observable) -> str:
        name, value = next(iter(effect.sizes.items()))
        return f"{name} {value:.3g} {seen.unit(effect.name, name)}".rstrip()

    shown = [e for e in seen.effects if e.sizes]
    alike = [e for e in shown if e.alike]
    text = (
        f"These recordings can show {len(shown)} of {len(seen.effects)} effects; "
        f"{len(alike)} of these effects cannot be distinguished from others."
    )
    sizes = columns(
        shown,
        (1, 2),
        ("effect", lambda e: e.name),
        ("least size shown", least),
        (
            "beyond the nominal model",
            lambda e: f"{100.0 * e.left:{'.0f' if e.left >= HIDDEN else '.2g'}} %",
        ),
        (
            f"explained to {100.0 * RULES.alike:.0f} % by",
            lambda e: ", ".join(f"{name} {100.0 * s:.0f} %" for name, s in e.alike.items()),
        ),
    )
    blocks: list[Block] = [Paragraph(text), sizes]
    hidden = [e.name for e in seen.effects if not e.sizes]
    if hidden:
        blocks.append(Paragraph(", ".join(hidden) + ".", "Not shown by these recordings."))
    sections = [Section("What these recordings can show", tuple(blocks))]
    if alike:
        asked = tuple((e.name, seen.own.catalogue[e.name].experiment) for e in alike)
        sections.append(Section("What would distinguish them", (Items(asked),)))
    return Document(f"Observable effects of {source_name(source)}", text, tuple(sections))


CHECK_SCHEMA = "loadrig.effects_check/1"
COPY = 0.99
"""Share of an effect that another effect explains, from which neither is identified for sure."""


@dataclass(frozen=True)
class Check:
    """What a check found of one effect of one's own."""

    entry: Effect
    problems: tuple[str, ...]  # what is wrong with the effect
    seen: Observable | None  # what recordings can show of the effect; None without recordings

    def record(self) -> dict[str, Any]:
        """Return the entry of the effect in the record of ``rig effects --check --json``."""
        found: dict[str, Any] = {"name": self.entry.name, "problems": list(self.problems)}
        if isinstance(self.entry, OwnEffect):
            searched = list(self.entry.nonlinear)
            found |= {"linear": list(self.entry.coefficients), "searched": searched}
        if self.seen is not None:
            nominal = math.sqrt(max(1.0 - self.seen.left, 0.0)) if self.seen.sizes else 1.0
            alike = {name: math.sqrt(share) for name, share in self.seen.alike.items()}
            found |= {"correlations": {"nominal": nominal, **alike}, "least": dict(self.seen.sizes)}
        return found


def check_effects(own: OwnFile, source: Path | None, seed: int = 0) -> tuple[Check, ...]:
    """Check the effects of a file, on recordings if a source is given.

    Raises:
        InputError: The source cannot be used, or an effect fails.
    """
    # Imported late: a diagnosis without effects of one's own needs no driver.
    from drivers.mock.plant.effects.own import STATES

    seen = None if source is None else observe_source(source, seed, own=own)
    found = []
    for entry in own.effects:
        problems = entry.problems() if isinstance(entry, OwnEffect) else []
        if isinstance(entry, OwnEffect) and entry.name in own.injects:
            problems += entry.problems_of(own.injects[entry.name], STATES)
        shown = None
        if seen is not None:
            shown = next((e for e in seen.effects if e.name == entry.name), None)
            shown = shown or Observable(entry.name, 0.0, {}, {})
            if not shown.sizes:
                problems.append(
                    "degenerate: these recordings cannot show it: a change of the nominal "
                    "parameters explains it, it is zero in them, or they lack a signal that it uses"
                )
            problems += [
                f"copies {name}: correlation {math.sqrt(share):.3f} on these recordings, so that "
                "neither is identified for sure"
                for name, share in shown.alike.items()
                if share >= COPY
            ]
        found.append(Check(entry, tuple(problems), shown))
    return tuple(found)


def check_record(own: OwnFile, checks: Sequence[Check]) -> dict[str, Any]:
    """Return the record of ``rig effects --check --json``."""
    return {**heading(CHECK_SCHEMA), **own.record, "effects": [c.record() for c in checks]}


def check_text(checks: Sequence[Check]) -> str:
    """Return what a check found as text."""
    lines = []
    for check in checks:
        found = check.record()
        lines.append(f"{check.entry.name}: {'NOT good' if check.problems else 'good'}")
        for key in ("linear", "searched"):
            if key in found:
                lines.append(f"  {key}: {', '.join(found[key]) or 'nothing'}")
        if check.seen is not None:
            sizes = ", ".join(f"{n} = {v:.3g}" for n, v in check.seen.sizes.items()) or "none"
            alike = ", ".join(f"{n} {r:.3f}" for n, r in found["correlations"].items())
            lines += [f"  least size shown: {sizes}", f"  correlation with: {alike}"]
        lines += [f"  {problem}" for problem in check.problems]
    return "\n".join(lines)


EFFECTS_SCHEMA = "loadrig.effects/1"
_WIDTH = 100
_LABEL = 18


def entry_of(name: str) -> Effect:
    """Return one entry of the catalogue.

    Raises:
        InputError: The effect does not exist; the message suggests the nearest name.
    """
    if name not in EFFECTS:
        raise InputError(f"{name}: not an effect of the catalogue; {nearest(name, list(EFFECTS))}")
    return EFFECTS[name]


def overview(entries: Iterable[Effect]) -> str:
    """Return one line for each effect: its location and its fitted parameters."""
    listed = columns(
        entries,
        (),
        ("group", lambda e: e.group),
        ("effect", lambda e: e.name),
        ("equation", lambda e: e.shows_in),
        ("against", lambda e: e.coordinate.partition(":")[0]),
        ("parameters", lambda e: ", ".join(q.name for q in e.parameters)),
    )
    return table(listed.header, listed.rows)


def whole(entry: Effect) -> str:
    """Return the whole catalogue entry of one effect."""
    sizes = [
        f"{q.name}: plausible from {q.low:.4g} to {q.high:.4g} {q.unit}".rstrip()
        for q in entry.parameters
    ]
    lines = [
        ("effect", f"{entry.name} ({entry.group})"),
        ("equation", entry.equation),
        ("breaks", entry.assumption),
        ("shows in", f"the {entry.shows_in} equation, against {entry.coordinate}"),
        *zip(("parameter", *[""] * len(entry.parameters)), sizes, strict=False),
        ("look-alikes", ", ".join(entry.look_alikes)),
        ("distinguished by", entry.experiment),
        ("finding", entry.sentence),
    ]
    return "\n".join(
        textwrap.fill(
            text, _WIDTH, initial_indent=f"{label:<{_LABEL}}", subsequent_indent=" " * _LABEL
        )
        for label, text in lines
    )


def effects_record(entries: Iterable[Effect]) -> dict[str, Any]:
    """Return the record of ``rig effects --json``."""
    return {
        **heading(EFFECTS_SCHEMA),
        "effects": [
            {
                "name": entry.name,
                "group": entry.group,
                "equation": entry.equation,
                "assumption_broken": entry.assumption,
                "shows_in": entry.shows_in,
                "coordinate": entry.coordinate,
                "parameters": {
                    q.name: {"unit": q.unit, "low": q.low, "high": q.high} for q in entry.parameters
                },
                "look_alikes": list(entry.look_alikes),
                "separating_experiment": entry.experiment,
                "statement": entry.sentence,
            }
            for entry in entries
        ],
    }
