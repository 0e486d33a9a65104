"""Experiments of a blind trial: thirteen recordings that together separate similar effects of the
catalogue.

The motions are large and small, slow and fast, with four weights. The trial has ramps from slow to
fast, rests of 0.1 to 8 s, loops below breakaway, and one experiment twice for the noise floor. In
one further experiment, a weight on the joint itself drives the motor, because the loss of the gear
is collinear with the nominal parameters if the load consists only of friction. The recordings with
role validate repeat no other recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.config.sequence import raised_cosine

Array = NDArray[np.float64]

CYCLE_S = 0.001
DURATION_S = 30.0
_RAMP_S = 1.0
_CORNER_S = 0.12
WIDE = np.deg2rad(28.0)


class FixedWeight(NamedTuple):
    """A declared weight that turns with the joint: torque -m g l sin(theta - zero)."""

    mass_kg: float
    length_m: float
    zero_rad: float


NOTHING_FIXED = FixedWeight(0.0, 0.0, 0.0)


class Experiment(NamedTuple):
    """Plan of one recording."""

    name: str
    role: Literal["fit", "validate"]
    weight_kg: float  # mass on the lever
    command: Array  # joint angle sent in each cycle, rad, shape (n,)
    # Weight on the joint; on a bench without lever, present in every recording.
    fixed: FixedWeight | None = None


def tones(*parts: tuple[float, float, float]) -> Array:
    """Return a sum of sines (deg, Hz, rad) with a smooth start and end."""
    t = _time()
    swing = np.zeros_like(t)
    for amplitude_deg, frequency_Hz, phase in parts:
        swing += np.deg2rad(amplitude_deg) * np.sin(2.0 * np.pi * frequency_Hz * t + phase)
    return np.asarray(_window(t) * swing)


def ramps(span_deg: float, speeds_rad_s: Sequence[float]) -> Array:
    """Return ramps between both ends of a span, one speed after another until the time is over.

    Each speed has an equal share of the time; at low speeds, in which this share does not suffice
    for the whole span, the ramps cover a part of it. Corners are rounded over 0.12 s, which keeps
    the torque of the fastest ramp within the drive's limit.
    """
    span = np.deg2rad(span_deg)
    share_s = (DURATION_S - 2.0 * _RAMP_S) / len(speeds_rad_s)
    pieces = [np.zeros(round(_RAMP_S / CYCLE_S))]
    for speed in speeds_rad_s:
        reach = min(span, 0.25 * speed * share_s)
        t = np.arange(round(share_s / CYCLE_S)) * CYCLE_S
        period_s = 4.0 * reach / speed
        turns = np.floor(share_s / period_s)
        phase = np.minimum(t / period_s, turns)
        pieces.append(reach * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase)))
    window = np.hanning(round(_CORNER_S / CYCLE_S) + 1)
    return _filled([np.convolve(np.concatenate(pieces), window / window.sum(), mode="same")])


def _dwells(
    rests_s: Sequence[float], step_deg: float, speed_rad_s: float, center_deg: float = 0.0
) -> Array:
    """Return moves back and forth, each after one of the rests."""
    pieces = [np.zeros(round(_RAMP_S / CYCLE_S))]
    at = 0.0
    stops = [np.deg2rad(center_deg + s * step_deg) for s in (1.0, -1.0)]
    for k, rest_s in enumerate(rests_s):
        to = stops[k % 2]
        n = round(0.5 * np.pi * abs(to - at) / speed_rad_s / CYCLE_S)
        pieces.append(np.full(round(rest_s / CYCLE_S), at))
        pieces.append(at + (to - at) * raised_cosine(np.arange(1, n + 1) * CYCLE_S, n * CYCLE_S))
        at = to
    return _filled(pieces)


def _small_loops(
    amplitudes_rad: Sequence[float], frequency_Hz: float, centers_deg: Sequence[float]
) -> Array:
    """Return growing loops around several angles, from below breakaway to above it."""
    pieces = [np.zeros(round(_RAMP_S / CYCLE_S))]
    share_s = (DURATION_S - 2.0 * _RAMP_S) / len(centers_deg)
    at = 0.0
    for center_deg in centers_deg:
        to = np.deg2rad(center_deg)
        n = round(1.0 / CYCLE_S)
        pieces.append(at + (to - at) * raised_cosine(np.arange(1, n + 1) * CYCLE_S, 1.0))
        at = to
        each_s = np.floor((share_s - 1.5) / len(amplitudes_rad) * frequency_Hz) / frequency_Hz
        t = np.arange(round(each_s / CYCLE_S)) * CYCLE_S
        pieces.extend(
            at + amplitude * np.sin(2.0 * np.pi * frequency_Hz * t) for amplitude in amplitudes_rad
        )
        pieces.append(np.full(round(0.3 / CYCLE_S), at))
    return _filled(pieces)


def _filled(pieces: list[Array]) -> Array:
    """Join pieces, cut or extend them to the recording's length, and come to rest at zero."""
    n = round(DURATION_S / CYCLE_S)
    path = np.concatenate(pieces)[:n]
    path = np.concatenate((path, np.full(n - len(path), path[-1])))
    return np.asarray(path * raised_cosine(DURATION_S - _time(), _RAMP_S))


