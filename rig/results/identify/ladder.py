"""The ladder of friction models as text, record and table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from identification.estimate.ladder import Interval, Rung
from identification.model.ladder import LADDER
from rig.common.parameter_table import Table
from rig.common.result_files import finite, fit_record, parameter_record
from rig.common.tables import interval, number, percent


def ladder_table(rungs: Sequence[Rung]) -> Table:
    """Return one row per rung: error of the fit, on what was set aside, and of the simulated angle
    there.
    """
    first = rungs[0].result
    unit, small = first.fit.unit, "mrad" if first.motion == "rotary" else "um"
    scale = 1e3 if first.motion == "rotary" else 1e6
    header = (
        "friction",
        "terms",
        f"fit ({unit})",
        "90 %",
        f"validate ({unit})",
        "90 %",
        f"angle ({small})",
        "90 %",
        "best in",
    )
    rows = [
        (
            rung.friction,
            ", ".join(LADDER[rung.friction]),
            *_cells(rung.train, 1.0),
            *_cells(rung.scored, 1.0),
            *_cells(rung.angle, scale),
            percent(100.0 * rung.best),
        )
        for rung in rungs
    ]
    return Table(header, tuple(rows), (2, 4, 6, 8))


def ladder_notes(rungs: Sequence[Rung]) -> list[str]:
    """Return what the table's columns mean."""
    first = rungs[0]
    where = "the recordings set aside" if first.scored is not None else "the recordings fitted"
    lines = [
        f"Torque errors at {number(first.result.fit.bandwidth_Hz, 3)} Hz; intervals are over "
        f"recordings, drawn anew "
        "for fit and score.",
        f"Best in: share of the draws in which a rung has the least torque error on {where}.",
    ]
    if first.angle is not None:
        lines.append(
            f"Angle: error of the closed loop simulated from its command and first sample, on "
            f"{where}."
        )
    return lines


def ladder_record(rungs: Sequence[Rung]) -> list[dict[str, Any]]:
    """Return the record under ``ladder`` of ``rig identify --json``; angles in rad (m)."""
    return [
        {
            "friction": rung.friction,
            "terms": list(LADDER[rung.friction]),
            "parameters": {name: parameter_record(p) for name, p in rung.result.parameters.items()},
            "fitted": {name: finite(value) for name, value in rung.result.fitted.items()},
            "fit": fit_record(rung.result.fit),
            "train_rms": _interval_record(rung.train),
            "validate_rms": _interval_record(rung.scored),
            "angle_rms": _interval_record(rung.angle),
            "best_share": rung.best,
        }
        for rung in rungs
    ]


def _cells(found: Interval | None, scale: float) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    return number(scale * found.value, 3), interval(scale * found.low, scale * found.high)


def _interval_record(found: Interval | None) -> dict[str, float] | None:
    return None if found is None else {"value": found.value, "low": found.low, "high": found.high}
