"""Describes, before a run, the acceptance limits by which the complete run will be judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from identification.model.parameters import UNITS_ROTARY
from rig.common.tables import table
from rig.config.acceptance import NOTHING_MISSING, Bound, Limit, Range

NOT_JUDGED = (
    "acceptance: neither the sequence nor --acceptance states limits, so the run will not be judged"
)


def acceptance_rows(limits: Sequence[Limit]) -> list[tuple[str, str, str]]:
    """Return quantity, permitted values and unit of each limit."""
    return [_row(limit) for limit in limits]


def _row(limit: Limit) -> tuple[str, str, str]:
    if isinstance(limit, Bound):
        sign = f"{'<' if limit.below else '>'}{'=' if limit.inclusive else ''}"
        name = f"{limit.measure} {limit.statistic}".strip()
        return name, f"{sign} {limit.value:g}", limit.unit or "-"
    if isinstance(limit, Range):
        return f"{limit.name}, 90 % interval", _range(limit), UNITS_ROTARY[limit.name] or "-"
    if limit.text == NOTHING_MISSING:
        return "diagnosis", limit.text, "-"
    return "weight check", "passed", "-"


def _range(limit: Range) -> str:
    if math.isinf(limit.low):
        return f"<= {limit.high:g}"
    if math.isinf(limit.high):
        return f">= {limit.low:g}"
    return f"{limit.low:g} to {limit.high:g}"


def describe_acceptance(limits: Sequence[Limit], source: str) -> str:
    """Return the acceptance limits as a table, or a message if there are none.

    Args:
        limits: The acceptance limits.
        source: Origin of the limits.
    """
    if not limits:
        return NOT_JUDGED
    head = (
        f"acceptance: when all stages are done, the run is judged by {len(limits)} "
        f"{'limit' if len(limits) == 1 else 'limits'} of {source}"
    )
    rows = [list(row) for row in acceptance_rows(limits)]
    return f"{head}\n{table(['acceptance limit', 'permitted', 'unit'], rows)}"


def acceptance_record(limits: Sequence[Limit]) -> list[dict[str, Any]]:
    """Return the acceptance limits as JSON values."""
    return [
        {"limit": limit.text, "quantity": name, "permitted": permitted, "unit": unit}
        for limit, (name, permitted, unit) in zip(limits, acceptance_rows(limits), strict=True)
    ]
