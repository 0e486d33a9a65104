"""``rig identify`` of a campaign with units: each unit, what they share, how they differ."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from identification.estimate.covariance import uncertain_constants
from identification.estimate.default import identify_any_length
from identification.estimate.fleet import (
    LEAST_JUDGED,
    LEAST_UNITS,
    LEVEL,
    Estimates,
    Fleet,
    Value,
    fleet,
)
from identification.numerics.arrays import plain
from identification.numerics.spread import NO_SPREAD
from identification.recording import Dataset, Recording, RecordingError
from identification.result import HEADLINES, Identification
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.provenance import RESULT_FILE, Provenance
from rig.common.tables import interval, number
from rig.common.timing import instant
from rig.config.campaign import Campaign, load_campaign
from rig.results.document import (
    Document,
    Note,
    Section,
    Table,
    Verdict,
    provenance_section,
    reading_notes,
)
from rig.results.identify.identify import Outcome, Request, outcome_record
from rig.sources import load_source

FLEET_FILE, FLEET_SCHEMA = "fleet.json", "loadrig.fleet/1"
SESSION_GAP_S = 3600.0
"""Least pause between two sessions of a unit."""


@dataclass(frozen=True)
class Found:
    """Result of all units.

    Attributes:
        results: Unit to its identification; units that cannot be identified are missing.
        fleet: What the units say together.
        since: Unit and parameter that is odd to the start of its first session from which it stays
            so; empty where no start is known.
        warnings: What to know before using the values.
    """

    dataset: Dataset
    results: Mapping[str, Identification]
    fleet: Fleet
    since: Mapping[tuple[str, str], str]
    warnings: tuple[str, ...]
    provenance: Provenance

    def unit(self, name: str) -> str:
        """Return the unit of a parameter, empty for a number."""
        first = next(iter(self.results.values()))
        return first.parameters[name].unit if name in first.parameters else ""


def campaign_of_units(source: Path) -> Campaign | None:
    """Return a campaign with recordings of several units; None of any other source."""
    if not is_file(source) or source.suffix.lower() not in (".yaml", ".yml"):
        return None
    campaign = load_campaign(source).value
    return campaign if len({r.unit for r in campaign.recordings}) > 1 else None


def identify_fleet(
    source: Path, campaign: Campaign, request: Request, progress: Callable[[str, float], None]
) -> Found:
    """Identify each unit of a campaign, and compare the units.

    Raises:
        InputError: The recordings cannot be read, or no unit can be identified.
    """
    started = time.perf_counter()
    progress("reading", 0.0)
    dataset = load_source(source, units=True)
    names = list(dict.fromkeys(r.unit for r in dataset.recordings))
    results: dict[str, Identification] = {}
    warnings = []
    for k, name in enumerate(names):
        progress(f"unit {name}", k / len(names))
        try:
            results[name] = _identified(dataset, _of(dataset, name), request)
        except RecordingError as error:
            warnings.append(f"{name}: not identified: {error}")
    if not results:
        raise InputError([f"{source}: {line}" for line in warnings])
    given = {n: _estimates(dataset, n, results[n], request) for n in results}
    found = fleet(given, _shared(campaign, results))
    stamps = [instant(r.start) for r in campaign.recordings if isinstance(r.start, str)]
    since = {}
    for odd in found.odd:
        if odd.since is not None:
            start = _sessions(dataset, odd.unit)[odd.since][0].span[0]
            clock = min(stamps) + timedelta(seconds=start) if stamps else None
            at = f"{start:.6g} s" if clock is None else f"{clock:%Y-%m-%d %H:%M}"
            since[odd.unit, odd.parameter] = at
    warnings += _warnings(dataset, results, found)
    seconds = time.perf_counter() - started
    provenance = Provenance.of(request.seed, dataset.recordings, seconds, source, dataset.tables)
    return Found(dataset, results, found, since, tuple(warnings), provenance)


def _of(dataset: Dataset, unit: str) -> list[Recording]:
    return [r for r in dataset.recordings if r.unit == unit]


def _sessions(dataset: Dataset, unit: str) -> list[list[Recording]]:
    """Return the fitted recordings of a unit in the order of time, cut where a pause is long."""
    own = [r for r in _of(dataset, unit) if r.start is not None and r.role == "fit"]
    found: list[list[Recording]] = []
    for recording in sorted(own, key=lambda r: r.span):
        if not found or recording.span[0] - found[-1][-1].span[1] > SESSION_GAP_S:
            found.append([])
        found[-1].append(recording)
    return found


def _identified(
    dataset: Dataset, recordings: Sequence[Recording], request: Request
) -> Identification:
    return identify_any_length(
        replace(dataset, recordings=tuple(recordings)),
        bandwidth_Hz=request.bandwidth_Hz,
        rng=np.random.default_rng(request.seed),
    )


def _estimates(dataset: Dataset, unit: str, result: Identification, request: Request) -> Estimates:
    """Return what the recordings of a unit determine, and those of each of its sessions; a value at
    its bound has no such distribution.
    """

    def of(found: Identification) -> Estimates:
        held = [n for n, p in found.parameters.items() if p.at_bound]
        values = {n: v for n, v in found.values.items() if n not in held}
        return Estimates(values, found.covariance.only(values))

    sessions = []
    for session in several if len(several := _sessions(dataset, unit)) > 1 else ():
        try:
            sessions.append(of(_identified(dataset, session, request)))
        except RecordingError:  # too short by itself
            sessions.append(Estimates({}, NO_SPREAD))
    return replace(of(result), sessions=tuple(sessions))


def _shared(campaign: Campaign, results: Mapping[str, Identification]) -> list[str]:
    model = campaign.model
    if model.shared or not model.per_unit:
        return list(model.shared)
    known = dict.fromkeys(n for r in results.values() for n in r.covariance.names)
    return [n for n in known if n not in model.per_unit]


def _warnings(dataset: Dataset, results: Mapping[str, Identification], found: Fleet) -> list[str]:
    warnings = []
    misfits = {n: r for n, r in results.items() if r.misfit}
    for name, result in list(misfits.items())[:3]:
        warnings.append(f"{name}: {HEADLINES[result.misfit[0]]}: {result.misfit_words}")
    if len(misfits) > 3:
        warnings.append(f"{len(misfits) - 3} more units have a misfit")
    if found.shared_p_value is not None and found.shared_p_value < LEVEL:
        warnings.append(
            f"the units' own estimates of {', '.join(found.shared)} differ more than their "
            f"uncertainty allows (p = {found.shared_p_value:.2g}): not the same in all units; the "
            "intervals are widened by this"
        )
    if len(results) < LEAST_JUDGED:
        warnings.append(
            f"{len(results)} units: a mean and a spread need {LEAST_UNITS}, a judgement of which "
            f"unit is odd needs {LEAST_JUDGED}"
        )
    if constants := [c.place for c in uncertain_constants(dataset.part("fit"))]:
        warnings.append(
            f"the uncertainty of {', '.join(constants)} counts as independent in each unit; if the "
            "units have it in common, intervals of means and shared parameters are too narrow"
        )
    return warnings


def fleet_record(found: Found) -> dict[str, Any]:
    """Return the record of ``rig identify --json`` of a campaign with units."""

    def entry(name: str, value: Value) -> dict[str, Any]:
        return {**plain(value), "unit": found.unit(name)}

    result = found.fleet
    return {
        **found.provenance.record(FLEET_SCHEMA),
        "shared": {n: entry(n, v) for n, v in result.shared.items()},
        "shared_p_value": result.shared_p_value,
        "populations": {
            n: {"mean": entry(n, p.mean), "spread": entry(n, p.spread), "units": p.units}
            for n, p in result.populations.items()
        },
        "units": {
            name: {
                "parameters": {n: entry(n, v) for n, v in own.items()},
                "misfit": [str(code) for code in found.results[name].misfit],
                "result": f"{name}/{RESULT_FILE}",
            }
            for name, own in result.units.items()
        },
        "odd": [{**plain(o), "since": found.since.get((o.unit, o.parameter))} for o in result.odd],
        "warnings": list(found.warnings),
    }


def unit_records(found: Found) -> dict[str, dict[str, Any]]:
    """Return the record of each unit's own identification, by its file."""
    records = {}
    for name, result in found.results.items():
        own = replace(found.dataset, recordings=tuple(_of(found.dataset, name)))
        records[f"{name}/{RESULT_FILE}"] = outcome_record(Outcome(own, (result,), found.provenance))
    return records


