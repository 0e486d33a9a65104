"""One rig's line of the proof: what it hid beside what the diagnosis said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

CONFIDENT = 0.9
"""A name given with more confidence than this to an effect outside the catalogue counts as a gross error."""
FAINT = 1e-12


def row_of(
    truth: Mapping[str, Any], strengths: Mapping[str, float], diagnosis: Mapping[str, Any], digest: str, seconds: float
) -> dict[str, Any]:
    """Score one diagnosis against the truth.

    Args:
        truth: As unsealed: ``rig``, ``kind``, ``effects`` and ``parameters``.
        strengths: Channel to rms change over noise.
        diagnosis: As ``rig diagnose --json`` says in the contract.
        digest: Of the seal.
        seconds: Spent on the diagnosis.

    Returns:
        A row; ``top1``, ``alias`` and ``confident`` are null where the kind of rig gives them no meaning.
    """
    names = list(truth["effects"])
    found = list(diagnosis["effects"])
    verdict = diagnosis["verdict"]
    single = truth["kind"] == "one"
    first = found[:1] if single else found
    named = {effect["name"] for effect in first}
    grouped = named.union(*(effect["alias_group"] for effect in first))
    catalogued = truth["kind"] in ("one", "two")
    return {
        "rig": truth["rig"],
        "sha256": digest,
        "kind": truth["kind"],
        "effects": names,
        "strength": max(strengths.values(), default=0.0),
        "strength_by_channel": dict(strengths),
        "verdict": verdict,
        "named": [
            {"name": e["name"], "alias_group": list(e["alias_group"]), "confidence": e["confidence"]} for e in found
        ],
        "p_value": diagnosis["p_value"],
        "alarm": verdict != "nothing_missing",
        "top1": set(names) <= named if catalogued else None,
        "alias": set(names) <= grouped if catalogued else None,
        "confident": any(e["confidence"] > CONFIDENT for e in found) if truth["kind"] == "outside" else None,
        "parameters": _parameters(truth["effects"], found),
        "nominal": _nominal(truth["parameters"], diagnosis),
        **_held_out(diagnosis["fit"]),
        "seconds": seconds,
    }


def _parameters(true: Mapping[str, Mapping[str, float]], found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return true and estimated parameters of the effects that were named rightly."""
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
    """Return the nominal parameters' errors, as shares of their values, before and after the correction."""
    rows = {}
    for name, shift in diagnosis["parameter_shift"].items():
        if name in true and shift["before"] is not None and shift["after"] is not None:
            rows[name] = {
                "before": shift["before"] / true[name] - 1.0,
                "after": shift["after"] / true[name] - 1.0,
            }
    return rows


def _held_out(fit: Mapping[str, Any]) -> dict[str, float | None]:
    """Return held-out errors, and the share of what could be gained that was.

    What could be gained ends at the noise floor; no model fitted to the same data gets below it but by chance.
    """
    before, after, floor = fit["validate_baseline_rms"], fit["validate_final_rms"], fit["noise_floor_rms"]
    share = None
    if None not in (before, after, floor) and before - floor > FAINT:
        share = (before - after) / (before - floor)
    return {
        "validate_baseline_rms": before,
        "validate_final_rms": after,
        "noise_floor_rms": floor,
        "oracle_fraction": share,
    }
