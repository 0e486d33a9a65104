"""Draws commanded motions: shapes without scale, scaled into the limits of the machine's travel,
speed and acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.worlds.world import COMMAND_S, Array

SMOOTHED_S = 0.12
EASED_S = 0.6
SLOWER = (1.0, 0.6, 0.35, 0.2)
"""Factors on the speed of a motion that are tried until the acceleration permits a useful
travel.
"""
WORTH = 0.3
"""Least share of the travel that a useful motion has."""
Shape = Callable[[np.random.Generator, Array], Array]
"""Function of (generator, times) that returns a path without scale."""


class Reach(NamedTuple):
    """Limits of a command: travel in rad, speed in rad/s, acceleration in rad/s^2."""

    travel: float
    speed: float
    acceleration: float


def command(
    rng: np.random.Generator, motion: str, duration_s: float, lead_s: float, reach: Reach
) -> Array:
    """Draw the command of one recording, which begins at rest at zero.

    Args:
        rng: Generator.
        motion: Name of a shape.
        duration_s: Length of the log.
        lead_s: Time before the log begins.
        reach: Limits of the command; the drawn scale uses 55 to 100 % of the tightest limit.
    """
    t: Array = np.arange(round((duration_s + lead_s) / COMMAND_S), dtype=np.float64) * COMMAND_S
    seed, share = int(rng.integers(1 << 62)), rng.uniform(0.55, 1.0)
    best, farthest = np.zeros(len(t)), 0.0
    for slower in SLOWER:
        path = _smooth(MOTIONS[motion](np.random.default_rng(seed), t * slower), slower)
        path = (path - path[0]) * _eased(t)
        speed = np.gradient(path, COMMAND_S)
        most = (np.abs(x).max() for x in (path, speed, np.gradient(speed, COMMAND_S)))
        scale = min(limit / max(m, 1e-12) for limit, m in zip(reach, most, strict=True))
        # At a low speed factor, all steps may lie after the end of the recording.
        if (far := float(scale * np.abs(path).max())) > farthest:
            best, farthest = path * scale * share, far
        if farthest > WORTH * reach.travel:
            break
    return np.asarray(best)


def _smooth(path: Array, slower: float) -> Array:
    """Return a path with round corners."""
    window = np.hanning(round(SMOOTHED_S / slower / COMMAND_S) + 3)[1:-1]
    padded = np.pad(path, len(window) // 2, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")[: len(path)]


def _eased(t: Array) -> Array:
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(t / EASED_S, 0.0, 1.0)))


def _sine(rng: np.random.Generator, t: Array) -> Array:
    frequency_Hz = np.exp(rng.uniform(np.log(0.12), np.log(1.2)))
    return np.asarray(np.sin(2.0 * np.pi * frequency_Hz * t + rng.uniform(-np.pi, np.pi)))


def _several(rng: np.random.Generator, t: Array) -> Array:
    count = int(rng.integers(2, 6))
    frequencies = np.exp(rng.uniform(np.log(0.1), np.log(4.0), count))
    parts = [
        np.sin(2.0 * np.pi * f * t + rng.uniform(-np.pi, np.pi)) / (0.15 + f) for f in frequencies
    ]
    return np.asarray(np.sum(parts, axis=0))


def _chirp(rng: np.random.Generator, t: Array) -> Array:
    low, high = np.exp(rng.uniform(np.log((0.08, 1.0)), np.log((0.3, 5.0))))
    if rng.uniform() < 0.5:
        low, high = high, low
    rate = np.log(high / low) / t[-1]
    phase = 2.0 * np.pi * low * np.expm1(rate * t) / rate
    return np.asarray(np.sin(phase) / (0.1 + low * np.exp(rate * t)))


def _steps(rng: np.random.Generator, t: Array) -> Array:
    held_s = rng.uniform(0.25, 2.0)
    levels = rng.uniform(-1.0, 1.0, int(t[-1] / held_s) + 2)
    return np.asarray(levels[(t / held_s).astype(int)])


def _ramps(rng: np.random.Generator, t: Array) -> Array:
    path, at, level, turn = np.zeros_like(t), 0.0, 0.0, float(rng.choice((-1.0, 1.0)))
    while at < t[-1]:
        speed = np.exp(rng.uniform(np.log(0.03), np.log(1.2)))
        goal = float(
            np.clip(turn * rng.uniform(0.4, 1.0), level - 4.0 * speed, level + 4.0 * speed)
        )
        took = max(abs(goal - level) / speed, 0.05)
        inside = (t >= at) & (t < at + took)
        path[inside] = level + (goal - level) * (t[inside] - at) / took
        at, level, turn = at + took, goal, -turn
    return path


def _pick_and_place(rng: np.random.Generator, t: Array) -> Array:
    """Return moves with a smooth acceleration between a few places, with a rest at each place."""
    places, path = rng.uniform(-1.0, 1.0, int(rng.integers(2, 5))), np.zeros_like(t)
    at, level, k = 0.0, 0.0, 0
    while at < t[-1]:
        goal, took = float(places[k % len(places)]), rng.uniform(0.4, 1.5)
        s = np.clip((t - at) / took, 0.0, 1.0)
        later = t >= at
        shape = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        path[later] = level + (goal - level) * shape[later]
        at, level, k = at + took + rng.uniform(0.1, 2.5), goal, k + 1
    return path


def _random(rng: np.random.Generator, t: Array) -> Array:
    corner = 2.0 * np.pi * np.exp(rng.uniform(np.log(0.2), np.log(2.0)))
    spectrum = np.fft.rfft(rng.standard_normal(len(t)))
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(t), COMMAND_S)
    return np.asarray(np.fft.irfft(spectrum / (1.0 + (omega / corner) ** 4), len(t)))


MOTIONS: Mapping[str, Shape] = {
    "sine": _sine,
    "several sines": _several,
    "chirp": _chirp,
    "steps": _steps,
    "ramps": _ramps,
    "pick and place": _pick_and_place,
    "random": _random,
}
"""Shapes of motions by name."""
