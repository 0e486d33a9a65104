"""Scores a proof: the row of each trial, and the figures of all rows."""

from __future__ import annotations

import math
import re
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from scipy.stats import beta

from identification.effects import EFFECTS
from rig.common.provenance import Provenance
from rig.results.prove.draw import Kind
from rig.results.prove.judge import Judgement
from rig.results.prove.simulate import left_over

LIKE: Mapping[str, frozenset[str]] = {
    "direction": frozenset({"speed", "torque"}),
    "current direction": frozenset({"direction", "speed", "torque"}),
    "load": frozenset({"torque"}),
    "torque": frozenset({"load"}),
    "time": frozenset({"temperature"}),
    "temperature": frozenset({"time"}),
    "time since reversal": frozenset({"travel since reversal"}),
    "travel since reversal": frozenset({"time since reversal"}),
    "torque rate": frozenset({"acceleration", "time since reversal", "travel since reversal"}),
}
"""Coordinates that are equivalent on blind trials to each coordinate of the catalogue: the signs of
speed and torque give the direction of motion and of the current, torque rises with the load, the
machine warms up with time, and the torque changes most with the acceleration and after reversals.
"""
_PIECE = re.compile(r"\[\d+\](?=( \(\d+\))?$)")  # number of a part between two gaps of a file
REFUSED = "refused"  # verdict of a trial that could not be diagnosed
NO_ALARM = ("nothing_missing", REFUSED)  # verdicts that do not report missing physics


def located(
    name: str, true: Mapping[str, float], diagnosis: Mapping[str, Any], recordings: Sequence[str]
) -> dict[str, Any]:
    """Score the location that a diagnosis states for one injected effect.

    Args:
        name: The injected effect.
        true: Parameters of the effect; ``recording`` counts from 1.
        diagnosis: Record of ``rig diagnose --json``; of several identified effects, the location of
            the first counts.
        recordings: Names of all files, in the order in which ``recording`` counts them. A file with
            gaps gives several recordings with this name and a number.

    Returns:
        ``equation``: whether the mismatch is in the equation in which the effect shows (in the
        torque equation if the recordings lack this equation's channels); ``coordinate``:
        whether the mismatch is over the coordinate of the catalogue; ``place``: whether the
        mismatch is over this coordinate or an equivalent coordinate, or, for effects of one
        file, whether the diagnosis lists recordings of this file and of at most one other file;
        ``found``: the coordinate found. All four values are null if the diagnosis found no
        mismatch; the power curve shows these trials.
    """
    where = diagnosis["effects"][0]["where"] if diagnosis["effects"] else diagnosis["location"]
    if diagnosis["verdict"] in NO_ALARM or where is None:
        return {"equation": None, "coordinate": None, "place": None, "found": None}
    entry = EFFECTS[name]
    fitted = {fit["equation"] for fit in diagnosis["fits"]}
    shows_in = entry.shows_in if entry.shows_in in fitted else "torque"
    expected, found = entry.coordinate.split(":")[0], where["coordinate"]
    if entry.place is not None:
        at = round(true.get("recording", 0)) - 1
        own = recordings[at] if 0 <= at < len(recordings) else None
        files = {n if n in recordings else _PIECE.sub("", n) for n in where["recordings"]}
        place = own in files and len(files) <= 2
    else:
        place = found == expected or found in LIKE.get(expected, ())
    return {
        "equation": diagnosis["fit"]["equation"] == shows_in,
        "coordinate": found == expected,
        "place": place,
        "found": found,
    }


CONFIDENT = 0.9  # confidence of a name outside the catalogue above which it is a gross error
MOST_NAMED = 3
"""Number of a baseline's effects that count for two injected; a diagnosis names as many."""
WORTH = 0.05  # least gain of the oracle, over the noise, for which the diagnosis is compared
FAINT = 1e-12
NAMED = ("name", "alias_group", "confidence")  # values of an identified effect that a row holds
VERSION = 8
"""Version of the rows and recordings; a proof that began with another version is not continued."""


