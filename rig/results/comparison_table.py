"""All estimators side by side, for the terminal, the report and the result file alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from identification.estimate.paper_method.comparison import Contender
from rig.common.parameter_table import Table
from rig.common.result_files import finite
from rig.common.tables import number, percent

COMPARISON_NOTE = (
    "The searches minimise the paper's equation error, stage by stage, in one box; the default "
    "method goes on to the "
    "prediction errors. Failed: ended more than 0.1 % above the least cost found. Errors: worst "
    "parameter, median run."
)


def comparison_table(contenders: Sequence[Contender]) -> Table:
    """Return one row per estimator; the column against the truth is left out where that is not
    known.
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


def comparison_record(contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Return the comparison as it stands in the result file; errors are relative."""
    return [
        {
            "name": c.name,
            "runs": c.runs,
            "failures": c.failures,
            "evaluations": c.evaluations,
            "seconds": c.seconds,
            "cost_above_least": finite(c.excess),
            "error": finite(c.error),
            "worst": c.worst,
            "true_error": finite(c.true_error),
            "true_worst": c.true_worst,
            "values": {name: finite(value) for name, value in c.values.items()},
        }
        for c in contenders
    ]


def _true(c: Contender) -> str:
    return "-" if c.true_error is None else f"{percent(100.0 * c.true_error)} ({c.true_worst})"
