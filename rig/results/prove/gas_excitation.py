"""Firings of a blind gas trial: six with role fit and two with role validate, which together
separate similar effects of the catalogue.

The firings contain constant throats early and late in a firing, steps between the smallest and the
largest throat, and sines and sweeps around the time constant of the chamber. The firings with role
validate repeat no other firing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from rig.config.sequence import raised_cosine
from rig.results.prove.excitation import CYCLE_S, Array

BURN_S = 20.0
MOVE_S = 0.25
"""Duration of a step of the valve, s."""


class GasExperiment(NamedTuple):
    """Plan of one firing: name of the file, role as in the campaign file, and valve angle commanded
    in each cycle, rad, shape (n,).
    """

    name: str
    role: Literal["fit", "validate"]
    command: Array


def steps(levels_deg: Sequence[float]) -> Array:
    """Return valve angles with a pause of equal length at each level, starting with the closed
    valve.
    """
    n, move = round(BURN_S / CYCLE_S), round(MOVE_S / CYCLE_S)
    rise = raised_cosine(np.arange(1, move + 1) * CYCLE_S, MOVE_S)
    out = np.zeros(n)
    for k, level in enumerate(levels_deg):
        begin, end = (round(n * j / len(levels_deg)) for j in (k, k + 1))
        before = out[begin - 1] if begin else 0.0
        out[begin:end] = level
        out[begin : begin + move] = before + (level - before) * rise
    return np.deg2rad(out)


def sweep(centre_deg: float, amplitude_deg: float, first_Hz: float, last_Hz: float) -> Array:
    """Return a sine whose frequency rises linearly, around an angle, with ramps to and from this
    angle.
    """
    t = np.arange(round(BURN_S / CYCLE_S)) * CYCLE_S
    phase = 2.0 * np.pi * (first_Hz * t + 0.5 * (last_Hz - first_Hz) * t**2 / BURN_S)
    window = raised_cosine(t, 1.0)
    return np.asarray(np.deg2rad(window * (centre_deg + amplitude_deg * np.sin(phase))))


_PLAN: tuple[tuple[str, Literal["fit", "validate"], Callable[[], Array]], ...] = (
    ("a", "fit", lambda: steps((2, 12, 20, 8, 28, 5, 16, 10, 24, 3))),
    ("b", "fit", lambda: steps((26, 6, 18, 3, 12))),
    ("c", "fit", lambda: sweep(14, 10, 0.1, 2.0)),
    ("d", "validate", lambda: steps((14, 3, 22, 9, 27, 6))),
    ("e", "fit", lambda: sweep(20, 7, 0.05, 1.2)),
    ("f", "fit", lambda: steps((4, 8, 4, 9))),
    ("g", "validate", lambda: sweep(15, 9, 0.3, 0.6)),
    ("h", "fit", lambda: steps((22, 11, 25, 7, 13, 21, 5, 17))),
)


@cache
def gas_experiments() -> tuple[GasExperiment, ...]:
    """Return the eight firings in the order of their execution."""
    return tuple(GasExperiment(name, role, command()) for name, role, command in _PLAN)