def row_of(
    truth: Mapping[str, Any],
    strengths: Mapping[str, float],
    judgement: Judgement,
    oracle: Mapping[str, Any] | None,
    digest: str,
    floor: Mapping[str, float] = MappingProxyType({}),
    recordings: Sequence[str] = (),
) -> dict[str, Any]:
    """Score one trial's judgement against its truth.

    ``truth``: the opened truth: ``rig``, ``kind``, ``effects`` and ``parameters``. ``strengths``:
    strength of the effects (rms change over noise) by channel. ``oracle``: held-out errors with the
    true structure, or None if there is none. ``floor``: residual of the nominal model on the
    reference simulation, by equation; empty if it is not known. ``recordings``: names of the
    recordings, in the order in which the truth counts them.

    Returns:
        A row; ``refused`` is the message if no diagnosis was possible, else null; ``top1``,
        ``alias``, ``exact``, ``confident`` and ``probability`` are null for kinds of trials to
        which they do not apply.
    """
    diagnosis = judgement.diagnosis
    names, kind = list(truth["effects"]), truth["kind"]
    found, verdict = list(diagnosis["effects"]), diagnosis["verdict"]
    left, place = left_over(judgement.left, floor), None
    if kind == "one":
        ((name, true),) = truth["effects"].items()
        place = located(name, true, diagnosis, recordings)
    return {
        "rig": truth["rig"],
        "sha256": digest,
        "kind": kind,
        "effects": names,
        "strength": max(strengths.values(), default=0.0),
        "strength_by_channel": dict(strengths),
        "left": max(left.values(), default=None),
        "left_by_equation": left,
        "verdict": verdict,
        "named": [{key: e[key] for key in NAMED} for e in found],
        "p_value": diagnosis["p_value"],
        # A part of a mismatch outside the catalogue is no identification.
        **_hits(
            kind,
            names,
            [(e["name"], *e["alias_group"]) for e in found if verdict != "outside_catalogue"],
        ),
        "alarm": verdict not in NO_ALARM,
        "refused": diagnosis.get("message"),
        "confident": any(e["confidence"] > CONFIDENT for e in found) if kind == "outside" else None,
        "probability": _probability(names, found) if kind in ("one", "two") else None,
        "location": place,
        "parameters": _parameters(truth["effects"], found),
        "nominal": _nominal(truth["parameters"], diagnosis),
        **_held_out(diagnosis["fit"]),
        "oracle": None if oracle is None else dict(oracle),
        "oracle_fraction": None if oracle is None else _oracle_fraction(oracle, diagnosis["fits"]),
        "seconds": judgement.seconds,
    }


