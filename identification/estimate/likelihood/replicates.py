"""What the likelihood of the prediction errors puts off, found by rehearsal, and the inertia with its instruments.

Right after a breakaway friction falls steeply, and the filter is linear (to second order) about its prediction: it
takes noise there to speed the onset up more than it does. And within the period of a breakaway the torque is no
straight line, as the drive answers. So the likeliest values stand beside the true ones, most where static friction is
high. The experiment is simulated at the estimate, under its own commands and by the drive's loop as the recordings show
it, and what one step of the likelihood makes of the values simulated is the bias there (indirect inference: Gourieroux,
Monfort and Renault, J. Appl. Econometrics 8 (1993) S85). Each noise is used twice, the second time with its sign
turned, so that what is odd in it cancels and few rehearsals are enough.

Their sensitivities are instruments too, and those of two noises together the Cramer-Rao bound: the recording has few
strokes alike, and a rehearsal is the same motion with another noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from identification.estimate.inertia.estimating_equations import doubted
from identification.estimate.inertia.half_cycles import Rehearsal
from identification.filter.breakaway_times import settle_anywhere
from identification.filter.likelihood import Problem, static_limit
from identification.filter.noise_level import CLIP, torque_noise
from identification.filter.segments import Motion, motion
from identification.model.parameters import INERTIA, LOAD_PARAMETERS, OFFSET, SYSTEM_PARAMETERS, unpack
from identification.numerics.arrays import Array
from identification.recording import Model
from identification.simulate.seen_loop import drive_loop
from identification.simulate.servo_loop import Loop, Response, respond

PAIRS, MOST_PAIRS = 3, 6
"""Noises, each taken both ways: at first, and where these leave the bias too uncertain."""
_UNCERTAIN = 0.15
"""Error of the bias, in deviations of the estimate, up to which no more noises are taken."""
_TRIED, _ENOUGH = 9, 2
"""Pairs tried where rehearsals fail, as one in which a shaft that all but stops is lost; and those that are enough."""
_LARGE, _TURNS = 2.0, 3
"""Deviations of a bias beyond which values nearer to the true ones are rehearsed in turn, and how often at most."""
_UNSEEN = 0.5
"""Share of the noise's variance that the logged torque holds, where the recordings do not show it: which of the two the
noise is in rests on the drive's current loop, and both ends have been seen."""
_DRAW = 1000
"""Number of the noise that the drive's answer to noise is simulated with."""
_HEADROOM = 2.0
"""The drive's greatest torque over the greatest in the recordings."""
_FARTHEST = 20.0
"""Deviations beyond which a rehearsal's step is one of a filter that lost the shaft, and tells nothing."""


@dataclass(frozen=True)
class Bias:
    """By how much the likelihood puts parameters off.

    Attributes:
        shifts: Name to what it adds to the true value, SI.
        variances: The square of the error of that, by which so few rehearsals leave it uncertain.
        rehearsals: That it was found by.
    """

    shifts: Mapping[str, float]
    variances: Mapping[str, float]
    rehearsals: tuple[Rehearsal, ...] = field(default=(), compare=False, repr=False)


