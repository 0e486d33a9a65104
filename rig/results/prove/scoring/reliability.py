"""Computes how often the effects that diagnoses identify are right, by confidence and by axes of
the world, and lists the wrong effects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rig.results.prove.scoring.rates import Row, rate

BINS = 10
"""Number of bins of confidence between 0 and 1."""
PARTS = 3
"""Number of parts with equally many values into which a numeric axis is divided."""
FEW = 5
"""Number of different values of a numeric axis up to which each value is a part of its own."""


def names_given(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return every effect that a diagnosis named: trial, name, confidence, and whether the name is
    right.

    ``right``: the named effect is injected; ``right_group``: the named effect or another effect of
    its alias group is injected.
    """
    given = []
    for row in rows:
        for effect in row["named"]:
            group = {effect["name"], *effect["alias_group"]}
            given.append(
                {
                    "rig": row["rig"],
                    "name": effect["name"],
                    "confidence": effect["confidence"],
                    "injected": list(row["effects"]),
                    "right": effect["name"] in row["effects"],
                    "right_group": bool(group & set(row["effects"])),
                }
            )
    return given


def reliability(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the share of right names for each bin of confidence; bins without names are left
    out.
    """
    binned: dict[int, list[dict[str, Any]]] = defaultdict(list)
    for name in names_given(rows):
        binned[min(int(BINS * name["confidence"] + 1e-9), BINS - 1)].append(name)
    return [
        {
            "from": k / BINS,
            "to": (k + 1) / BINS,
            "mean_confidence": float(np.mean([n["confidence"] for n in mine])),
            "right": rate(sum(n["right"] for n in mine), len(mine)),
        }
        for k, mine in sorted(binned.items())
    ]


def wrong_names(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the wrong names, the most confident name first."""
    wrong = [n for n in names_given(rows) if not n["right"]]
    return sorted(wrong, key=lambda n: -n["confidence"])


def right(row: Row) -> bool:
    """Return whether a trial's verdict is right: the first identified effects are the injected
    effects; without an injected effect, the verdict is "nothing missing"; for an injected effect
    that is not in the catalogue, the verdict is "outside the catalogue".
    """
    if row["kind"] == "outside":
        return bool(row["verdict"] == "outside_catalogue")
    if row["kind"] == "nothing":
        return bool(row["verdict"] == "nothing_missing")
    return bool(row["top1"])


def by_axis(rows: Sequence[Row]) -> dict[str, list[dict[str, Any]]]:
    """Return the share of right verdicts for each part of each axis of the world."""
    axes: dict[str, list[tuple[Any, Row]]] = defaultdict(list)
    for row in rows:
        for axis, value in row.get("axes", {}).items():
            axes[axis].append((value, row))
    return {axis: list(_parts(pairs)) for axis, pairs in axes.items()}


def _parts(pairs: Sequence[tuple[Any, Row]]) -> Iterator[dict[str, Any]]:
    values = [value for value, _ in pairs]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    named: Mapping[str, list[Row]] = defaultdict(list)
    if numeric and len(set(values)) > FEW:
        edges = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1)[1:-1])
        for value, row in sorted(pairs, key=lambda pair: pair[0]):
            named[str(int(np.searchsorted(edges, value)))].append(row)
        ends = [sorted(v for v, r in pairs if r in mine) for mine in named.values()]
        labels = [f"{mine[0]:.3g} to {mine[-1]:.3g}" for mine in ends]
    else:
        for value, row in sorted(pairs, key=lambda pair: (str(type(pair[0])), pair[0] or 0)):
            named[str(value)].append(row)
        labels = list(named)
    for label, mine in zip(labels, named.values(), strict=True):
        refused = sum(bool(row.get("refused")) for row in mine)
        yield {"value": label, "right": rate(sum(map(right, mine)), len(mine)), "refused": refused}
