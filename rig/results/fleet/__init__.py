"""``rig identify`` of a campaign with units: each unit, what they share, how they differ."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
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
from identification.numerics.arrays import Progress, plain
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification
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
    columns,
    provenance_section,
)
from rig.results.identify.identify import Outcome, Request, outcome_record
from rig.sources import load_source

FLEET_FILE, FLEET_SCHEMA = "fleet.json", "loadrig.fleet/1"
SESSION_GAP_S = 3600.0  # least pause between two sessions of a unit
_SHOWN = 5


@dataclass(frozen=True)
class Found:
    """Result of all units: each identification that was possible, and what they say together."""

    dataset: Dataset
    results: Mapping[str, Identification]
    fleet: Fleet
    warnings: tuple[str, ...]
    provenance: Provenance

    @property
    def parameter_units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return {n: p.unit for r in self.results.values() for n, p in r.parameters.items()}


def campaign_of_units(source: Path) -> Campaign | None:
    """Return a campaign with recordings of several units; None of any other source."""
    if not is_file(source) or source.suffix.lower() not in (".yaml", ".yml"):
        return None
    campaign = load_campaign(source).value
    return campaign if len({r.unit for r in campaign.recordings}) > 1 else None


def identify_fleet(source: Path, campaign: Campaign, request: Request, progress: Progress) -> Found:
    """Identify each unit of a campaign, and compare the units.

    Raises:
        InputError: The recordings cannot be read, or no unit can be identified.
    """
    started = time.perf_counter()
    progress("reading", 0.0)
    dataset = load_source(source, partial=request.partial, units=True)
    stamps = [instant(r.start) for r in campaign.recordings if isinstance(r.start, str)]

    def identified(recordings: Sequence[Recording]) -> Identification:
        part = replace(dataset, recordings=tuple(recordings))
        rng = np.random.default_rng(request.seed)
        return identify_any_length(part, bandwidth_Hz=request.bandwidth_Hz, rng=rng)

    def label(session: Sequence[Recording]) -> str:
        start = session[0].span[0]
        if not stamps:
            return f"{start:.6g} s"
        return f"{min(stamps) + timedelta(seconds=start):%Y-%m-%d %H:%M}"

    results, given, warnings = {}, {}, []
    names = list(dict.fromkeys(r.unit for r in dataset.recordings))
    for k, name in enumerate(names):
        progress(f"unit {name}", k / len(names))
        own = [r for r in dataset.recordings if r.unit == name]
        try:
            results[name] = identified(own)
        except RecordingError as error:
            warnings.append(f"{name}: not identified: {error}")
            continue
        parts = {}
        for session in several if len(several := _sessions(own)) > 1 else ():
            try:
                parts[label(session)] = _estimates(identified(session))
            except RecordingError:  # too short by itself
                continue
        given[name] = replace(_estimates(results[name]), sessions=parts)
    if not results:
        raise InputError([f"{source}: {line}" for line in warnings])
    model, known = campaign.model, dict.fromkeys(n for u in given.values() for n in u.values)
    others = [n for n in known if n not in model.per_unit] if model.per_unit else []
    found = fleet(given, model.shared or others)
    warnings += _warnings(dataset, results, found)
    seconds = time.perf_counter() - started
    provenance = Provenance.of(request.seed, dataset.recordings, seconds, source, dataset.tables)
    return Found(dataset, results, found, tuple(warnings), provenance)


def _estimates(found: Identification) -> Estimates:
    """Return what is determined; a value at its bound has no such distribution."""
    free = {
        name: value
        for name, value in found.values.items()
        if not found.parameters[name].at_bound
        and (name not in found.covariance.names or math.isfinite(found.covariance.half_width(name)))
    }
    return Estimates(free, found.covariance.only(free))


def _sessions(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Return the fitted recordings of a unit in the order of time, cut where a pause is long."""
    timed = [r for r in recordings if r.start is not None and r.role == "fit"]
    found: list[list[Recording]] = []
    for recording in sorted(timed, key=lambda r: r.span):
        if not found or recording.span[0] - found[-1][-1].span[1] > SESSION_GAP_S:
            found.append([])
        found[-1].append(recording)
    return found


