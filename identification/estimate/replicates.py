"""Computes the bias of maximum likelihood from simulations of the experiment at the estimate
(docs/method.md, M33-M36).

A replicate is a simulation with the recorded commands and with the drive loop that was estimated
from the recordings. The bias is the mean, over replicates, of the step of one iteration of Fisher
scoring from the simulated values (parametric bootstrap; indirect inference: Gourieroux, Monfort and
Renault, Journal of Applied Econometrics 8 (1993) S85). Each noise realisation is used twice, the
second time with reversed sign, so that terms of odd order in the noise cancel. The sensitivities of
replicates are also used as instruments, and their products give the Cramer-Rao bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import numpy as np

from identification.estimate.inertia import Replicate, segment_inflation
from identification.filter.likelihood import (
    HUBER_THRESHOLD,
    Point,
    search_breakaway_times,
    torque_noise,
)
from identification.filter.segments import Motion, motion
from identification.model.parameters import (
    INERTIA,
    LOAD_PARAMETERS,
    OFFSET,
    SYSTEM_PARAMETERS,
    unpack,
)
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.compiled import both
from identification.recording import Model
from identification.simulation.drive_loop import Loop, Response, drive_loop, respond

_SEEDS = 1 << 63  # upper limit of the random seeds of the noise
PAIRS = 3  # noise series in the first round; each series is simulated with both signs
MOST_PAIRS = 6  # greatest number of noise series, used if the bias is uncertain
UNCERTAIN = 0.15
"""Standard error of the bias, in standard errors of the estimate, above which more noise series are
simulated.
"""
TRIED = 9  # greatest number of pairs that are tried; a replicate fails if the filter diverges
ENOUGH = 2  # least number of pairs that succeed; with fewer pairs the bias is not corrected
LARGE = 2.0
"""Bias, in standard errors of the estimate, above which the replicates are simulated again at the
corrected values.
"""
TURNS = 3  # greatest number of rounds of simulation, the first round included
UNSEEN = 0.5
"""Logged share of the noise variance (M34) where the recordings do not determine it."""
HEADROOM = 2.0  # assumed torque limit of the drive over the greatest torque in the recordings
FARTHEST = 20.0
"""Step of the estimate of a replicate, in standard deviations, above which the filter counts as
diverged and the replicate is dropped.
"""


@dataclass(frozen=True)
class Bias:
    """Bias of the likelihood."""

    shifts: Mapping[str, float]  # bias of each parameter by name, SI
    # Variance of each bias, due to the finite number of replicates, by name.
    variances: Mapping[str, float]
    replicates: tuple[Replicate, ...] = field(default=(), compare=False, repr=False)


def likelihood_bias(
    joint: Point, names: Sequence[str], rng: np.random.Generator, progress: Progress = silent
) -> Bias | None:
    """Return the bias of the maximum-likelihood estimate at a point (M35), without the bias of the
    inertia.

    The result is None if the experiment cannot be simulated, because the recordings do not
    determine the drive loop or a gas generator is the load, or if the filter diverges on the
    replicates.

    ``rng``: the generator of the noise is spawned from ``rng``, whose stream does not advance.
    """
    loop = _loop(joint.motions)
    if loop is None or OFFSET in joint.free:
        return None
    (source,) = rng.spawn(1)
    seeds = source.integers(_SEEDS, size=TRIED).tolist()
    share = logged_share(joint, loop, source)
    there, found = joint, None
    replicates: tuple[Replicate, ...] = ()
    for turn in range(1, TURNS + 1):
        noises, pairs = iter(seeds), list[_Pair]()
        for pair in islice(_pairs(there, loop, share, noises), PAIRS):
            pairs.append(pair)
            progress(f"simulated replicates, round {turn}", len(pairs) / PAIRS)
        if len(pairs) < ENOUGH:
            break
        mean = np.mean(_even(pairs), axis=0)
        size = float(np.max(np.abs(mean) / _deviation(pairs)))
        last = turn == TURNS or size < LARGE
        while last and len(pairs) < MOST_PAIRS and _uncertain(pairs):
            more = next(_pairs(there, loop, share, noises), None)
            if more is None:
                break
            pairs.append(more)
            progress("further simulated replicates", len(pairs) / MOST_PAIRS)
        found = _even(pairs)
        replicates = tuple(r.replicate for pair in pairs for r in pair)
        if last:
            break
        # The bias at the true values is approximated by the bias at the corrected estimate.
        there = replace(joint, vector=joint.parameters(_away(joint, mean)))
    if found is None:
        return None
    moved = np.array([_named(joint, pair, names) for pair in found])
    mean = _named(joint, np.mean(found, axis=0), names)
    spread = np.var(moved, axis=0, ddof=1) / len(moved)
    return Bias(
        dict(zip(names, mean.tolist(), strict=True)),
        dict(zip(names, spread.tolist(), strict=True)),
        replicates,
    )


def logged_share(joint: Point, loop: Loop, rng: np.random.Generator) -> float:
    """Return the logged share: the share of the variance of the torque noise that is in the logged
    torque and not in the true torque (M34).

    The current loop of a drive follows the noise of its current sensor within the bandwidth of the
    loop; this part of the noise moves the joint and is not in the log. The scatter of the logged
    torque beyond the drive's response to this motion is measurement noise. If the response is
    greater than the noise, the function returns :data:`UNSEEN`.
    """
    noise = joint.noise.torque
    if not noise > 0.0:
        return UNSEEN
    answers = [
        _response(joint, m, loop, _drawn(joint, m, rng, 1.0, UNSEEN)[0]).torque
        for m in joint.motions
    ]
    answer = torque_noise(
        [replace(m, torque=torque) for m, torque in zip(joint.motions, answers, strict=True)]
    )
    if answer > noise:
        return UNSEEN
    return float(np.clip((torque_noise(joint.motions) ** 2 - answer**2) / noise**2, 0.0, 1.0))


@dataclass(frozen=True)
class _Scored:
    """A simulated replicate, and the step of one iteration of Fisher scoring on its likelihood,
    from the parameter values with which the replicate was simulated.
    """

    step: Array  # scoring step, shape (p,)
    # Standard deviation of the step, shape (p,); infinite for the inertia, whose step is zero.
    deviation: Array
    replicate: Replicate


_Pair = tuple[_Scored, _Scored]
"""Two replicates with the same noise realisation, the second with reversed sign."""


def _pairs(there: Point, loop: Loop, share: float, noises: Iterator[int]) -> Iterator[_Pair]:
    """Yield pairs of replicates that both succeed, until the seeds are used up."""
    for noise in noises:
        one, other = both(
            partial(_step, there, loop, share, noise, 1.0),
            partial(_step, there, loop, share, noise, -1.0),
        )
        if one is not None and other is not None:
            yield one, other


def _even(pairs: Sequence[_Pair]) -> Array:
    """Return each pair's mean scoring step, in which odd orders of noise cancel, (n, p)."""
    return np.array([0.5 * (one.step + other.step) for one, other in pairs])


