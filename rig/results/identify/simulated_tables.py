"""Makes the table of the friction models fitted to the simulated angle, with explanatory lines."""

from __future__ import annotations

import math
from collections.abc import Sequence

from identification.estimate.ladder import Interval
from identification.estimate.prediction.loop_fit import PER_VOLT, Constant
from identification.estimate.prediction.simulated_ladder import SimulatedRung
from identification.model.ladder import SIMULATED
from identification.model.parameters import LINEAR
from rig.common.tables import CHANGED, NO_CHANGE, interval, number
from rig.results.document import Table

_WORDS = {
    "torque_constant": "torque constant (and back-EMF constant)",
    "resistance": "resistance",
    PER_VOLT: "torque per volt at rest",
}


def simulated_table(rungs: Sequence[SimulatedRung], motion: str) -> Table:
    """Return one row for each fit: errors of the simulated angle, and the change of each
    constant.
    """
    small, scale = ("um", 1e6) if motion == LINEAR else ("mrad", 1e3)
    names = [c.name for c in next((r.constants for r in rungs if r.constants), ())]
    header = (
        "friction",
        "terms",
        "motor constants",
        f"fit, MAE ({small})",
        "90 %",
        "cross-validated",
        "validate",
        "90 %",
        "best in",
        *names,
        "by cross-validation",
    )
    rows = [
        (
            rung.friction,
            ", ".join(SIMULATED[rung.friction]),
            "free" if rung.free else "declared",
            *_cells(rung.train, scale),
            "-" if math.isnan(rung.crossed) else number(scale * rung.crossed, 3),
            *_cells(rung.scored, scale),
            f"{100.0 * rung.best:.3g} %",
            *(_changes(rung.constants, names)),
            "least" if rung.chosen else "tied" if rung.tied else "",
        )
        for rung in rungs
    ]
    numbers = (3, 5, 6, 8, *range(9, 9 + len(names)))
    return Table(header, tuple(rows), numbers)


def simulated_notes(rungs: Sequence[SimulatedRung]) -> list[str]:
    """Return explanations of the table, and the change of each constant in the fits that
    cross-validation does not reject.
    """
    longest = max(rung.horizon_s for rung in rungs)
    lines = [
        f"Fitted to the simulated angle over up to {number(longest, 3)} s from a measured state; "
        f"MAE: mean absolute error of that angle. Cross-validated: error on each third of the "
        f"recordings, predicted by a fit to the other two thirds; tied: not distinguished from "
        f"the least cross-validated error.",
    ]
    for rung in rungs:
        if rung.tied and rung.constants:
            lines += [_constant_line(c, rung.friction) for c in rung.constants]
    return lines


def _constant_line(c: Constant, friction: str) -> str:
    prior = "" if c.prior is None else f", prior +- {100.0 * c.prior:.3g} %"
    return (
        f"{friction}: {_WORDS[c.name]} {number(c.declared, 4)} declared{prior}; "
        f"{number(c.value, 4)} {interval(c.low, c.high)} {c.unit} found, "
        f"{100.0 * c.change:+.1f} %: {CHANGED if c.moved else NO_CHANGE}"
    )


def _changes(found: Sequence[Constant], names: Sequence[str]) -> list[str]:
    by_name = {c.name: c for c in found}
    return [
        "-"
        if n not in by_name
        else f"{100.0 * by_name[n].change:+.1f} %{f' {CHANGED}' if by_name[n].moved else ''}"
        for n in names
    ]


def _cells(found: Interval | None, scale: float) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    return number(scale * found.value, 3), interval(scale * found.low, scale * found.high)
