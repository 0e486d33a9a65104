"""Output of ``rig runs study``: how far the constants of one unit repeat over runs."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from identification.numerics.arrays import plain
from identification.numerics.spread import Scatter, quantile, variance_components
from rig.common.provenance import heading
from rig.common.tables import interval, number, percent
from rig.config.acceptance import Limit, Range
from rig.results.catalogue.compare import identified_runs, left_out_notes
from rig.results.document import Document, Note, Section, Table
from rig.runs.catalogue.entry import Details, Entry

STUDY_SCHEMA: Final = "loadrig.study/1"
FACTORS: Final = ("day", "operator")
"""Factors of a study; of two that always change together, the first is not separated."""
TOLERANCE_WIDTHS: Final = 6.0
"""Standard deviations that are compared with the width of a tolerance, as in a gauge study."""


@dataclass(frozen=True)
class Studied:
    """Scatter of one constant."""

    unit: str
    runs: int  # number of runs that determine the constant
    mean: float
    # Standard deviation that the intervals of the runs state; None without them.
    from_intervals: float | None
    tolerance: tuple[float, float] | None  # lower and upper limit of acceptance; None without both
    # Standard deviations by part of the scatter; empty with too few runs.
    scatter: Mapping[str, Scatter]
    # Six standard deviations over the width of the tolerance, by part of the scatter.
    shares: Mapping[str, float]
    # Factors that the runs do not separate; another part contains their scatter.
    merged: tuple[str, ...]


@dataclass(frozen=True)
class Study:
    """Runs of one bench, and the scatter of their constants."""

    bench: str
    simulated: bool | None
    method: str
    runs: tuple[Mapping[str, str], ...]  # folder, begin, day (UTC) and operator of each run
    constants: Mapping[str, Studied]  # scatter by the name of the constant
    left_out: tuple[str, ...]  # runs that do not count, with the reason


def studies(
    entries: Sequence[Entry], limits_of_run: Callable[[Path], Sequence[Limit]], seed: int
) -> list[Study]:
    """Return a study of each bench of identified runs; a run and its copies count once.

    Args:
        entries: Runs whose folders are paths.
        limits_of_run: Returns the acceptance limits for a run; those of the last run are used.
        seed: Seed of the random draws for the intervals.
    """
    groups, left_out = identified_runs(Path(), entries)
    made = []
    for key, runs in groups.items():
        about = tuple(
            {
                "run": entry.folder,
                "begun": entry.head.created,
                "day": entry.head.created[:10],
                "operator": ", ".join(entry.head.operators),
            }
            for entry, _ in runs
        )
        tolerances = {
            limit.name: (limit.low, limit.high)
            for limit in limits_of_run(Path(runs[-1][0].folder))
            if isinstance(limit, Range) and np.isfinite(limit.high - limit.low)
        }
        details = [each for _, each in runs]
        constants = {
            name: each
            for name in dict.fromkeys(name for _, one in runs for name in one.constants)
            if (each := _studied(name, details, about, tolerances.get(name), seed)) is not None
        }
        made.append(Study(*key[:3], about, constants, tuple(left_out.get(key[:2], ()))))
    return made


def _studied(
    name: str,
    runs: Sequence[Details],
    about: Sequence[Mapping[str, str]],
    tolerance: tuple[float, float] | None,
    seed: int,
) -> Studied | None:
    """Return the scatter of a constant over the runs that determine it; None without such runs."""
    found = [
        (row, run.constants[name])
        for row, run in zip(about, runs, strict=True)
        if name in run.constants
    ]
    unit = found[-1][1].unit
    known = [
        (row, each.value, each.half_width)
        for row, each in found
        if each.value is not None and each.unit == unit and not each.at_bound
    ]
    if not known:
        return None
    values = np.array([value for _, value, _ in known])
    halves = [half for _, _, half in known if half is not None]
    factors = {factor: [row[factor] for row, _, _ in known] for factor in FACTORS}
    scatter, merged = variance_components(values, factors, np.random.default_rng(seed))
    share = 0.0 if tolerance is None else TOLERANCE_WIDTHS / (tolerance[1] - tolerance[0])
    return Studied(
        unit,
        len(known),
        float(np.mean(values)),
        statistics.mean(halves) / quantile(np.inf) if halves else None,
        tolerance,
        scatter,
        {part: share * each.value for part, each in scatter.items() if share},
        merged,
    )


def study_document(found: Sequence[Study]) -> Document:
    """Return a table of standard deviations for each study."""
    sections = tuple(_section(study) for study in found)
    return Document("Repeatability study", "", sections, sections)


def _section(study: Study) -> Section:
    counts = [f"{len(study.runs)} run{'s' * (len(study.runs) != 1)}"]
    for factor in reversed(FACTORS):
        levels = {run[factor] for run in study.runs}
        counts += [f"{len(levels)} {factor}s"] if len(levels) > 1 else []
    about = ("constant", "runs", "mean", "unit")
    header = (*about, "scatter", "std", "90 % interval", "of the mean", "of the tolerance")
    rows = tuple(row for name, each in study.constants.items() for row in _rows(name, each))
    merged = {factor: name for name, each in study.constants.items() for factor in each.merged}
    notes = (
        Note(
            f"the runs do not separate the scatter by {factor}: let each operator run the unit "
            "on several days, more than once a day",
            "aside",
        )
        for factor in merged
    )
    kind = "simulated" if study.simulated else "REAL"
    title = f"{study.bench} ({kind}), {study.method} method: {', '.join(counts)}"
    table = Table(header, rows, (1, 2, 5, 6, 7, 8))
    return Section(title, (table, *notes, *left_out_notes(study.left_out)))


def _rows(name: str, each: Studied) -> Iterator[tuple[str, ...]]:
    about = (name, str(each.runs), number(each.mean), each.unit)
    for part, found in each.scatter.items():
        relative = 100.0 * found.value / abs(each.mean) if each.mean else None
        share = 100.0 * each.shares[part] if each.shares else None
        shown = number(found.value, 3), interval(found.low, found.high)
        yield (*about, part, *shown, percent(relative), percent(share))
        about = ("", "", "", "")
    yield (*about, "stated by the intervals", number(each.from_intervals, 3), "-", "-", "-")


def study_record(found: Sequence[Study], seed: int) -> dict[str, Any]:
    """Return the record of ``rig runs study --json``."""
    return {**heading(STUDY_SCHEMA), "seed": seed, "studies": plain(found)}