def likelihood_bias(joint: Problem, names: Sequence[str]) -> Bias | None:
    """Return by how much the likelihood puts parameters off at a problem's start.

    The inertia, which is not found by likelihood, has no bias of it. None where that cannot be rehearsed: the
    recordings do not show the drive's loop, hold loads that a weight does not make, or the filter does not follow.

    Args:
        joint: At the estimate; it is not changed.
        names: Of the fitted parameters.
    """
    loop = _loop(joint.motions)
    if loop is None or OFFSET in joint.free:
        return None
    share = logged_share(joint, loop)
    start, found = joint.start, None
    played: tuple[Rehearsal, ...] = ()
    for turn in range(1, _TURNS + 1):
        there = copy(joint)
        there.start = start
        noises = iter(range(_TRIED))
        pairs = list(islice(_pairs(there, loop, share, noises), PAIRS))
        if len(pairs) < _ENOUGH:
            break
        mean = np.mean(_even(pairs), axis=0)
        last = turn == _TURNS or float(np.max(np.abs(mean) / _deviation(pairs))) < _LARGE
        while last and len(pairs) < MOST_PAIRS and _uncertain(pairs):
            more = next(_pairs(there, loop, share, noises), None)
            if more is None:
                break
            pairs.append(more)
        found = _even(pairs)
        played = tuple(r.rehearsal for pair in pairs for r in pair)
        if last:
            break
        # What the estimate is off by is what values that far from it are put off by.
        start = joint.parameters(_away(joint, mean))
    if found is None:
        return None
    moved = np.array([_named(joint, pair, names) for pair in found])
    mean, spread = _named(joint, np.mean(found, axis=0), names), np.var(moved, axis=0, ddof=1) / len(moved)
    return Bias(dict(zip(names, mean.tolist(), strict=True)), dict(zip(names, spread.tolist(), strict=True)), played)


def logged_share(joint: Problem, loop: Loop) -> float:
    """Return the share of the torque noise's variance that is in the logged torque and not in the true one.

    A drive's current loop follows the noise of its own sensor as far as its bandwidth reaches: that part turns the
    shaft and is not logged. What the logged torque scatters from sample to sample beyond what the drive answers to the
    other part is noise of the measurement. Where that answer hides it, half is taken.

    Args:
        joint: At the estimate; it is not changed.
        loop: The drive's.
    """
    noise = joint.noise.torque
    if not noise > 0.0:
        return _UNSEEN
    rng = np.random.default_rng(_DRAW)
    answers = [_response(joint, m, loop, _drawn(joint, m, rng, 1.0, _UNSEEN)[0]).torque for m in joint.motions]
    answer = torque_noise([replace(m, torque=torque) for m, torque in zip(joint.motions, answers, strict=True)])
    if answer > noise:
        return _UNSEEN
    return float(np.clip((torque_noise(joint.motions) ** 2 - answer**2) / noise**2, 0.0, 1.0))


@dataclass(frozen=True)
class _Scored:
    """A rehearsal and what one step of the likelihood makes of it.

    Attributes:
        step: From the values that are simulated, shape (p,).
        deviation: Of that; infinite, and no step, where a parameter is not found by likelihood, shape (p,).
        rehearsal: What was simulated.
    """

    step: Array
    deviation: Array
    rehearsal: Rehearsal


_Pair = tuple[_Scored, _Scored]
"""Rehearsals with one noise, and with its sign turned."""


def _pairs(there: Problem, loop: Loop, share: float, noises: Iterator[int]) -> Iterator[_Pair]:
    """Yield pairs of rehearsals that both work, until the noises are used up.

    Args:
        there: The problem whose experiment is simulated, at the values that are simulated.
        loop: The drive's.
        share: Of the noise's variance that is logged.
        noises: Their numbers.
    """
    for noise in noises:
        one, other = (_step(there, loop, share, noise, sign) for sign in (1.0, -1.0))
        if one is not None and other is not None:
            yield one, other


def _even(pairs: Sequence[_Pair]) -> Array:
    """Return each pair's mean step, in which what is odd in the noise cancels, shape (n, p)."""
    return np.array([0.5 * (one.step + other.step) for one, other in pairs])


def _deviation(pairs: Sequence[_Pair]) -> Array:
    """Return the median deviation of a step, shape (p,)."""
    return np.asarray(np.median([r.deviation for pair in pairs for r in pair], axis=0))


def _uncertain(pairs: Sequence[_Pair]) -> bool:
    """Return whether so few pairs leave the bias of some parameter uncertain beside what the estimate is."""
    error = np.std(_even(pairs), axis=0, ddof=1) / math.sqrt(len(pairs))
    return bool(np.max(error / _deviation(pairs)) > _UNCERTAIN)