def _deviation(pairs: Sequence[_Pair]) -> Array:
    """Return the median over replicates of a scoring step's standard deviation, (p,)."""
    return np.asarray(np.median([r.deviation for pair in pairs for r in pair], axis=0))


def _uncertain(pairs: Sequence[_Pair]) -> bool:
    """Return whether a bias is uncertain (:data:`UNCERTAIN`)."""
    error = np.std(_even(pairs), axis=0, ddof=1) / math.sqrt(len(pairs))
    return bool(np.max(error / _deviation(pairs)) > UNCERTAIN)


def _away(joint: Point, step: Array) -> Array:
    """Return the free vector of the point with a step of the parameters subtracted."""
    there = joint.origin()
    there[: len(step)] -= step
    return there


def _named(joint: Point, step: Array, names: Sequence[str]) -> Array:
    """Return the change of named parameters for a step that ends at the point, SI, (p,)."""
    before, here = (unpack(p, names) for p in (joint.parameters(_away(joint, step)), joint.vector))
    return np.array([here[n] - before[n] for n in names])


def _loop(motions: Sequence[Motion]) -> Loop | None:
    """Return the drive loop, or None if it is not determined or a gas generator is the load."""
    recordings = [m.recording for m in motions]
    if any(r.hot_fire or "command" not in r.channels for r in recordings):
        return None
    limit = HEADROOM * max(float(np.max(np.abs(m.torque))) for m in motions)
    return drive_loop(recordings, limit, _step_of_encoder(motions[0]))


