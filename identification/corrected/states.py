"""Computes responses of a series with memory: lag, time shift, Dahl friction, play, winding
heat.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from identification.numerics.arrays import Array


def lagged(series: Array, time: Array, time_s: float) -> Array:
    """Return the series after a first-order lag, in steady state at the start, linear between
    samples, shape (n,).
    """
    out = np.array(series, dtype=float)
    steps = np.diff(time)
    share = 1.0 - np.exp(-steps / time_s) if time_s > 0.0 else np.ones(len(out) - 1)
    rise = 1.0 - share * time_s / steps
    for k in range(1, len(out)):
        change = series[k] - series[k - 1]
        out[k] = out[k - 1] + share[k - 1] * (series[k - 1] - out[k - 1]) + rise[k - 1] * change
    return out


def advanced(series: Array, time: Array, time_s: float) -> Array:
    """Return the series shifted to earlier times by ``time_s``, with its end values held, shape
    (n,).

    Between two samples the series is the cubic through the four nearest samples; in the first and
    in the last interval, and beside a gap of the times, it is a straight line.
    """
    last = len(series) - 1
    place = np.interp(time + time_s, time, np.arange(last + 1.0))
    j = np.minimum(place.astype(int), last - 1)
    x = place - j
    before, here, after, later = (series[np.clip(j + k, 0, last)] for k in (-1, 0, 1, 2))
    bent = after - 2.0 * here + before
    more = later - 3.0 * after + 3.0 * here - before
    cubic = x * (x - 1.0) * (0.5 * bent + (x + 1.0) / 6.0 * more)
    steps = np.diff(time)
    own, earlier, next_ = (steps[np.clip(j + k, 0, last - 1)] for k in (0, -1, 1))
    even = np.maximum(np.abs(earlier - own), np.abs(next_ - own)) < 0.1 * own
    inside = (j >= 1) & (j < last - 1) & even
    return np.asarray(here + x * (after - here) + np.where(inside, cubic, 0.0))


def dahl_friction(angle: Array, level: Array, stiffness: float, start: float = 0.0) -> Array:
    """Return Dahl friction, a friction that reverses over a small travel: dF = k (1 - F sgn(dtheta)
    / level) dtheta, N m, shape (n,).

    ``start`` is the friction at the first sample.
    """
    force = min(max(start, -level[0]), level[0])
    out = np.full(len(angle), force)
    for k in range(1, len(angle)):
        travel = angle[k] - angle[k - 1]
        if travel != 0.0 and level[k] > 0.0:
            goal = level[k] if travel > 0.0 else -level[k]
            force = goal + (force - goal) * np.exp(-stiffness * abs(travel) / level[k])
        out[k] = force
    return out


def play(angle: Array, gap: float) -> Array:
    """Return the play operator of an angle: the lead of the driving side of a gap over its driven
    side, within +- gap/2, rad, shape (n,).
    """
    out = np.zeros(len(angle))
    for k in range(1, len(angle)):
        out[k] = min(max(out[k - 1] + angle[k] - angle[k - 1], -0.5 * gap), 0.5 * gap)
    return out


def mean_step(current: Array, knee: float) -> Array:
    """Return the mean of tanh(I / knee) over the period of each sample, for a current I that is
    linear in time, shape (n,).

    With a knee of 0 the function is a sharp step. The mean is needed because the current may change
    by more than the knee within one period when it reverses.
    """
    ends = 0.5 * (current[1:] + current[:-1])
    before, after = np.concatenate((current[:1], ends)), np.concatenate((ends, current[-1:]))
    change = after - before
    small = np.abs(change) < 1e-9
    if knee > 0.0:
        here = np.tanh(current / knee)
        sides = [knee * np.logaddexp(x / knee, -x / knee) for x in (before, after)]
    else:
        here = np.sign(current)
        sides = [np.abs(before), np.abs(after)]
    return np.where(small, here, (sides[1] - sides[0]) / np.where(small, 1.0, change))


def winding_rise(s: Any, m: Any, rise_K_per_W: float, time_s: float) -> Array:
    """Return the winding's temperature rise, K, shape (n,); it starts at the steady state of the
    recording's mean power.
    """
    loss = m["R"] * s["current"] ** 2
    before = float(np.mean(loss)) * (1.0 - np.exp(-s["run_time"][0] / time_s))
    series = np.concatenate(([before], loss[1:]))
    return rise_K_per_W * lagged(series, s["time"], time_s)
