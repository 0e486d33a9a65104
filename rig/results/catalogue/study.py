"""Output of ``rig runs study``: how far the constants of one unit repeat over runs."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from identification.numerics.arrays import plain
from identification.numerics.spread import Components, Scatter, quantile, variance_components
from rig.common.provenance import heading
from rig.common.tables import interval, number, percent
from rig.config.acceptance import Limit, Range
from rig.results.catalogue.compare import identified_runs, left_out_notes
from rig.results.document import Document, Note, Section, Table
from rig.runs.catalogue.entry import Details, Entry

STUDY_SCHEMA: Final = "loadrig.study/1"
FACTORS: Final = ("day", "operator")
"""Factors of a study; of two that always change together, the first is merged into the second."""
LEAST_RUNS: Final = 3
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
    components: Components | None  # parts of the scatter; None with too few runs

    def share(self, part: Scatter) -> float | None:
        """Return six standard deviations over the width of the tolerance; None without one."""
        if self.tolerance is None:
            return None
        return TOLERANCE_WIDTHS * part.value / (self.tolerance[1] - self.tolerance[0])

    def rows(self) -> Iterator[tuple[str, Scatter]]:
        """Yield the parts of the scatter with their names, then the sums of several parts."""
        if self.components is not None:
            yield from self.components.parts.items()
            if len(self.components.parts) > 2 and self.components.between is not None:
                yield "reproducibility", self.components.between
            if self.components.between is not None:
                yield "total", self.components.total


@dataclass(frozen=True)
class Study:
    """Runs of one bench, and the scatter of their constants."""

    bench: str
    simulated: bool | None
    method: str
    runs: tuple[Mapping[str, str], ...]  # folder, begin, day (UTC) and operator of each run
    constants: Mapping[str, Studied]  # scatter by the name of the constant
    left_out: tuple[str, ...]  # runs that do not count, with the reason

    @property
    def merged(self) -> dict[str, list[str]]:
        """Constants whose scatter by a factor cannot be separated, by factor."""
        found: dict[str, list[str]] = {}
        for name, each in self.constants.items():
            for factor in each.components.merged if each.components else ():
                found.setdefault(factor, []).append(name)
        return found


def studies(
    entries: Sequence[Entry], limits_of_run: Callable[[Path], Sequence[Limit]], seed: int
) -> list[Study]:
    """Return a study of each bench of identified runs; a run and its copies count once.

    Args:
        entries: Runs whose folders are paths.
        limits_of_run: Returns the acceptance limits for a run; those of the last run are used.
        seed: Seed of the order of the draws for the intervals.
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
        limits = limits_of_run(Path(runs[-1][0].folder))
        tolerances = {
            limit.name: (limit.low, limit.high)
            for limit in limits
            if isinstance(limit, Range) and np.isfinite(limit.high - limit.low)
        }
        constants = _constants([details for _, details in runs], about, tolerances, seed)
        made.append(Study(*key[:3], about, constants, tuple(left_out.get(key[:2], ()))))
    return made


def _constants(
    runs: Sequence[Details],
    about: Sequence[Mapping[str, str]],
    tolerances: Mapping[str, tuple[float, float]],
    seed: int,
) -> dict[str, Studied]:
    made = {}
    for name in dict.fromkeys(name for details in runs for name in details.constants):
        known = [
            (row, each.value, each)
            for row, details in zip(about, runs, strict=True)
            if (each := details.constants.get(name)) is not None
            and each.value is not None
            and not each.at_bound
        ]
        if not known:
            continue
        unit = known[-1][2].unit
        known = [item for item in known if item[2].unit == unit]
        values = np.array([value for _, value, _ in known])
        halves = [each.half_width for _, _, each in known if each.half_width is not None]
        factors = {factor: [row[factor] for row, _, _ in known] for factor in FACTORS}
        made[name] = Studied(
            unit,
            len(values),
            float(np.mean(values)),
            statistics.mean(halves) / quantile(np.inf) if halves else None,
            tolerances.get(name),
            variance_components(values, factors, np.random.default_rng(seed))
            if len(values) >= LEAST_RUNS
            else None,
        )
    return made


def study_document(found: Sequence[Study]) -> Document:
    """Return a table of standard deviations for each study."""
    sections = tuple(_section(study) for study in found)
    return Document("Repeatability study", "", sections, sections)


def _section(study: Study) -> Section:
    kind = "simulated" if study.simulated else "REAL"
    counts = [f"{len(study.runs)} runs"] + [
        f"{count} {factor}s"
        for factor in reversed(FACTORS)
        if (count := len({run[factor] for run in study.runs})) > 1
    ]
    about = ("constant", "runs", "mean", "unit")
    header = (*about, "scatter", "std", "90 % interval", "of the mean", "of the tolerance")
    rows = tuple(row for name, each in study.constants.items() for row in _rows(name, each))
    table = Table(header, rows, (1, 2, 5, 6, 7, 8))
    merged = (
        Note(
            f"the scatter by {factor} is not separated for {', '.join(names)}; let each operator "
            "run the unit more than once on each day",
            "aside",
        )
        for factor, names in study.merged.items()
    )
    title = f"{study.bench} ({kind}), {study.method} method: {', '.join(counts)}"
    return Section(title, (table, *merged, *left_out_notes(study.left_out)))


def _rows(name: str, each: Studied) -> Iterator[tuple[str, ...]]:
    about = (name, str(each.runs), number(each.mean), each.unit)
    if each.components is None:
        yield (*about, f"too few runs; needs {LEAST_RUNS}", "-", "-", "-", "-")
        return
    for part, scatter in each.rows():
        share = each.share(scatter)
        yield (
            *about,
            part,
            number(scatter.value, 3),
            interval(scatter.low, scatter.high),
            percent(100.0 * scatter.value / abs(each.mean)) if each.mean else "-",
            "-" if share is None else percent(100.0 * share),
        )
        about = ("", "", "", "")
    stated = number(each.from_intervals, 3)
    yield (*about, "stated by the intervals", stated, "-", "-", "-")


def study_record(found: Sequence[Study], seed: int) -> dict[str, Any]:
    """Return the record of ``rig runs study --json``."""
    return {
        **heading(STUDY_SCHEMA),
        "seed": seed,
        "studies": [
            {
                "bench": study.bench,
                "simulated": study.simulated,
                "method": study.method,
                "runs": list(study.runs),
                "left_out": list(study.left_out),
                "constants": {name: _record(each) for name, each in study.constants.items()},
            }
            for study in found
        ],
    }


def _record(each: Studied) -> dict[str, Any]:
    parts = {
        part: {**plain(scatter), "share_of_tolerance": each.share(scatter)}
        for part, scatter in each.rows()
    }
    return {
        "unit": each.unit,
        "runs": each.runs,
        "mean": each.mean,
        "from_intervals": each.from_intervals,
        "tolerance": each.tolerance,
        "components": parts,
        "merged": list(each.components.merged) if each.components else [],
    }
