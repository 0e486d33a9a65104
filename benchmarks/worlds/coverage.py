"""States which parts of the axes of worlds a proof does not cover."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from benchmarks.worlds.draw import LOADS
from benchmarks.worlds.machines import (
    HOST_RATES_HZ,
    LARGEST_N_M,
    LEAST_GAIN_HZ,
    LINEAR_N,
    LOG_RATES_HZ,
    LOOP_RATES_HZ,
    LOOPS,
    MOST_GAIN_HZ,
    SMALLEST_N_M,
)
from benchmarks.worlds.motion import MOTIONS
from rig.results.prove.truth import Axis

Parts = frozenset[Axis]
WORDS: Mapping[str, Parts] = {
    "machine": frozenset(LOADS),
    "load": frozenset(load for loads in LOADS.values() for load in loads),
    "loop": frozenset(LOOPS),
    "loop_Hz": frozenset(float(r) for r in LOOP_RATES_HZ),
    "host_Hz": frozenset(float(r) for r in HOST_RATES_HZ),
    "feedforward": frozenset({True, False}),
    "log_Hz": frozenset(float(r) for r in LOG_RATES_HZ),
    "current": frozenset({"sampled", "averaged", "filtered"}),
    "voltage": frozenset({"commanded", "measured", "absent"}),
    "clock": frozenset({True, False}),
    "starts": frozenset({"at rest", "moving"}),
    "friction": frozenset({"flat", "falls"}),
    "encoder": frozenset({"motor", "joint", "motor and joint"}),
    "jitters": frozenset({True, False}),
    "flickers": frozenset({True, False}),
    "excitation": frozenset(MOTIONS),
    "gain": frozenset({"low", "high"}),
    "size of a joint's machine": frozenset({"small", "large"}),
    "size of a carriage's machine": frozenset({"small", "large"}),
}
"""Parts of each axis."""


def parts_of(axes: Mapping[str, Axis]) -> dict[str, set[Axis]]:
    """Return the parts of the axes that one world covers.

    Args:
        axes: The ``axes`` in the truth of the world.
    """
    found: dict[str, set[Axis]] = {
        name: {value} & WORDS[name] for name, value in axes.items() if name in WORDS
    }
    found["encoder"] = {" and ".join(w for w in ("motor", "joint") if w in str(axes["encoders"]))}
    found["jitters"] = {bool(axes["jitter"])}
    found["flickers"] = {bool(axes["flicker"])}
    found["excitation"] = set(str(axes["motion"]).split(", "))
    middle = math.sqrt(LEAST_GAIN_HZ * MOST_GAIN_HZ)
    found["gain"] = {"high" if _number(axes["gain_Hz"]) > middle else "low"}
    for name, key, ends in (
        ("size of a joint's machine", "peak_Nm", (SMALLEST_N_M, LARGEST_N_M)),
        ("size of a carriage's machine", "peak_N", LINEAR_N),
    ):
        if key in axes:
            large = _number(axes[key]) > math.sqrt(ends[0] * ends[1])
            found[name] = {"large" if large else "small"}
    return found


def uncovered(worlds: Iterable[Mapping[str, Axis]]) -> dict[str, Sequence[Axis]]:
    """Return the parts of each axis that no world covers; axes that are covered are left out."""
    seen: dict[str, set[Axis]] = {name: set() for name in WORDS}
    for axes in worlds:
        for name, parts in parts_of(axes).items():
            seen[name] |= parts
    return {
        name: sorted(parts - seen[name], key=str)
        for name, parts in WORDS.items()
        if parts - seen[name]
    }


def _number(value: Axis) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
