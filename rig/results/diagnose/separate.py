"""Writes the experiment that splits an alias group as a sequence file within the limits of a
bench.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from identification.effects import EFFECTS
from identification.effects.effect import Separation
from rig.config.bench import Bench

TRAVEL_SHARE = 0.85
SPEED_SHARE = 0.5
WEIGHT_SHARE = 0.75
"""Shares of a bench's limits that an experiment uses."""
_LIGHT = 1.0 / 3.0
_SLOW_HZ = 0.1
_SPEED_STEPS = (0.1, 0.2, 0.4, 1.0)
_RESTS_S = (0.1, 0.5, 2.0, 8.0)
_STILL_DEG = 0.02
"""Amplitude, deg, at which a joint with friction stays at rest while its holding torque is
recorded.
"""


@dataclass(frozen=True)
class Room:
    """Part of a bench's limits that an experiment may use."""

    travel_deg: float
    speed_deg_s: float
    weight_kg: float

    @classmethod
    def of(cls, bench: Bench) -> Room:
        """Return the part of a bench's limits for an experiment, symmetric about zero."""
        limits = bench.limits
        per_kg = bench.machine.lever_ratio * bench.machine.gravity_m_s2
        return cls(
            TRAVEL_SHARE * max(min(limits.angle_max_deg, -limits.angle_min_deg), 0.0),
            SPEED_SHARE * limits.speed_deg_s,
            WEIGHT_SHARE * min(limits.weight_kg, limits.contact_force_N / per_kg),
        )

    def frequency(self, amplitude_deg: float, share: float = 1.0) -> float:
        """Return the frequency, Hz, at which a sine of this amplitude reaches a share of the speed
        limit.
        """
        return share * self.speed_deg_s / (2.0 * math.pi * amplitude_deg)


@dataclass(frozen=True)
class _Stage:
    name: str
    amplitude_deg: float
    frequency_Hz: float
    periods: float = 3.0
    weight_kg: float = 0.0
    repeats: int = 1
    settle_s: float = 0.5
    center_deg: float = 0.0

    def line(self) -> str:
        duration = max(self.periods / self.frequency_Hz, 4.0)
        stage = "loaded" if self.weight_kg else "unloaded"
        return (
            f"  - {{name: {self.name}, stage: {stage}, weight_kg: {self.weight_kg:.4g}, "
            f"tones: [{{amplitude_deg: {self.amplitude_deg:.4g}, frequency_Hz: "
            f"{self.frequency_Hz:.4g}}}], "
            f"duration_s: {duration:.4g}, repeats: {self.repeats}, settle_s: {self.settle_s:g}, "
            f"center_deg: {self.center_deg:.4g}}}"
        )


def _loads(room: Room) -> list[_Stage]:
    weights = (("unloaded", 0.0), ("light", _LIGHT * room.weight_kg), ("heavy", room.weight_kg))
    return [_Stage(name, room.travel_deg, _SLOW_HZ, weight_kg=weight) for name, weight in weights]


def _loads_and_speeds(room: Room) -> list[_Stage]:
    fast = room.frequency(0.5 * room.travel_deg)
    return [
        _Stage(f"{load}-{speed}", 0.5 * room.travel_deg, frequency, weight_kg=weight)
        for load, weight in (("unloaded", 0.0), ("heavy", room.weight_kg))
        for speed, frequency in (("slow", 0.1 * fast), ("fast", fast))
    ]


def _frequencies(room: Room) -> list[_Stage]:
    small = 0.1 * room.travel_deg
    top = room.frequency(small)
    return [
        _Stage("fast", small, top, periods=10.0),
        _Stage("half-as-fast", small, 0.5 * top, periods=10.0),
        _Stage("slow-loaded", small, 0.05 * top, weight_kg=room.weight_kg),
    ]


def _speeds(room: Room) -> list[_Stage]:
    return [
        _Stage(f"speed-{order}-{k}", room.travel_deg, room.frequency(room.travel_deg, share))
        for order, shares in (("rising", _SPEED_STEPS), ("falling", _SPEED_STEPS[::-1]))
        for k, share in enumerate(shares, 1)
    ]


def _slow(room: Room) -> list[_Stage]:
    amplitude = 0.2 * room.travel_deg
    return [
        _Stage(f"slow-{k}", amplitude, f, periods=2.0)
        for k, f in enumerate((0.02, 0.05, 0.1, 0.2), 1)
    ]


