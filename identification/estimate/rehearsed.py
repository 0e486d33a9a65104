"""What the likelihood of the prediction errors puts off, found by rehearsal.

Right after a breakaway friction falls steeply, and the filter is linear (to second order) about its prediction: it
takes noise there to speed the onset up more than it does. And within the period of a breakaway the torque is no
straight line, as the drive answers. So the likeliest values stand beside the true ones, most where static friction is
high. The experiment is simulated at the estimate, under its own commands and by the drive's loop as the recordings show
it, and what one step of the likelihood makes of the values simulated is the bias there (indirect inference: Gourieroux,
Monfort and Renault, J. Appl. Econometrics 8 (1993) S85). Each noise is used twice, the second time with its sign
turned, so that what is odd in it cancels and few rehearsals are enough.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate import innovations as kernel
from identification.estimate.information import settle
from identification.estimate.noise_level import CLIP
from identification.estimate.prediction_problem import Problem, static_limit, unpack
from identification.estimate.result import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.estimate.stretches import Motion, motion
from identification.recording import Array, Model
from identification.simulate.seen_loop import drive_loop
from identification.simulate.servo_loop import Loop, respond

PAIRS = 3
"""Noises, each taken both ways."""
_HALF = math.sqrt(0.5)
"""Of the torque's noise in the torque itself, and in its measurement alike: which of the two it is rests on the drive's
current loop, and both ends have been seen."""
_HEADROOM = 2.0
"""The drive's greatest torque over the greatest in the recordings."""
_FARTHEST = 6.0
"""Deviations beyond which a rehearsal's step is one of a filter that lost the shaft, and tells nothing."""


@dataclass(frozen=True)
class Bias:
    """By how much the likelihood puts parameters off.

    Attributes:
        shifts: Name to what it adds to the true value, SI.
        variances: The square of the error of that, by which so few rehearsals leave it uncertain.
    """

    shifts: Mapping[str, float]
    variances: Mapping[str, float]


def likelihood_bias(joint: Problem, names: Sequence[str]) -> Bias | None:
    """Return by how much the likelihood puts parameters off at a problem's start.

    The inertia, which is not found by likelihood, has no bias of it. None where that cannot be rehearsed: the
    recordings do not show the drive's loop, hold loads that a weight does not make, or the filter does not follow.

    Args:
        joint: At the estimate; it is not changed.
        names: Of the fitted parameters.
    """
    loop = _loop(joint.motions)
    if loop is None or kernel.OFFSET in joint.free:
        return None
    rehearsals = []
    for seed in range(PAIRS):
        both = [_step(joint, loop, seed, sign) for sign in (1.0, -1.0)]
        shifts = [_named(joint, step, names) for step in both if step is not None]
        if len(shifts) < len(both):
            return None
        rehearsals.append(np.mean(shifts, axis=0))
    mean, spread = np.mean(rehearsals, axis=0), np.var(rehearsals, axis=0, ddof=1) / PAIRS
    return Bias(dict(zip(names, mean.tolist(), strict=True)), dict(zip(names, spread.tolist(), strict=True)))


def _named(joint: Problem, step: Array, names: Sequence[str]) -> Array:
    """Return what a step of the free parameters does to named ones, in their own units, shape (p,)."""
    there = joint.origin()
    there[: len(step)] += step
    moved, here = (unpack(p, names) for p in (joint.parameters(there), joint.start))
    return np.array([moved[n] - here[n] for n in names])


def _loop(motions: Sequence[Motion]) -> Loop | None:
    """Return the drive's loop, where recordings show it and it can be rehearsed under their loads."""
    recordings = [m.recording for m in motions]
    plain = all(r.pendulum is None and not r.hot_fire and "command" in r.channels for r in recordings)
    if not plain:
        return None
    limit = _HEADROOM * max(float(np.max(np.abs(m.torque))) for m in motions)
    return drive_loop(recordings, limit, _step_of_encoder(motions[0]))


def _step_of_encoder(m: Motion) -> float:
    return math.sqrt(12.0 * m.angle_variance)


def _step(joint: Problem, loop: Loop, seed: int, sign: float) -> Array | None:
    """Return one step of the likelihood from the values that were simulated; None where the filter does not follow."""
    rng = np.random.default_rng(seed)
    motions = [_rehearsed(joint, m, loop, sign, rng) for m in joint.motions]
    seen = [m for m in motions if m is not None]
    if len(seen) < len(motions):
        return None
    problem = Problem(seen, joint.start, joint.free, Model(alpha=joint.alpha), joint.noise)
    problem.angle_noise = joint.angle_noise
    problem.begins = [m.static_crossing(static_limit(problem.start, m)) for m in seen]
    settle(problem, CLIP)
    problem.weigh()
    if problem.seek_breakaways(CLIP):
        settle(problem, CLIP)
    return _scored(problem)


def _scored(problem: Problem) -> Array | None:
    """Return a step of Fisher scoring on parameters and breakaway times, the inertia held; the parameters' part."""
    x, count = problem.origin(), len(problem.free)
    errors, deviations = problem.predictions(x)
    jacobian, widening = problem.derivatives(x, errors, deviations)
    residual = np.clip(errors / deviations, -CLIP, CLIP)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    sought = [k for k in range(len(score)) if k >= count or problem.free[k] != kernel.INERTIA]
    try:
        inverse = np.linalg.inv(known[np.ix_(sought, sought)])
    except np.linalg.LinAlgError:
        return None
    moved = -inverse @ score[sought]
    inside = sum(k < count for k in sought)
    if np.any(np.abs(moved[:inside]) > _FARTHEST * np.sqrt(np.diag(inverse)[:inside])):
        return None
    step = np.zeros(count)
    step[sought[:inside]] = moved[:inside]
    return step


def _rehearsed(joint: Problem, m: Motion, loop: Loop, sign: float, rng: np.random.Generator) -> Motion | None:
    """Return what the bench would log of a recording's commands at the problem's values."""
    r = m.recording
    values = unpack(joint.start, (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS))
    values["J"] += m.extra_inertia
    noise = sign * _HALF * joint.noise * rng.standard_normal((2, len(m.time)))
    command = np.asarray(r.channels["command"], dtype=np.float64)
    moment = float(np.median(m.moment))
    response = respond(command, r.period, values, moment, joint.alpha, loop, noise[0])
    step = _step_of_encoder(m)
    channels = {
        "time": r.period * np.arange(len(command)),
        "angle": np.floor(response.angle / step) * step,
        "torque": response.torque + noise[1],
    }
    return motion(replace(r, channels=channels, averaged=frozenset({"torque"}), notes=()))
