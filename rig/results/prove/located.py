"""Scores whether the diagnosis found the mismatch where the catalogue locates the injected
effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from identification.effects import EFFECTS

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
    name: str,
    true: Mapping[str, float],
    diagnosis: Mapping[str, Any],
    recordings: Sequence[str],
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
