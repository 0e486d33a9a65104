"""Computes the figures of a proof from its rows: rates with intervals, confusion, power against
strength.
"""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, get_args

from rig.common.result_files import Provenance
from rig.results.prove.draw import Kind
from rig.results.prove.scoring.rates import Row, rate
from rig.results.prove.scoring.reliability import by_axis, reliability, right, wrong_names

PROVE_SCHEMA = "loadrig.prove/3"
RESULT_FILE = "prove.json"
STRONG = 3.0
"""Least strength of an effect that a diagnosis must identify: rms change over noise, in the channel
in which this ratio is greatest.
"""
TORQUE = "current"
"""Channel in which the torque of an effect is measured: the motor current during motion."""
NONE: Row = {"named": [], "alarm": False, "top1": False, "alias": False, "exact": False}
"""Score that a baseline method gets on a trial that could not be diagnosed."""
EDGES = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, float("inf"))


def count(rows: Sequence[Row], key: str) -> dict[str, Any]:
    """Return the number of rows in which ``key`` is true, with its share and interval."""
    return rate(sum(bool(row[key]) for row in rows), len(rows))


def proof_record(rows: Sequence[Row], provenance: Provenance) -> dict[str, Any]:
    """Return the record of ``rig prove --json``."""
    return {**provenance.record(PROVE_SCHEMA), **score(rows), "rigs": list(rows)}