def fleet_document(name: str, found: Found) -> Document:
    """Return the result of all units as a document."""
    units = {o.unit: None for o in found.fleet.odd}
    count = f"{len(found.results)} units"
    if units:
        said = f"{', '.join(units)}: not like the other units, whose values leave them out"
        verdict = Verdict(f"{len(units)} of {count} differ from the others", said, "open")
    else:
        verdict = Verdict(f"No unit of {count} differs from the others", "", "good")
    tables = [t for t in (_odd_table(found), _means_table(found)) if t.rows]
    head = Section("", (verdict, *tables, *(Note(w, "warning") for w in found.warnings)))
    notes = tuple(map(Note, reading_notes(found.dataset.recordings)))
    borrowed = (
        "A unit's value is drawn to the mean by its own uncertainty; * marks what its recordings "
        "do not determine at all."
    )
    each = Section("Units", (_unit_table(found), Note(borrowed, "aside")))
    sections = (head, each, *((Section("Reading", notes),) if notes else ()))
    title = f"Identification of {name}"
    return Document(title, count, (head,), (*sections, provenance_section(found.provenance)))


def _odd_table(found: Found) -> Table:
    rows = tuple(
        (o.unit, o.parameter, number(o.value),
         number(found.fleet.populations[o.parameter].mean.value), number(o.ratio, 3),
         f"{o.p_value:.2g}", found.since.get((o.unit, o.parameter), "-"))
        for o in found.fleet.odd
    )  # fmt: skip
    header = ("odd unit", "parameter", "value", "mean", "deviations", "p", "since")
    return Table(header, rows, (2, 3, 4, 5))


def _means_table(found: Found) -> Table:
    shared, populations = found.fleet.shared, found.fleet.populations
    rows = []
    for name in dict.fromkeys((*populations, *shared)):
        p = populations.get(name)
        mean = shared[name] if name in shared or p is None else p.mean
        width = ("-", "-", "-")
        if p is not None:
            ends = interval(p.spread.low, p.spread.high)
            width = number(p.spread.value, 3), ends, str(p.units)
        middle = number(mean.value), interval(mean.low, mean.high)
        same = "shared" if name in shared else "per unit"
        rows.append((name, same, *middle, *width, found.unit(name)))
    ends = "90 % interval"
    header = ("parameter", "is", "mean", ends, "spread", ends, "units", "unit")
    return Table(header, tuple(rows), (2, 4, 6))


def _unit_table(found: Found) -> Table:
    names = dict.fromkeys(n for own in found.fleet.units.values() for n in own)

    def cell(value: Value | None) -> str:
        if value is None:
            return "-"
        mark = "*" if value.own is None else ""
        return f"{number(value.value)}{mark} ({interval(value.low, value.high)})"

    rows = tuple(
        (unit, *(cell(own.get(n)) for n in names)) for unit, own in found.fleet.units.items()
    )
    return Table(("unit", *names), rows, tuple(range(1, len(names) + 1)))
