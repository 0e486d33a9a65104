"""What a covering experiment visits that no recording has visited."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np

from rig.config.bench import load_bench
from rig.investigate.choice import Region, regions

LIMITS = load_bench("practical").value.limits
RATE = 500.0


def sine(amplitude_deg: float, hertz: float, mass: float = 0.0, seconds: float = 20.0) -> Any:
    """A view of a sine motion that ends with a rest of 1.5 s."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    w, a = 2.0 * math.pi * hertz, math.radians(amplitude_deg)
    rest = np.arange(0.0, 1.5, 1.0 / RATE)
    return SimpleNamespace(
        recording=SimpleNamespace(weight_mass=mass),
        angle=np.concatenate([a * np.sin(w * t), np.zeros_like(rest)]),
        velocity=np.concatenate([a * w * np.cos(w * t), np.zeros_like(rest)]),
        still=np.concatenate([np.zeros(len(t), bool), np.ones(len(rest), bool)]),
        rest_time=np.concatenate([np.zeros_like(t), rest]),
        step=1.0 / RATE,
    )


def of(found: frozenset[Region], coordinate: str) -> set[tuple[float, float]]:
    return {(sign, cell) for name, _, sign, cell in found if name == coordinate}


def test_regions_are_those_of_the_motion() -> None:
    width = (LIMITS.angle_max_deg - LIMITS.angle_min_deg) / 16.0
    found = regions([sine(2.5 * width, 0.1)], LIMITS)
    assert of(found, "angle") == {(s, c) for s in (-1.0, 1.0) for c in range(-3, 3)}
    top = math.floor(math.log2(2.5 * width * 0.2 * math.pi / LIMITS.speed_deg_s))
    assert max(c for _, c in of(found, "speed")) == top
    assert max(c for _, c in of(found, "rest")) == 0.0, "a rest of 1 to 2 s"
    assert {load for _, load, _, _ in found} == {None}
    loaded = regions([sine(2.5 * width, 0.1, 8.0)], LIMITS)
    assert {load for _, load, _, _ in loaded} == {6}
    assert not loaded & found


def test_a_wider_or_faster_motion_visits_more_and_the_same_one_nothing() -> None:
    once = regions([sine(5.0, 0.1)], LIMITS)
    assert regions([sine(5.0, 0.1, seconds=30.0)], LIMITS) == once
    assert of(regions([sine(20.0, 0.1)], LIMITS), "angle") > of(once, "angle")
    assert regions([sine(5.0, 0.8)], LIMITS) - once
