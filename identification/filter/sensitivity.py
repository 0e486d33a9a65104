"""Derivatives of the Kalman filter's innovations and of their standard deviations.

The derivatives are with respect to parameters and breakaway times. The recursion of
:mod:`identification.filter.kalman`, M16 to M21, is differentiated step by step in forward mode
(Griewank and Walther, Evaluating Derivatives, 2nd ed., 3.1). Exponentials and divisions are
computed once for all directions of differentiation.
"""

from __future__ import annotations

import numpy as np

from identification.filter.kalman import compare, correct, predict
from identification.filter.lanes import (
    CORRELATED,
    CORRELATION_TIME,
    L_INVERSE,
    L_P22,
    L_SHARE,
    L_VARIANCE,
    LANES,
    WORKSPACE,
    loaded,
    started,
    still_active,
    whole,
)
from identification.filter.segment_table import BEFORE, FIRST, LAST, TIME
from identification.filter.tangents import (
    GAINS,
    T_ANGLE,
    T_HIDDEN,
    T_P11,
    T_P13,
    T_P22,
    T_P23,
    T_P33,
    TANGENTS,
    correct_tangents,
    factors,
    step,
    step_hidden,
)
from identification.model.parameters import INERTIA
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled


@compiled
def _started(tangents: Array, seeds: Array, lanes: Array) -> None:
    """Set the derivatives of the state at the start of a segment, where the variance of the speed
    depends on the inertia (M21).
    """
    tangents[:] = 0.0
    for j in range(len(seeds)):
        for lane in range(LANES):
            by_inertia = -2.0 * lanes[L_P22 + lane] * lanes[L_INVERSE + lane]
            tangents[j, T_P22 + lane] = by_inertia * seeds[j, INERTIA]


@compiled
def _forgotten(tangents: Array, lanes: Array, lane: int, kept: float) -> None:
    """Multiply the derivatives of the correlated torque noise of a lane in motion by ``kept``."""
    if lanes[L_SHARE + lane] > 0.0:
        for d in tangents:
            d[T_HIDDEN + lane] *= kept
            d[T_P13 + lane] *= kept
            d[T_P23 + lane] *= kept
            d[T_P33 + lane] *= kept * kept


@compiled
def sensitivities(
    segments: Array,
    begins: Array,
    samples: Array,
    noise: Array,
    p: Array,
    seeds: Array,
    errors: Array,
    deviations: Array,
) -> None:
    """Fill ``errors`` with the derivatives of the innovations of every segment, and ``deviations``
    with the derivatives of the logarithms of their standard deviations.

    Args:
        segments: Table of motion segments, the longest first, as for
            :func:`identification.filter.kalman.innovations`.
        begins: Breakaway time of each segment, s, shape (m,).
        samples: Table of samples, shape (n, 8).
        noise: Noise vector, shape (4,), which is constant.
        p: Vector of :mod:`identification.model.parameters`.
        seeds: Directions of differentiation, shape (d, SEEDS): derivative of each parameter, and in
            column ``START`` the derivative of all breakaway times.
        errors: Derivatives of the innovations, rad per unit of the direction, shape (n, d); samples
            outside the segments are left unchanged.
        deviations: Derivatives of the logarithms of the standard deviations, per unit of the
            direction, shape (n, d).
    """
    lanes, gains = np.zeros(WORKSPACE), np.zeros(GAINS)
    tangents = np.zeros((len(seeds), TANGENTS))
    correlated = noise[CORRELATED] > 0.0
    for begin in range(0, len(segments), LANES):
        group, times = segments[begin : begin + LANES], begins[begin : begin + LANES]
        started(group, samples, noise, p, lanes)
        _started(tangents, seeds, lanes)
        active = len(group)
        for k in range(int(group[0, LAST] - group[0, FIRST])):
            active = still_active(group, active, k)
            wide = whole(active)
            most = loaded(group, times, samples, k, active, noise, lanes)
            if correlated:
                for lane in range(active):
                    row = int(group[lane, FIRST]) + k
                    period = samples[row, TIME] - samples[row, BEFORE]
                    kept = np.exp(-period / noise[CORRELATION_TIME])
                    _forgotten(tangents, lanes, lane, kept)
            for number in range(most):
                factors(gains, lanes, wide, number, p)
                for j in range(len(seeds)):
                    step(tangents[j], seeds[j], gains, lanes, wide)
                    if correlated:
                        step_hidden(tangents[j], gains, lanes, wide)
                predict(lanes, wide, number, p, correlated)
            compare(lanes, wide)
            for j in range(len(seeds)):
                d = tangents[j]
                for lane in range(active):
                    row = int(group[lane, FIRST]) + k
                    errors[row, j] = -d[T_ANGLE + lane]
                    deviations[row, j] = 0.5 * d[T_P11 + lane] / lanes[L_VARIANCE + lane]
                correct_tangents(d, seeds[j], lanes, wide)
            correct(lanes, wide, correlated)
