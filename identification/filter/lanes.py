"""Computes motion segments side by side, one in each lane of an array, so that one processor
instruction computes several segments.

All numbers of all lanes are in one flat array, each quantity in a row of ``LANES`` places; with one
array the compiler knows that the rows do not overlap. A loop over the lanes has no branches. The
result of a lane does not depend on the other lanes. A lane whose segment has ended takes
integration steps of length zero, which do not change its state.
"""

from __future__ import annotations

import math

from identification.filter.segment_table import (
    ANGLE,
    BEFORE,
    DIRECTION,
    EXTRA_INERTIA,
    FIRST,
    LAST,
    MOMENT,
    QUANTISATION,
    REST,
    SLOPE,
    STEPS,
    TIME,
    TORQUE,
    TORQUE_RATE,
    UNSURE,
)
from identification.model.parameters import INERTIA
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled, inlined

LANES = 32
"""Length of a row: the greatest number of segments that are computed side by side."""
AT_ONCE = 8
"""Number of lanes that the widest processor instruction computes; loops run over a multiple of this
number.
"""
L_ANGLE, L_OMEGA, L_P11, L_P12, L_P22, L_HIDDEN, L_P13, L_P23, L_P33 = (LANES * k for k in range(9))
"""Places of the state: angle, rad, and speed, rad/s; their covariance; the correlated torque noise,
N m, its covariances with angle and speed, and its variance.
"""
L_SIDE, L_INVERSE, L_READING_NOISE, L_STAYING = (LANES * k for k in range(9, 13))
"""Places of the segment: direction; inverse of the inertia; variance of the error of an angle
reading; and the part of this variance whose error is equal in all readings at rest.
"""
L_LENGTH, L_STEPS, L_NOW, L_MIDDLE, L_TORQUE, L_SLOPE, L_MOMENT, L_DIFFUSION = (
    LANES * k for k in range(13, 21)
)
"""Places of the sample period: length and number of the integration steps; start of the next
integration step; middle of the period; torque, rate of change of the torque, and contact moment;
growth of the variance of the speed.
"""
L_MOVED, L_SHARE, L_ANSWER, L_UNSURE, L_ERROR, L_VARIANCE = (LANES * k for k in range(21, 27))
"""Places of the reading: whether the breakaway is within the period; share of the period after the
breakaway; measured angle; variance that is added to the variance of the speed; innovation; variance
of the innovation.
"""
L_B, L_C, L_GROWTH = (LANES * k for k in range(27, 30))
"""Places of the values b, c and growth of one integration step, for the correlated torque noise."""
WORKSPACE = 30 * LANES

WHITE, ANGLE_NOISE, CORRELATED, CORRELATION_TIME = range(4)
"""Indices of the noise vector: white torque noise, N m rms; noise of the angle beyond quantisation,
rad rms; correlated torque noise, N m rms; correlation time of the latter, s.
"""
LEAST_SPEED = 1e-7
_SLIP = 0.7
"""Mean square difference between a random walk that is reflected at zero and a free random walk,
under a drift that rises through zero, in natural units (M21); a test simulates this constant.
"""
_FORGOTTEN = math.pi**2 / 3.0
"""Exponent of the share of the quantisation error that is the same in all readings despite noise of
the angle (M20). Averaged over noise of variance v, the first harmonic of the quantisation error
falls by exp(-(2 pi)^2 v / (12 q)), where q is a twelfth of the squared encoder step (Widrow, IRE
Trans. Circuit Theory 3 (1956) 266).
"""


@compiled
def slip_variance(noise: float, period: float, rise: float, inertia: float) -> float:
    """Return the mean square speed that noise causes before the mean torque reaches the static
    limit, (rad/s)^2 (M21).

    At rest friction balances every backward torque, so that noise moves the joint forward only. The
    speed of the joint is a random walk that is reflected at zero, with the drift rate ``rise`` t /
    ``inertia`` (``rise`` in N m/s). The time t is zero when the mean torque reaches the static
    limit. Random walk and drift are of equal size after the time (noise^2 period / rise^2)^(1/3).
    """
    diffusion = noise * noise * period
    alike = math.pow(diffusion / (rise * rise), 1.0 / 3.0)
    return _SLIP * diffusion * alike / (inertia * inertia)


@inlined
def whole(active: int) -> int:
    """Return ``active`` rounded up to the number of lanes that are computed."""
    return (active + AT_ONCE - 1) // AT_ONCE * AT_ONCE