def _time() -> Array:
    return np.asarray(np.arange(round(DURATION_S / CYCLE_S)) * CYCLE_S, dtype=np.float64)


def _window(t: Array) -> Array:
    return raised_cosine(t, _RAMP_S) * raised_cosine(DURATION_S - t, _RAMP_S)


def _mixed() -> Array:
    return tones((14.0, 0.13, 0.0), (5.0, 0.47, 1.0), (1.5, 1.9, 2.0), (0.4, 4.3, 0.5))


def _lively() -> Array:
    return tones((9.0, 0.31, 0.3), (4.0, 0.83, 1.1), (1.2, 2.3, 2.2), (0.3, 5.9, 0.7))


_PLAN: tuple[tuple[str, Literal["fit", "validate"], float, Callable[[], Array]], ...] = (
    ("a", "fit", 0.0, _mixed),
    ("b", "fit", 0.0, lambda: ramps(28.0, (1.2, 0.6, 0.3, 0.1, 0.04))),
    ("c", "validate", 0.0, lambda: tones((20.0, 0.21, 0.4), (4.0, 0.71, 0.0), (0.8, 3.1, 1.0))),
    ("d", "fit", 10.0, _lively),
    ("e", "fit", 30.6, lambda: tones((26.0, 0.11, 0.0), (1.0, 1.3, 0.5), (0.3, 4.7, 0.0))),
    ("f", "validate", 30.6, lambda: ramps(22.0, (0.8, 0.45, 0.2, 0.07))),
    (
        "g",
        "fit",
        0.0,
        lambda: _dwells((0.1, 0.1, 8.0, 0.2, 0.5, 4.0, 1.0, 0.1, 2.0, 0.2, 0.5), 5.0, 0.35),
    ),
    ("h", "fit", 0.0, lambda: _small_loops((1e-4, 2e-4, 4e-4, 1e-3, 3e-3), 2.0, (0.0, 9.0, -14.0))),
    (
        "i",
        "validate",
        10.0,
        lambda: _dwells((0.1, 3.0, 0.3, 0.3, 6.0, 0.1, 1.0, 1.0), 12.0, 0.5, -3.0),
    ),
    ("j", "fit", 20.0, lambda: ramps(26.0, (1.0, 0.5, 0.25, 0.12, 0.05))),
    ("k", "validate", 20.0, lambda: tones((17.0, 0.17, 1.2), (6.0, 0.53, 0.2), (0.5, 3.7, 2.0))),
    ("l", "fit", 0.0, _mixed),
)
_DRIVEN_BACK = Experiment(
    "m", "fit", 0.0, tones((10.0, 0.25, 0.0), (3.0, 0.6, 0.5)), FixedWeight(15.0, 0.1, -np.pi / 2.0)
)
"""Weight that exceeds most friction; a horizontal arm keeps the torque's sign."""


_FIXED = {
    0.0: FixedWeight(5.0, 0.1, 0.0),
    10.0: FixedWeight(10.0, 0.1, -0.8),
    20.0: FixedWeight(15.0, 0.1, 0.8),
    30.6: FixedWeight(15.0, 0.1, -1.4),
}
"""Weight that is fixed to the joint, instead of a weight on the lever."""


@cache
def experiments(gravity: bool = False) -> tuple[Experiment, ...]:
    """Return the experiments in order; the last repeats the first."""
    plan = tuple(Experiment(name, role, weight, command()) for name, role, weight, command in _PLAN)
    if gravity:
        plan = tuple(e._replace(weight_kg=0.0, fixed=_FIXED[e.weight_kg]) for e in plan)
    return (*plan[:-1], _DRIVEN_BACK, plan[-1])