def _away(joint: Problem, step: Array) -> Array:
    """Return the free vector that lies a step of the parameters before the problem's start."""
    there = joint.origin()
    there[: len(step)] -= step
    return there


def _named(joint: Problem, step: Array, names: Sequence[str]) -> Array:
    """Return by how much named parameters change in a step that ends at the start, in their own units, shape (p,)."""
    before, here = (unpack(p, names) for p in (joint.parameters(_away(joint, step)), joint.start))
    return np.array([here[n] - before[n] for n in names])


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


def _step(joint: Problem, loop: Loop, share: float, seed: int, sign: float) -> _Scored | None:
    """Rehearse once and return one step of the likelihood; None where the filter does not follow."""
    rng = np.random.default_rng(seed)
    motions = [_rehearsed(joint, m, loop, _drawn(joint, m, rng, sign, share)) for m in joint.motions]
    seen = [m for m in motions if m is not None]
    if len(seen) < len(motions):
        return None
    problem = Problem(seen, joint.start, [], Model(), joint.noise)
    problem.free = tuple(k for k in joint.free if k != INERTIA)
    problem.begins = [m.static_crossing(static_limit(problem.start, m)) for m in seen]
    settle_anywhere(problem, CLIP)
    problem.doubt = doubted(problem)
    problem.free = joint.free
    return _scored(problem, seed)


def _scored(problem: Problem, noise: int) -> _Scored | None:
    """Return the parameters' part of a step of Fisher scoring on them and breakaway times, the inertia held.

    ``noise`` is the number of that which the problem's recordings were simulated with.
    """
    x, count = problem.origin(), len(problem.free)
    errors, deviations = problem.predictions(x)
    every, widening = problem.derivatives(x, errors, deviations)
    doubt = problem.doubt[problem.owners]
    rehearsal = Rehearsal(problem, every.scaled(doubt), errors / deviations * doubt, noise)
    held = [j for j, k in enumerate(problem.free) if k == INERTIA]
    jacobian = every
    for j in held:
        jacobian, widening = jacobian.without(j), widening.without(j)
    residual = np.clip(errors / deviations, -CLIP, CLIP)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    sought = count - len(held)
    try:
        inverse = np.linalg.inv(known)
    except np.linalg.LinAlgError:
        return None
    step, deviation = -(inverse @ score)[:sought], np.sqrt(np.diag(inverse)[:sought])
    if np.any(np.abs(step) > _FARTHEST * deviation):
        return None
    for j in held:
        step, deviation = np.insert(step, j, 0.0), np.insert(deviation, j, np.inf)
    return _Scored(step, deviation, rehearsal)


def _drawn(joint: Problem, m: Motion, rng: np.random.Generator, sign: float, share: float) -> Array:
    """Return what the true torque falls short by and what the logged one is off by, N m, shape (2, n)."""
    rows = joint.noise.drawn(rng, (2, len(m.time)), m.recording.period, sign)
    return rows * np.sqrt([[1.0 - share], [share]])


def _response(joint: Problem, m: Motion, loop: Loop, disturbance: Array) -> Response:
    """Return what the shaft does under a recording's commands at the problem's values."""
    r = m.recording
    values = unpack(joint.start, (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS))
    values["J"] += m.extra_inertia
    command = np.asarray(r.channels["command"], dtype=np.float64)
    return respond(command, r.period, values, float(np.median(m.moment)), joint.alpha, loop, disturbance)


def _rehearsed(joint: Problem, m: Motion, loop: Loop, noise: Array) -> Motion | None:
    """Return what the bench would log of a recording's commands at the problem's values, with noise of shape (2, n)."""
    r = m.recording
    response = _response(joint, m, loop, noise[0])
    step = _step_of_encoder(m)
    channels = {
        "time": r.period * np.arange(len(response.angle)),
        "angle": np.floor(response.angle / step) * step,
        "torque": response.torque + noise[1],
    }
    return motion(replace(r, channels=channels, averaged=frozenset({"torque"}), notes=()))