def _warnings(
    dataset: Dataset, results: Mapping[str, Identification], found: Fleet
) -> Iterator[str]:
    if misfits := [name for name, result in results.items() if result.misfit]:
        more = f" and {len(misfits) - _SHOWN} more" if len(misfits) > _SHOWN else ""
        listed = f"{', '.join(misfits[:_SHOWN])}{more}"
        yield f"{listed}: the model does not describe this unit; see its own result"
    if found.shared_p_value is not None and found.shared_p_value < LEVEL:
        yield (
            f"the units' own estimates of {', '.join(found.shared)} differ more than their "
            f"uncertainty allows (p = {found.shared_p_value:.2g}); this widens the intervals"
        )
    if len(results) < LEAST_UNITS:
        yield f"{len(results)} units: a mean and a spread need {LEAST_UNITS}"
    if constants := [c.place for c in uncertain_constants(dataset.part("fit"))]:
        yield (
            f"the uncertainty of {', '.join(constants)} counts as independent in each unit; if the "
            "units have it in common, intervals of means and shared parameters are too narrow"
        )


def fleet_record(found: Found) -> dict[str, Any]:
    """Return the record of ``rig identify --json`` of a campaign with units."""
    return {
        **found.provenance.record(FLEET_SCHEMA),
        **plain(found.fleet),
        "parameter_units": found.parameter_units,
        "misfit": {n: [str(code) for code in r.misfit] for n, r in found.results.items()},
        "warnings": list(found.warnings),
    }


def unit_records(found: Found) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the file of each unit's own identification, and its record."""
    for name, result in found.results.items():
        recordings = tuple(r for r in found.dataset.recordings if r.unit == name)
        own = replace(found.dataset, recordings=recordings)
        yield f"{name}/{RESULT_FILE}", outcome_record(Outcome(own, (result,), found.provenance))


def fleet_document(name: str, found: Found) -> Document:
    """Return the result of all units as a document."""
    odd, count = dict.fromkeys(o.unit for o in found.fleet.odd), f"{len(found.results)} units"
    verdict = Verdict(f"None of {count} differs from the others", "", "good")
    if len(found.results) < LEAST_JUDGED:
        said = f"it takes {LEAST_JUDGED} units to judge which one differs"
        verdict = Verdict(f"{count}, not judged", said, "open")
    if odd:
        said = f"{', '.join(odd)}: left out of means, spreads and shared values"
        verdict = Verdict(f"{len(odd)} of {count} differ from the others", said, "open")
    others = found.fleet.populations
    differ = columns(
        found.fleet.odd,
        (2, 3, 4, 5),
        ("odd unit", lambda o: o.unit),
        ("parameter", lambda o: o.parameter),
        ("value", lambda o: number(o.value)),
        (
            "mean",
            lambda o: number(others[o.parameter].mean.value) if o.parameter in others else "-",
        ),
        ("deviations", lambda o: number(o.ratio, 3)),
        ("p", lambda o: f"{o.p_value:.2g}"),
        ("since", lambda o: o.since or "-"),
    )
    tables = [t for t in (differ, _means_table(found)) if t.rows]
    head = Section("", (verdict, *tables, *(Note(w, "warning") for w in found.warnings)))
    borrowed = (
        "A unit's value is drawn to the mean by its own uncertainty; * marks what its recordings "
        "do not determine at all."
    )

    def cell(value: Value | None) -> str:
        if value is None:
            return "-"
        mark = "*" if value.own is None else ""
        return f"{number(value.value)}{mark} {interval(value.low, value.high)}"

    units = found.fleet.units
    names = dict.fromkeys(n for own in units.values() for n in own)
    rows = tuple((unit, *(cell(own.get(n)) for n in names)) for unit, own in units.items())
    values = Table(("unit", *names), rows, tuple(range(1, len(names) + 1)))
    each = Section("Units", (values, Note(borrowed, "aside")))
    sections = (head, each, provenance_section(found.provenance))
    return Document(f"Identification of {name}", count, (head,), sections)


def _means_table(found: Found) -> Table:
    shared, populations = found.fleet.shared, found.fleet.populations
    rows = []
    for name in dict.fromkeys((*populations, *shared)):
        p = populations.get(name)
        mean = shared[name] if name in shared or p is None else p.mean
        spread = ("-", "-", "-")
        if p is not None:
            ends = interval(p.spread.low, p.spread.high)
            spread = number(p.spread.value, 3), ends, str(p.units)
        middle = number(mean.value), interval(mean.low, mean.high)
        same = "shared" if name in shared else "per unit"
        rows.append((name, same, *middle, *spread, found.parameter_units[name]))
    ends = "90 % interval"
    header = ("parameter", "is", "mean", ends, "spread", ends, "units", "unit")
    return Table(header, tuple(rows), (2, 4, 6))
