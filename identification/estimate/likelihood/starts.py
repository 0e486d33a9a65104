"""Start points of the searches: a grid of static limits and Stribeck speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.filter.likelihood import Point
from identification.filter.noise_level import deviance
from identification.model.parameters import LOAD_RISE, MC, SYSTEM_RISE

_SPEEDS = 6
_STATICS = 7
_CLIP = 10.0


def breakaway_starts(point: Point, coulomb: int, rise: int, speed: int) -> list[Point]:
    """Return start points from a grid of static limits and Stribeck speeds; a parameter that is not
    free keeps its value.

    The static limits of the grid are at or below the greatest torque before visible motion, because
    motion becomes visible some time after the breakaway.

    Returns:
        A point for every Stribeck speed with its likeliest static limit, likeliest first.
    """
    loaded = rise == LOAD_RISE
    fastest = max(
        float(np.max(np.abs(np.gradient(m.angle[::10], m.time[::10])))) for m in point.motions
    )
    speeds = np.array([point.vector[speed]])
    if speed in point.free:
        speeds = np.concatenate([speeds, np.geomspace(0.01, 0.35, _SPEEDS) * fastest])
    peaks = [m.peak_torque() for m in point.motions]
    best: dict[float, tuple[float, Point]] = {}
    for share in np.linspace(0.75, 1.0, _STATICS) if rise in point.free else (1.0,):
        p = point.vector.copy()
        if rise in point.free:
            limits = [
                (share * peak - (p[MC] + p[SYSTEM_RISE] if loaded else 0.0))
                / (float(np.median(m.breakaway_moment)) if loaded else 1.0)
                for m, peak in zip(point.motions, peaks, strict=True)
            ]
            p[rise] = float(np.median(limits)) - p[coulomb]
        if p[rise] < 0.0:
            continue
        limit = point.at(p)
        for omega_s in speeds:
            p = p.copy()
            p[speed] = omega_s
            start = replace(limit, vector=p)
            cost = deviance(*start.run(), _CLIP)
            if omega_s not in best or cost < best[omega_s][0]:
                best[omega_s] = (cost, start)
    return [start for _, start in sorted(best.values(), key=lambda found: found[0])]
