"""Figures of a run that need no identification: deviations, currents, timing and weight checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.tables import number
from rig.config.acceptance import MEASURES, UNITS
from rig.results.document import Table
from rig.results.measured import QUANTITIES, clock_words
from rig.runs.run import load_run
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

_SHOWN: Final = (
    ("tracking error", "rms"),
    ("tracking error", "worst"),
    ("disagreement", "worst"),
    ("current", "worst"),
    ("temperature", "worst"),
    ("lateness", "p99"),
    ("lateness", "worst"),
    ("answer", "p99"),
    ("lost samples", ""),
    ("missed SYNCs", ""),
)
"""Quantities and statistics, in the order of the table."""
_UNITS: Final = {
    "angle": "deg", "time": "ms", "current": "A", "temperature": "deg C", "torque": "N m", "": "",
}  # fmt: skip
"""Unit of display of each dimension."""


@dataclass(frozen=True)
class Figure:
    """One measured value.

    Attributes:
        name: Quantity with its statistic.
        value: Value in ``unit``, or None if it was not recorded.
        unit: Unit; empty for a count.
        remark: Remark on the value; empty for no remark.
    """

    name: str
    value: float | None
    unit: str
    remark: str


@dataclass(frozen=True)
class RunFigures:
    """Measured values of one run.

    Attributes:
        figures: The values, in the same order for every run.
        done: Number of stages that are done, of all stages.
        weights: Verdicts of the weight checks, by stage.
        problem: Reason why the excitations cannot be read; empty if they were read.
    """

    figures: tuple[Figure, ...] = ()
    done: str = "-"
    weights: str = "-"
    problem: str = ""


def figures_of(folder: Path) -> RunFigures:
    """Return the measured values of a run. Values of excitations are None if no excitation was
    finished.

    Raises:
        InputError: The folder is not a run folder.
    """
    record = read_record(folder)
    dataset, problem = None, ""
    try:
        dataset = load_run(folder)
    except InputError as error:
        problem = error.problems[0]
    done = sum(stage.state == "done" for stage in record.stages)
    weights = ", ".join(f"{each['stage']}: {each['verdict']}" for each in record.weights)
    return RunFigures(
        tuple(_figure(record, dataset, *each) for each in _SHOWN),
        f"{done} of {len(record.stages)}",
        weights or "none made",
        problem,
    )


def _figure(record: RunRecord, dataset: Dataset | None, measure: str, statistic: str) -> Figure:
    unit = _UNITS[MEASURES[measure].dimension]
    value = QUANTITIES[measure](record, dataset, statistic)
    scale = UNITS[MEASURES[measure].dimension][unit]
    remark = clock_words(measure, record).removeprefix(", ")
    name = f"{measure} {statistic}".strip()
    return Figure(name, None if value is None else value / scale, unit, remark)


def figures_table(names: Sequence[str], runs: Sequence[RunFigures]) -> Table:
    """Return the measured values side by side, one column for each run.

    Args:
        names: Names of the runs.
        runs: The values of the runs.
    """
    rows = [
        ("stages done", "", *(each.done for each in runs)),
        ("weight checks", "", *(each.weights for each in runs)),
    ]
    for found in zip(*(each.figures for each in runs), strict=True):
        rows.append((found[0].name, found[0].unit, *map(_cell, found)))
    return Table(("quantity", "unit", *names), tuple(rows), tuple(range(2, 2 + len(names))))


def _cell(figure: Figure) -> str:
    shown = number(figure.value, 4)
    return f"{shown} {figure.remark}" if figure.remark and figure.value is not None else shown


def figures_record(run: Path, found: RunFigures) -> dict[str, Any]:
    """Return the measured values of a run as JSON values."""
    return {
        "run": str(run),
        "stages_done": found.done,
        "weight_checks": found.weights,
        "problem": found.problem,
        "figures": [
            {"name": f.name, "value": f.value, "unit": f.unit, "remark": f.remark}
            for f in found.figures
        ],
    }