@compiled
def started(segments: Array, samples: Array, noise: Array, p: Array, lanes: Array) -> None:
    """Start one segment in each lane at its angle of rest.

    The error of the angle at rest is at least the quantisation error, however many readings were
    taken.

    Args:
        segments: Segments of the lanes, shape (m, 7), at most ``LANES``; columns of
            :mod:`identification.filter.segment_table`. The remaining lanes repeat the last segment.
        samples: Table of samples, shape (n, 8).
        noise: Noise vector with indices ``WHITE`` to ``CORRELATION_TIME``, shape (4,). The torque
            noise enters the speed divided by the trial inertia: the true torque is unknown, and
            using the measured torque as exact would bias J.
        p: Vector of :mod:`identification.model.parameters`.
        lanes: Workspace, shape (WORKSPACE,).
    """
    for lane in range(LANES):
        s = segments[min(lane, len(segments) - 1)]
        first = int(s[FIRST])
        inertia = p[INERTIA] + s[EXTRA_INERTIA]
        known = noise[ANGLE_NOISE] * noise[ANGLE_NOISE]
        lanes[L_SIDE + lane], lanes[L_INVERSE + lane] = s[DIRECTION], 1.0 / inertia
        lanes[L_READING_NOISE + lane] = s[QUANTISATION] + known
        lanes[L_STAYING + lane] = s[QUANTISATION] * math.exp(-_FORGOTTEN * known / s[QUANTISATION])
        lanes[L_ANGLE + lane], lanes[L_OMEGA + lane] = s[REST], s[DIRECTION] * LEAST_SPEED
        lanes[L_P11 + lane], lanes[L_P12 + lane] = s[QUANTISATION] + known, 0.0
        lanes[L_P22 + lane] = slip_variance(
            noise[WHITE], samples[first, TIME] - samples[first, BEFORE], s[TORQUE_RATE], inertia
        )
        lanes[L_HIDDEN + lane], lanes[L_P13 + lane], lanes[L_P23 + lane] = 0.0, 0.0, 0.0
        lanes[L_P33 + lane] = noise[CORRELATED] * noise[CORRELATED]


@inlined
def still_active(segments: Array, active: int, k: int) -> int:
    """Return how many of the ``active`` first segments have a sample number ``k``; the segments are
    sorted by length, the longest first.
    """
    while active > 0 and k >= int(segments[active - 1, LAST] - segments[active - 1, FIRST]):
        active -= 1
    return active


@compiled
def loaded(
    segments: Array, begins: Array, samples: Array, k: int, active: int, noise: Array, lanes: Array
) -> int:
    """Load sample number ``k`` of each segment into its lane; return the greatest number of
    integration steps.

    Args:
        segments: Segments of the lanes.
        begins: Breakaway times, s, shape (m,).
        samples: Table of samples, shape (n, 8).
        k: Number of the sample in its segment, from zero.
        active: Number of lanes whose segment has a sample ``k``; all other lanes get integration
            steps of length zero.
        noise: Noise vector, shape (4,).
        lanes: Workspace, shape (WORKSPACE,).
    """
    most = 0.0
    for lane in range(active):
        s = samples[int(segments[lane, FIRST]) + k]
        time, before = s[TIME], s[BEFORE]
        start, period = max(begins[lane], before), time - before
        moving = start < time
        inverse = lanes[L_INVERSE + lane]
        steps = s[STEPS] if moving else 0.0
        lanes[L_STEPS + lane] = steps
        lanes[L_LENGTH + lane] = (time - start) / s[STEPS]
        lanes[L_NOW + lane], lanes[L_MIDDLE + lane] = start, 0.5 * (time + before)
        lanes[L_TORQUE + lane], lanes[L_SLOPE + lane] = s[TORQUE], s[SLOPE]
        lanes[L_MOMENT + lane] = max(s[MOMENT], 0.0)
        lanes[L_DIFFUSION + lane] = noise[WHITE] * noise[WHITE] * period * (inverse * inverse)
        lanes[L_MOVED + lane] = 1.0 / period if moving and begins[lane] > before else 0.0
        lanes[L_SHARE + lane] = (time - start) / period if moving else 0.0
        lanes[L_ANSWER + lane] = s[ANGLE]
        lanes[L_UNSURE + lane] = s[UNSURE] if moving else 0.0
        most = max(most, steps)
        if noise[CORRELATED] > 0.0 and moving:
            kept = math.exp(-period / noise[CORRELATION_TIME])
            fresh = (1.0 - kept * kept) * noise[CORRELATED] * noise[CORRELATED]
            lanes[L_HIDDEN + lane] *= kept
            lanes[L_P13 + lane] *= kept
            lanes[L_P23 + lane] *= kept
            lanes[L_P33 + lane] = kept * kept * lanes[L_P33 + lane] + fresh
    for lane in range(active, whole(active)):
        lanes[L_STEPS + lane], lanes[L_SHARE + lane], lanes[L_UNSURE + lane] = 0.0, 0.0, 0.0
    return int(most)
