"""Makes the parameter tables for terminal and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identification.result import Identification, Parameter
from rig.common.tables import interval, number, percent
from rig.results.document import Table


def parameter_table(
    results: Sequence[Identification], truth: Mapping[str, float] | None = None
) -> Table:
    """Return one row per parameter, with value and 90 % interval by each method; columns without
    content are left out.

    The column ``floor`` is the least half width of the interval by the Cramer-Rao bound.

    Args:
        results: One per method; the first names the rows.
        truth: True values of a simulated bench, if known; adds the columns ``true`` and ``error``.
    """
    header = ["parameter"]
    for result in results:
        prefix = "" if len(results) == 1 else f"{result.method}: "
        header += [
            f"{prefix}value",
            f"{prefix}90 % interval",
            f"{prefix}floor",
            *([f"{prefix}error"] if truth else []),
        ]
    header += ["unit", *(["true"] if truth else []), "note"]
    names = dict.fromkeys(name for result in results for name in result.parameters)
    rows = [_row(name, results, truth) for name in names]
    kept = [i for i in range(len(header)) if any(row[i] not in ("", "-") for row in rows)]
    numbers = [k for k, i in enumerate(kept) if header[i] not in ("parameter", "unit", "note")]
    return Table(
        tuple(header[i] for i in kept),
        tuple(tuple(row[i] for i in kept) for row in rows),
        tuple(numbers),
    )


def parameter_notes(results: Sequence[Identification]) -> list[str]:
    """Return the reasons for the remarks in :func:`parameter_table`, one line per parameter."""
    return [
        f"{r.method}: {p.name}: {p.reason}"
        for r in results
        for p in r.parameters.values()
        if p.reason
    ]


def pinned_notes(results: Sequence[Identification]) -> list[str]:
    """Return for each method with intervals the number of determined parameters, and the least
    accurate parameter.
    """
    lines = []
    for result in results:
        widths = {
            n: 0.5 * (p.high - p.low) / abs(p.value)
            for n, p in result.parameters.items()
            if p.value and p.low is not None and p.high is not None and p.high > p.low
        }
        if widths:
            weakest = max(widths, key=lambda n: widths[n])
            count = f"{len(widths)} of {len(result.parameters)} parameters"
            lines.append(
                f"{result.method}: determines {count}; the weakest is {weakest}, to "
                f"{percent(100.0 * widths[weakest])}"
            )
    return lines


def note(parameter: Parameter) -> str:
    """Return a remark on an estimate in addition to its numbers."""
    if not parameter.identifiable:
        return "not identifiable"
    return "at the bound of the search" if parameter.at_bound else ""


def _floor(parameter: Parameter) -> str:
    return "-" if parameter.floor is None else f"+-{number(parameter.floor, 2)}"


def _error(value: float | None, true: float | None) -> str:
    return percent(None if value is None or not true else 100.0 * (value / true - 1.0))


def _row(
    name: str, results: Sequence[Identification], truth: Mapping[str, float] | None
) -> tuple[str, ...]:
    cells = [name]
    notes: list[str] = []
    unit = ""
    true = (truth or {}).get(name)
    for result in results:
        parameter = result.parameters.get(name)
        if parameter is None:
            cells += ["-"] * (4 if truth else 3)
            continue
        unit = parameter.unit
        cells += [
            number(parameter.value),
            interval(parameter.low, parameter.high),
            _floor(parameter),
        ]
        if truth:
            cells.append(_error(parameter.value, true))
        if said := note(parameter):
            notes.append(said if len(results) == 1 else f"{result.method}: {said}")
    return (*cells, unit, *([number(true)] if truth else []), "; ".join(notes))