def _rests(room: Room) -> list[_Stage]:
    amplitude = 0.1 * room.travel_deg
    mixed = (_RESTS_S[2], _RESTS_S[0], _RESTS_S[3], _RESTS_S[1])
    return [
        _Stage(f"rest-{rest:g}s", amplitude, 0.25, periods=1.0, repeats=4, settle_s=rest)
        for rest in mixed
    ]


def _small_loops(room: Room) -> list[_Stage]:
    rests = (("short", 0.2), ("long", 8.0))
    return [
        _Stage(f"{size}-after-{rest}-rest", amplitude, 0.5, periods=4.0, repeats=2, settle_s=settle)
        for size, amplitude in (
            ("tiny", 0.002 * room.travel_deg),
            ("small", 0.02 * room.travel_deg),
        )
        for rest, settle in rests
    ]


def _travel(room: Room) -> list[_Stage]:
    slow = 0.3 * _SLOW_HZ
    return [
        _Stage("whole-travel", room.travel_deg, slow, periods=2.0),
        _Stage("whole-travel-loaded", room.travel_deg, slow, periods=2.0, weight_kg=room.weight_kg),
    ]


def _session(room: Room) -> list[_Stage]:
    slow, fast = room.frequency(room.travel_deg, 0.1), room.frequency(room.travel_deg)
    work = _Stage("work", room.travel_deg, fast, periods=120.0 * fast, weight_kg=room.weight_kg)
    pairs = [
        (
            _Stage(f"{when}-slow", room.travel_deg, slow, 2.0),
            _Stage(f"{when}-fast", room.travel_deg, fast, 5.0),
        )
        for when in ("cold", "warm", "rested")
    ]
    rested = _Stage("rested-slow", room.travel_deg, slow, 2.0, settle_s=300.0)
    return [*pairs[0], work, *pairs[1], rested, pairs[2][1]]


def _hold(room: Room) -> list[_Stage]:
    away = 0.6 * room.travel_deg
    stages = []
    for load, weight in (("unloaded", 0.0), ("heavy", room.weight_kg)):
        for side, center in (("above", away), ("below", -away)):
            stages.append(
                _Stage(
                    f"{load}-to-{side}",
                    0.2 * room.travel_deg,
                    _SLOW_HZ,
                    1.0,
                    weight,
                    center_deg=center,
                )
            )
            stages.append(
                _Stage(f"{load}-held-from-{side}", _STILL_DEG, 0.25, 2.0, weight, settle_s=1.0)
            )
    return [*stages, *_travel(room)[:1]]


def _after_hanging(room: Room) -> list[_Stage]:
    return [
        _Stage(f"loaded-{when}", room.travel_deg, _SLOW_HZ, 2.0, room.weight_kg, settle_s=settle)
        for when, settle in (("at-once", 0.1), ("after-a-minute", 60.0))
    ]


Recipe = Callable[[Room], list[_Stage]]
RECIPES: Mapping[Separation, Recipe] = {
    Separation.LOADS: _loads,
    Separation.LOADS_AND_SPEEDS: _loads_and_speeds,
    Separation.FREQUENCIES: _frequencies,
    Separation.SPEEDS: _speeds,
    Separation.SLOW: _slow,
    Separation.RESTS: _rests,
    Separation.SMALL_LOOPS: _small_loops,
    Separation.TRAVEL: _travel,
    Separation.SESSION: _session,
    Separation.HOLD: _hold,
    Separation.AFTER_HANGING: _after_hanging,
}
"""Kind of experiment to its stages within the limits of a bench."""


def separating_sequence(names: Sequence[str], bench: Bench) -> str | None:
    """Return a sequence file that splits an alias group on a bench, or None if no sequence can
    split the group.

    Args:
        names: The group, the likeliest first.
        bench: The bench, whose limits set the size of the experiment.
    """
    kinds = (EFFECTS[name].separation for name in names)
    recipes = [RECIPES[kind] for kind in kinds if kind is not None]
    room = Room.of(bench)
    if not recipes or room.travel_deg <= 0.0 or room.weight_kg <= 0.0:
        return None
    lines = [stage.line() for stage in recipes[0](room)]
    head = [
        f"# Splits {', '.join(names)}; sized by the limits of the bench {bench.name!r}.",
        "sequence: 1",
        f"name: split-{names[0]}",
        "stages:",
    ]
    return "\n".join([*head, *lines]) + "\n"