def _step_of_encoder(m: Motion) -> float:
    return math.sqrt(12.0 * m.angle_variance)


def _step(joint: Point, loop: Loop, share: float, seed: int, sign: float) -> _Scored | None:
    """Simulate a replicate and return its scoring step, or None if the filter diverges."""
    rng = np.random.default_rng(seed)
    motions = [
        _replicate(joint, m, loop, _drawn(joint, m, rng, sign, share)) for m in joint.motions
    ]
    seen = [m for m in motions if m is not None]
    if len(seen) < len(motions):
        return None
    others = [k for k in joint.free if k != INERTIA]
    point = search_breakaway_times(Point.of(seen, joint.vector, others, Model(), joint.noise))
    point = point.freeing(joint.free)
    point = replace(point, inflation=segment_inflation(point, others))
    return _scored(point, seed)


def _scored(point: Point, noise: int) -> _Scored | None:
    """Return the step of one Fisher scoring iteration (M23), J fixed; None if too far."""
    x, count = point.origin(), len(point.free)
    errors, deviations = point.predictions(x)
    every, widening = point.derivatives(x, errors, deviations)
    inflation = point.inflation[point.owners]
    replicate = Replicate(point, every.scaled(inflation), errors / deviations * inflation, noise)
    held = [j for j, k in enumerate(point.free) if k == INERTIA]
    jacobian = every
    for j in held:
        jacobian, widening = jacobian.without(j), widening.without(j)
    residual = np.clip(errors / deviations, -HUBER_THRESHOLD, HUBER_THRESHOLD)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    sought = count - len(held)
    try:
        inverse = np.linalg.inv(known)
    except np.linalg.LinAlgError:
        return None
    step, deviation = -(inverse @ score)[:sought], np.sqrt(np.diag(inverse)[:sought])
    if np.any(np.abs(step) > FARTHEST * deviation):
        return None
    for j in held:
        step, deviation = np.insert(step, j, 0.0), np.insert(deviation, j, np.inf)
    return _Scored(step, deviation, replicate)


def _drawn(joint: Point, m: Motion, rng: np.random.Generator, sign: float, share: float) -> Array:
    """Return noise that moves the joint, and noise of the logged torque, N m, (2, n)."""
    rows = joint.noise.drawn(rng, (2, len(m.time)), m.recording.period, sign)
    return rows * np.sqrt([[1.0 - share], [share]])


def _response(joint: Point, m: Motion, loop: Loop, disturbance: Array) -> Response:
    """Return the simulated response to a recording's command at the point's values."""
    r = m.recording
    values = unpack(joint.vector, (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS))
    values["J"] += m.extra_inertia
    command = np.asarray(r.channels["command"], dtype=np.float64)
    moment, weight = float(np.median(m.moment)), r.pendulum
    swing = (0.0, 0.0) if weight is None else (weight.moment(r.bench.gravity), weight.zero)
    known = (r.steady_torque, *swing)
    return respond(command, r.period, values, moment, joint.alpha, loop, disturbance, known)


def _replicate(joint: Point, m: Motion, loop: Loop, noise: Array) -> Motion | None:
    """Return the replicate of a recording at the point's values, with noise of shape (2, n)."""
    r = m.recording
    response = _response(joint, m, loop, noise[0])
    step = _step_of_encoder(m)
    channels = {
        "time": r.period * np.arange(len(response.angle)),
        "angle": np.floor(response.angle / step) * step,
        "torque": response.torque + noise[1],
    }
    if "load_force" in r.channels:
        # The force of the simulated response (:func:`_response`).
        force = float(np.median(m.moment)) / (r.bench.moment_arm or 1.0)
        channels["load_force"] = np.full(len(response.angle), force)
    return motion(replace(r, channels=channels, averaged=frozenset({"torque"}), notes=()))
