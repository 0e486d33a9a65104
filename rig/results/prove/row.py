"""Makes the row of one trial in the proof from its injected effects and its diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from identification.effects import EFFECTS
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
REFUSED = "refused"
"""Verdict of a trial that could not be diagnosed."""


def located(
    name: str, true: Mapping[str, float], diagnosis: Mapping[str, Any], recordings: Sequence[str]
) -> dict[str, Any]:
    """Score the location that a diagnosis states for one injected effect.

    Args:
        name: The injected effect.
        true: Parameters of the effect; ``recording`` counts from 1.
        diagnosis: Record of ``rig diagnose --json``; of several identified effects, the location of
            the first counts.
        recordings: Names of all recordings, in the order in which ``recording`` counts them.

    Returns:
        ``equation``: whether the mismatch is in the equation in which the effect shows (in the
        torque equation if the recordings lack this equation's channels); ``coordinate``:
        whether the mismatch is over the coordinate of the catalogue; ``place``: whether the
        mismatch is over this coordinate or an equivalent coordinate, or, for effects of one
        recording, whether the diagnosis lists this recording with at most one other recording;
        ``found``: the coordinate found. All four values are null if the diagnosis found no
        mismatch; the power curve shows these trials.
    """
    where = diagnosis["effects"][0]["where"] if diagnosis["effects"] else diagnosis["location"]
    if diagnosis["verdict"] in ("nothing_missing", REFUSED) or where is None:
        return {"equation": None, "coordinate": None, "place": None, "found": None}
    entry = EFFECTS[name]
    fitted = {fit["equation"] for fit in diagnosis["fits"]}
    shows_in = entry.shows_in if entry.shows_in in fitted else "torque"
    expected, found = entry.coordinate.split(":")[0], where["coordinate"]
    if entry.place is not None:
        at = round(true.get("recording", 0)) - 1
        own = recordings[at] if 0 <= at < len(recordings) else None
        place = own in where["recordings"] and len(where["recordings"]) <= 2
    else:
        place = found == expected or found in LIKE.get(expected, ())
    return {
        "equation": diagnosis["fit"]["equation"] == shows_in,
        "coordinate": found == expected,
        "place": place,
        "found": found,
    }


CONFIDENT = 0.9
"""Confidence above which an effect that is identified on a trial outside the catalogue counts as a
gross error.
"""
MOST_NAMED = 3
"""Number of effects of a baseline method, from its first, that count if two effects are injected; a
diagnosis identifies at most as many effects.
"""
WORTH = 0.05
"""Least reduction, over the noise, of the error on unused recordings by the oracle for which
diagnosis and oracle are compared.
"""
FAINT = 1e-12
NAMED = ("name", "alias_group", "confidence")
"""Values of an identified effect that a row holds."""
VERSION = 6
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

    Args:
        truth: The opened truth: ``rig``, ``kind``, ``effects`` and ``parameters``.
        strengths: Strength of the effects (rms change over noise) by channel.
        judgement: Judgement of the trial.
        oracle: Held-out errors with the true structure, or None if there is none.
        digest: Digest of the seal.
        floor: Residual of the nominal model on the reference simulation, by equation; empty if it
            is not known.
        recordings: Names of the recordings, in the order in which the truth counts them.

    Returns:
        A row; ``refused`` is the message if no diagnosis was possible, else null; ``top1``,
        ``alias``, ``exact`` and ``confident`` are null for kinds of trials to which they do not
        apply.
    """
    diagnosis = judgement.diagnosis
    names, kind = list(truth["effects"]), truth["kind"]
    found, verdict = list(diagnosis["effects"]), diagnosis["verdict"]
    left = left_over(judgement.left, floor)
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
        **_hits(kind, names, [(e["name"], *e["alias_group"]) for e in found]),
        "alarm": verdict not in ("nothing_missing", REFUSED),
        "refused": diagnosis.get("message"),
        "confident": any(e["confidence"] > CONFIDENT for e in found) if kind == "outside" else None,
        "baselines": {
            method: {"named": list(said), **_hits(kind, names, [(name,) for name in said])}
            for method, said in judgement.baselines.items()
        },
        "location": _location(truth, diagnosis, recordings),
        "parameters": _parameters(truth["effects"], found),
        "nominal": _nominal(truth["parameters"], diagnosis),
        **_held_out(diagnosis["fit"]),
        "oracle": None if oracle is None else dict(oracle),
        "oracle_fraction": None if oracle is None else _oracle_fraction(oracle, diagnosis["fits"]),
        "seconds": judgement.seconds,
        "baseline_seconds": judgement.baseline_seconds,
    }


def _location(
    truth: Mapping[str, Any], diagnosis: Mapping[str, Any], recordings: Sequence[str]
) -> dict[str, Any] | None:
    """Score the place of a single effect; return None for other kinds of trial."""
    if truth["kind"] != "one":
        return None
    ((name, true),) = truth["effects"].items()
    return located(name, true, diagnosis, recordings)


def _hits(kind: str, names: Sequence[str], said: Sequence[Sequence[str]]) -> dict[str, Any]:
    """Score effects, each with its alias group, by the same rules for every method."""
    alarm = {"alarm": bool(said), "top1": None, "alias": None, "exact": None}
    if kind not in ("one", "two"):
        return alarm
    counted = said[:1] if kind == "one" else said[:MOST_NAMED]
    return {
        **alarm,
        "top1": set(names) <= {group[0] for group in counted},
        "alias": set(names) <= {name for group in counted for name in group},
        "exact": set(names) == {group[0] for group in said},
    }


def _parameters(
    true: Mapping[str, Mapping[str, float]], found: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Return true and estimated parameters of the correctly identified effects."""
    rows: dict[str, Any] = {}
    for effect in found:
        for name, value in true.get(effect["name"], {}).items():
            estimate = effect["parameters"].get(name)
            if estimate is None:
                continue
            low, high = estimate["low"], estimate["high"]
            rows[f"{effect['name']}.{name}"] = {
                "true": value,
                "value": estimate["value"],
                "low": low,
                "high": high,
                "inside": None if low is None or high is None else low <= value <= high,
            }
    return rows


def _nominal(true: Mapping[str, float], diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """Return the relative errors of the nominal parameters in both models."""
    rows = {}
    for name, shift in diagnosis["parameter_shift"].items():
        if name in true and shift["before"] is not None and shift["after"] is not None:
            rows[name] = {
                "before": shift["before"] / true[name] - 1.0,
                "after": shift["after"] / true[name] - 1.0,
            }
    return rows


def _held_out(fit: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the errors on unused recordings, and how much of the way to the noise floor."""
    before, after, floor = (
        fit["validate_baseline_rms"],
        fit["validate_final_rms"],
        fit["noise_floor_rms"],
    )
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