def score(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of a proof."""
    by_kind: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_kind[row["kind"]].append(row)
    one, two, nothing, outside = (by_kind[kind] for kind in ("one", "two", "nothing", "outside"))
    scored = [row for row in rows if row["kind"] != "unscored"]
    strong = [row for row in one if row["strength"] >= STRONG]
    torque = [row for row in one if row["strength_by_channel"].get(TORQUE, 0.0) >= STRONG]
    shown = [row for row in one if (row["left"] or 0.0) >= STRONG]
    inside = [
        p["inside"] for row in rows for p in row["parameters"].values() if p["inside"] is not None
    ]
    placed = [{"right": row["verdict"] == "outside_catalogue"} for row in outside]
    return {
        "counts": {kind: len(by_kind[kind]) for kind in get_args(Kind)},
        "top1": count(strong, "top1"),
        "alias_group": count(strong, "alias"),
        "top1_torque": count(torque, "top1"),
        "alias_group_torque": count(torque, "alias"),
        "top1_left": count(shown, "top1"),
        "alias_group_left": count(shown, "alias"),
        "absorbed": [
            row["rig"] for row in strong if row["left"] is not None and row["left"] < STRONG
        ],
        "top1_all": count(one, "top1"),
        "alias_group_all": count(one, "alias"),
        "both_named": count([row for row in two if row["strength"] >= STRONG], "top1"),
        "both_named_left": count([row for row in two if (row["left"] or 0.0) >= STRONG], "top1"),
        "both_named_beside": count([row for row in two if _beside(row) >= STRONG], "top1"),
        "both_named_all": count(two, "top1"),
        "false_alarms": count(nothing, "alarm"),
        "alarms": [row["rig"] for row in nothing if row["alarm"]],
        "refused": count(rows, "refused"),
        "right": rate(sum(map(right, scored)), len(scored)),
        "reliability": reliability(scored),
        "wrong_names": wrong_names(scored),
        "by_axis": by_axis(scored),
        "outside": {
            **count(placed, "right"),
            "named_confidently": sum(bool(row["confident"]) for row in outside),
        },
        "methods": methods(rows),
        "location": location(strong),
        "confusion": confusion(one),
        "power": power(one),
        "oracle_fraction": middle(one + two, "oracle_fraction"),
        "floor_fraction": middle(one + two, "floor_fraction"),
        "worse_than_baseline": worse(rows),
        "intervals": rate(sum(inside), len(inside)),
        "most_frequent_class": most_frequent(one),
        "seconds_each": statistics.median(row["seconds"] for row in rows) if rows else None,
        "baseline_seconds_each": statistics.median(row["baseline_seconds"] for row in rows)
        if rows
        else None,
    }


def _beside(row: Row) -> float:
    """Return the smaller of the remaining strengths of two effects, each computed with the other
    effect known.
    """
    return (
        0.0 if row["oracle"] is None else float(min(row["oracle"]["remaining_strength"].values()))
    )


def methods(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return the scores of the diagnosis and of each baseline method on the same trials.

    The alias group of a baseline method's effect is the effect alone. ``outside_named`` counts
    trials outside the catalogue on which an effect was identified; ``exact`` counts trials of the
    catalogue with no wrong and no missing effect.
    """
    said = {"diagnosis": [{**row, "named_any": bool(row["named"])} for row in rows]}
    for method in sorted({m for row in rows for m in row["baselines"]}):
        said[method] = [
            {
                "kind": row["kind"],
                "strength": row["strength"],
                "named_any": bool(row["baselines"].get(method, NONE)["named"]),
                **row["baselines"].get(method, NONE),
            }
            for row in rows
        ]
    return {method: _method(mine) for method, mine in said.items()}


def _method(rows: Sequence[Row]) -> dict[str, Any]:
    def of(kind: str, least: float = 0.0) -> list[Row]:
        return [row for row in rows if row["kind"] == kind and row["strength"] >= least]

    return {
        "top1": count(of("one", STRONG), "top1"),
        "alias_group": count(of("one", STRONG), "alias"),
        "top1_all": count(of("one"), "top1"),
        "both_named": count(of("two", STRONG), "top1"),
        "exact": count([*of("one", STRONG), *of("two", STRONG)], "exact"),
        "false_alarms": count(of("nothing"), "alarm"),
        "outside_named": count(of("outside"), "named_any"),
    }


def location(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return the shares, of the trials with a located mismatch, in which the diagnosis located the
    mismatch where the catalogue locates the effect.
    """
    found = [
        row["location"]
        for row in rows
        if row["location"] is not None and row["location"]["found"] is not None
    ]
    return {key: count(found, key) for key in ("equation", "coordinate", "place")}


def middle(rows: Sequence[Row], key: str) -> dict[str, Any]:
    """Return the median of the values under ``key`` that are not null, and the number of these
    values.
    """
    known = [row[key] for row in rows if row[key] is not None]
    return {"median": statistics.median(known) if known else None, "of": len(known)}


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return the number of trials by true effect and by first identified effect (or by verdict if
    no effect was identified).
    """
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        called = row["named"][0]["name"] if row["named"] else row["verdict"]
        table[row["effects"][0]][called] += 1
    return {name: dict(sorted(table[name].items())) for name in sorted(table)}


def power(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rates of detection and identification against strength, one entry for each band
    with trials.
    """
    bands = []
    for low, high in pairwise(EDGES):
        mine = [row for row in rows if low <= row["strength"] < high]
        if mine:
            detected, top1, alias = (count(mine, key) for key in ("alarm", "top1", "alias"))
            band = {"from": low, "to": None if high == float("inf") else high}
            bands.append({**band, "detected": detected, "top1": top1, "alias_group": alias})
    return bands


def worse(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the number of trials on which the correction increased the held-out error by more than
    the noise floor.
    """
    known = [
        row
        for row in rows
        if row["validate_final_rms"] is not None and row["validate_baseline_rms"] is not None
    ]
    margins = [(row, row["noise_floor_rms"] or 0.0) for row in known]
    return rate(
        sum(r["validate_final_rms"] > r["validate_baseline_rms"] + m for r, m in margins),
        len(known),
    )


def most_frequent(rows: Sequence[Row]) -> float | None:
    """Return the share of trials in which the most frequent effect of all trials is injected."""
    if not rows:
        return None
    return Counter(row["effects"][0] for row in rows).most_common(1)[0][1] / len(rows)