def _hits(kind: str, names: Sequence[str], said: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Score effects, each with its alias group."""
    if kind not in ("one", "two"):
        return {"top1": None, "alias": None, "exact": None}
    counted = said[:1] if kind == "one" else said[:MOST_NAMED]
    return {
        "top1": set(names) <= {group[0] for group in counted},
        "alias": set(names) <= {name for group in counted for name in group},
        "exact": set(names) == {group[0] for group in said},
    }


def _probability(names: Sequence[str], found: Sequence[Mapping[str, Any]]) -> float:
    """Return the mean of the greatest confidence in each injected effect, named or a rival."""
    given: dict[str, float] = defaultdict(float)
    for effect in found:
        for said in (effect, *effect.get("rivals", ())):
            given[said["name"]] = max(given[said["name"]], said["confidence"])
    return statistics.fmean(given[name] for name in names)


def _parameters(
    true: Mapping[str, Mapping[str, float]], found: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return true and estimated parameters of the correctly identified effects; a true angle is
    given in the turn of its estimate.
    """
    rows = {}
    for effect in found:
        given = true.get(effect["name"], {})
        angles = EFFECTS[effect["name"]].polar[1:] if effect["name"] in EFFECTS else ()
        for name, stated in given.items():
            each = effect["parameters"].get(name)
            if each is None:
                continue
            value, low, high = stated, each["low"], each["high"]
            if name in angles and each["value"] is not None:
                turn = 2.0 * math.pi
                value += turn * round((each["value"] - value) / turn)
            inside = None if None in (low, high) else low <= value <= high
            rows[f"{effect['name']}.{name}"] = {
                "true": value,
                "value": each["value"],
                "low": low,
                "high": high,
                "inside": inside,
            }
    return rows


def _nominal(true: Mapping[str, float], diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Return the relative errors of the nominal parameters in both models."""
    return {
        name: {
            "before": shift["before"] / true[name] - 1.0,
            "after": shift["after"] / true[name] - 1.0,
        }
        for name, shift in diagnosis["parameter_shift"].items()
        # A true value of zero has no relative error.
        if true.get(name) and None not in (shift["before"], shift["after"])
    }


def _held_out(fit: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the errors on unused recordings, and how much of the way to the noise floor."""
    keys = ("validate_baseline_rms", "validate_final_rms", "noise_floor_rms")
    before, after, floor = (fit[key] for key in keys)
    share = None
    if None not in (before, after, floor) and before - floor > FAINT:
        share = (before - after) / (before - floor)
    return {
        "validate_baseline_rms": before,
        "validate_final_rms": after,
        "noise_floor_rms": floor,
        "floor_fraction": share,
    }


def _oracle_fraction(oracle: Mapping[str, Any], fits: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the gain of the diagnosis over the oracle's, in the oracle's best equation."""
    mine = [
        f
        for f in fits
        if f["equation"] == oracle["equation"] and f["validate_baseline_rms"] is not None
    ]
    possible = oracle["baseline_rms"] - oracle["oracle_rms"]
    if not mine or possible <= WORTH * oracle["noise_rms"]:
        return None
    return float((mine[0]["validate_baseline_rms"] - mine[0]["validate_final_rms"]) / possible)


Row = Mapping[str, Any]
LEVEL = 0.95


def rate(hits: float, of: int) -> dict[str, Any]:
    """Return a share with its Clopper-Pearson interval at 95 %.

    Args:
        hits: Number of trials, or the sum of a value between 0 and 1 over the trials. The variance
            of such a value is at most that of a hit with the same mean, so that the interval of its
            mean is too wide rather than too narrow.
        of: Number of all trials.
    """
    tail = (1.0 - LEVEL) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, of - hits + 1))
    high = 1.0 if hits == of else float(beta.ppf(1.0 - tail, hits + 1, of - hits))
    return {"n": hits, "of": of, "share": hits / of if of else None, "low": low, "high": high}


BINS = 10  # number of bins of confidence between 0 and 1
PARTS = 3  # number of parts with equally many values into which a numeric axis is divided
FEW = 5  # number of different values of a numeric axis up to which each value is a part of its own


def names_given(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return every effect that a diagnosis named: trial, name, confidence, and whether the name is
    right.

    ``right``: the named effect is injected; ``right_group``: the named effect or another effect of
    its alias group is injected.
    """
    return [
        {
            "rig": row["rig"],
            "name": effect["name"],
            "confidence": effect["confidence"],
            "injected": list(row["effects"]),
            "right": effect["name"] in row["effects"],
            "right_group": bool({effect["name"], *effect["alias_group"]} & set(row["effects"])),
        }
        for row in rows
        for effect in row["named"]
    ]


def reliability(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the share of right names for each bin of confidence that has names."""
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
    """Return whether a verdict is right for the injected effects, or for their absence."""
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


PROVE_SCHEMA = "loadrig.prove/4"
RESULT_FILE = "prove.json"
STRONG = 3.0  # least strength of an effect that must be identified: rms change over noise


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
    shown = [row for row in one if (row["left"] or 0.0) >= STRONG]
    inside = [
        p["inside"] for row in rows for p in row["parameters"].values() if p["inside"] is not None
    ]
    placed = [{"right": row["verdict"] == "outside_catalogue"} for row in outside]
    return {
        "counts": {kind: len(by_kind[kind]) for kind in get_args(Kind)},
        "top1": count(strong, "top1"),
        "alias_group": count(strong, "alias"),
        "top1_left": count(shown, "top1"),
        "alias_group_left": count(shown, "alias"),
        "absorbed": [
            row["rig"] for row in strong if row["left"] is not None and row["left"] < STRONG
        ],
        "top1_all": count(one, "top1"),
        "alias_group_all": count(one, "alias"),
        "both_named": count([row for row in two if row["strength"] >= STRONG], "top1"),
        "both_named_left": count([row for row in two if (row["left"] or 0.0) >= STRONG], "top1"),
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
        "location": location(strong),
        "location_f1": location_f1(strong, nothing),
        "probability": rate(sum(row["probability"] for row in strong), len(strong)),
        "confusion": confusion(one),
        "oracle_fraction": middle(one + two, "oracle_fraction"),
        "floor_fraction": middle(one + two, "floor_fraction"),
        "worse_than_baseline": worse(rows),
        "intervals": rate(sum(inside), len(inside)),
        "seconds_each": statistics.median(row["seconds"] for row in rows) if rows else None,
    }


def location(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return how many located mismatches are where the catalogue locates the effect."""
    found = [
        row["location"]
        for row in rows
        if row["location"] is not None and row["location"]["found"] is not None
    ]
    return {key: count(found, key) for key in ("equation", "coordinate", "place")}


def location_f1(one: Sequence[Row], nothing: Sequence[Row]) -> dict[str, Any]:
    """Return precision, recall and F1 of the stated places, as arXiv 2606.23215 scores locations.

    A wrong place counts against both precision and recall, a missed effect against the recall, a
    false alarm against the precision. ``low`` and ``high`` are the F1 of the lower and of the upper
    limits of precision and recall.

    Args:
        one: Trials with one effect.
        nothing: Trials without an effect.
    """
    right = sum(bool(row["location"]["place"]) for row in one)
    stated = sum(row["location"]["found"] is not None for row in one)
    precision = rate(right, stated + sum(row["alarm"] for row in nothing))
    recall = rate(right, len(one))

    def f1(end: str) -> float:
        p, r = precision[end] or 0.0, recall[end] or 0.0
        return float(2.0 * p * r / (p + r)) if p + r else 0.0

    return {
        "precision": precision,
        "recall": recall,
        "f1": f1("share"),
        "low": f1("low"),
        "high": f1("high"),
    }


def middle(rows: Sequence[Row], key: str) -> dict[str, Any]:
    """Return the median of the values under ``key`` that are not null, and their number."""
    known = [row[key] for row in rows if row[key] is not None]
    return {"median": statistics.median(known) if known else None, "of": len(known)}


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return the number of trials by true effect and by first name, or else verdict; the part of a
    mismatch outside the catalogue is no name.
    """
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        outside = row["verdict"] == "outside_catalogue"
        called = row["verdict"] if outside or not row["named"] else row["named"][0]["name"]
        table[row["effects"][0]][called] += 1
    return {name: dict(sorted(table[name].items())) for name in sorted(table)}


def worse(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the trials whose held-out error grew by more than the noise floor."""
    pairs = [
        (row["validate_final_rms"], row["validate_baseline_rms"], row["noise_floor_rms"] or 0.0)
        for row in rows
        if None not in (row["validate_final_rms"], row["validate_baseline_rms"])
    ]
    return rate(sum(after > before + floor for after, before, floor in pairs), len(pairs))
