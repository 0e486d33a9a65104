"""Simulates a planned experiment on the nominal model: motion, recording, and sensitivities at the
simulated values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from identification.estimate.covariance import (
    covariances,
    replicate_information,
    rise_to_static,
)
from identification.estimate.inertia import Replicate, inflation_by, instruments
from identification.filter.likelihood import (
    HUBER_THRESHOLD,
    Point,
    likeliest_noise,
    optimise_breakaway_times,
    torque_noise,
)
from identification.filter.segments import Noise, motion
from identification.model.parameters import (
    INDEX,
    LOAD_PARAMETERS,
    LOGARITHMIC,
    SYSTEM_PARAMETERS,
    pack,
)
from identification.numerics.arrays import Array
from identification.numerics.least_squares import huber_weight
from identification.numerics.spread import CONFIDENCE, Spread
from identification.recording import Bench, Model, Recording
from identification.result import DEFAULT
from identification.simulation.drive_loop import Loop, Response, respond, usual_loop

NOISE_SEED = 0
ASSUMED, SEEN = (0.75, 1.35), (0.96, 1.04)
"""Ratios of the velocity gain to the nominal gain, of two more drives on which a plan must be
identifiable: if the drive loop is assumed, and if it is known from recordings.
"""


@dataclass(frozen=True)
class Sensors:
    """Sampling, quantisation and noise of the bench's log.

    Attributes:
        period: Sample period of the log, s.
        joint_step: Joint angle of one step of the finer encoder, rad.
        torque_noise: Noise of the torque as logged, a mean over the period, N m rms at the joint.
    """

    period: float
    joint_step: float
    torque_noise: float


@dataclass(frozen=True)
class PlannedStage:
    """One stage of an experiment with all its repeats: commanded joint angles, rad, shape (n,), and
    the weight, kg.
    """

    command: Array
    weight: float


@dataclass(frozen=True)
class PlannedModel:
    """The nominal model of a planned experiment: the nine parameters by name, SI, the bench, its
    sensors, and the greatest torque, N m.

    ``loop`` is the drive loop known from recordings, or None if it is assumed from the inertia.
    ``stiffness`` multiplies the velocity gain of this loop.
    """

    values: Mapping[str, float]
    bench: Bench
    sensors: Sensors
    torque_limit: float
    alpha: float = 2.0
    stiffness: float = 1.0
    loop: Loop | None = None

    def drive(self) -> Loop:
        """Return the drive's loop."""
        loop = self.loop or usual_loop(self.values["J"], self.torque_limit, self.sensors.joint_step)
        return replace(loop, velocity_gain=self.stiffness * loop.velocity_gain)

    def moment(self, weight: float) -> float:
        """Return F_P L1 of a weight on the lever, N m."""
        return self.bench.contact_force(weight) * (self.bench.moment_arm or 0.0)


def with_drives(nominal: PlannedModel) -> tuple[PlannedModel, ...]:
    """Return copies of the model with the nominal drive, a softer drive and a stiffer drive.

    A plan must be identifiable with all three drives.
    """
    beside = ASSUMED if nominal.loop is None else SEEN
    return tuple(
        replace(nominal, stiffness=stiffness) for stiffness in (nominal.stiffness, *beside)
    )


def stage_response(
    stage: PlannedStage,
    nominal: PlannedModel,
    rng: np.random.Generator | None = None,
    share: float = 1.0,
) -> Response:
    """Return the response of the nominal model to the command of one stage.

    Args:
        stage: Command and weight.
        nominal: The model.
        rng: Random generator of the torque noise, or None to use the same noise series for all
            stages of equal length, so that designs can be compared.
        share: Share of the noise variance that is in the true torque, and not only in the log.
    """
    moment, sensors = nominal.moment(stage.weight), nominal.sensors
    chance = rng or np.random.default_rng(NOISE_SEED)
    noise = share * sensors.torque_noise * chance.standard_normal(len(stage.command))
    return respond(
        stage.command, sensors.period, nominal.values, moment, nominal.alpha, nominal.drive(), noise
    )


def recorded(
    number: int, stage: PlannedStage, nominal: PlannedModel, rng: np.random.Generator
) -> Recording:
    """Return the simulated recording of a stage, with half of the noise power in the torque itself
    and half in its measurement.

    The true shares depend on the drive's current loop, which is not known. The recording has the
    channels of the drive too, because without them the default method can neither estimate the
    drive loop nor correct the bias.
    """
    sensors, bench = nominal.sensors, nominal.bench
    response = stage_response(stage, nominal, rng, math.sqrt(0.5))
    noise = math.sqrt(0.5) * sensors.torque_noise * rng.standard_normal(len(stage.command))
    angle = np.asarray(np.floor(response.angle / sensors.joint_step) * sensors.joint_step)
    return Recording(
        name=f"stage {number + 1}",
        channels={
            "time": np.asarray(sensors.period * np.arange(len(stage.command)), dtype=np.float64),
            "angle": angle,
            "motor_angle": bench.gear_ratio * angle,
            "current": np.asarray((response.torque + noise) / bench.ampere_torque),
            "command": stage.command,
        },
        bench=bench,
        stage="loaded" if stage.weight else "unloaded",
        weight_mass=stage.weight,
        averaged=frozenset({"current"}),
    )


def at_the_truth(
    stages: Sequence[PlannedStage],
    nominal: PlannedModel,
    names: Sequence[str],
    noise: int,
    whole: bool = True,
) -> Replicate | None:
    """Return a simulated run of some stages with its sensitivities at the simulated values; None
    where the filter diverges.

    Args:
        stages: Commands and weights.
        nominal: The model.
        names: Names of the parameters that would be fitted.
        noise: Seed of the noise.
        whole: Whether the noise level is estimated, as in an identification; otherwise the nominal
            noise level is used.
    """
    rng = np.random.default_rng(noise)
    motions = [motion(recorded(k, s, nominal, rng)) for k, s in enumerate(stages)]
    known = [m for m in motions if m is not None]
    if len(known) < len(stages):
        return None
    free = [INDEX[n] for n in names]
    noise_level = Noise(torque_noise(known) if whole else nominal.sensors.torque_noise)
    vector = pack(nominal.values, nominal.alpha)
    begun = Point.of(known, vector, free, Model(), noise_level)
    point = optimise_breakaway_times(begun, HUBER_THRESHOLD)
    if whole:
        point = replace(point, noise=likeliest_noise(point))
    held = point.weighted()
    x = point.origin()
    residual = held.residuals(x)
    inside = residual[: len(residual) - point.breakaways]
    white = DEFAULT.acceptance.whiteness
    if abs(float(np.mean(inside[1:] * inside[:-1]))) > white * float(np.mean(inside**2)):
        return None
    jacobian = held.jacobian(x, residual)
    inflation = inflation_by(point.experiment, jacobian.without(free.index(INDEX["J"])))
    return Replicate(replace(point, inflation=inflation), jacobian, residual, noise)


def followed(
    stage: PlannedStage,
    nominals: Sequence[PlannedModel],
    names: Sequence[str],
    noises: Iterable[int],
) -> bool:
    """Return whether the filter does not diverge on a stage, with every drive and each of several
    noise series.
    """
    return all(
        at_the_truth([stage], n, names, noise, whole=False) is not None
        for noise in noises
        for n in nominals
    )


NAMES = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS)
LEAST_BREAKAWAYS = 4
"""Least number of breakaways of a stage that has information: the estimator needs several
breakaways to distinguish breakaway times from Ms.
"""
_CLEAR = 1e-9
"""Ratio of an eigenvalue of the information to the greatest eigenvalue, below which the direction
of the eigenvector counts as not identifiable.
"""


@dataclass(frozen=True)
class Information:
    """Information of a stage on the nine parameters relative to their values, in the order of
    NAMES; the information of several stages is the sum of that of each stage.

    Attributes:
        normal: Fisher information from products of the sensitivities of different simulated runs
            (replicates), bounded by ``power``, shape (9, 9).
        power: Covariance of the scores that the noise model predicts: the Fisher information from
            the products of each run's own sensitivities, shape (9, 9).
        scatter: Covariance of the scores observed over the motion segments of the simulated runs,
            shape (9, 9).
    """

    normal: Array
    power: Array
    scatter: Array

    def times(self, factor: float) -> Information:
        """Return the information of a stage that is ``factor`` times as long."""
        return Information(factor * self.normal, factor * self.power, factor * self.scatter)

    def effective(self, weights: Array) -> Information:
        """Return the information that is effective for one parameter. The information is divided by
        the ratio of the scores' observed variance to their variance by the noise model, if this
        ratio exceeds one.

        Args:
            weights: Weights of the scores in the error of the parameter's estimate, from
                :func:`weights_of_scores`, shape (9,).
        """
        ratio = float(weights @ self.scatter @ weights) / max(
            float(weights @ self.power @ weights), 1e-300
        )
        return replace(self, normal=self.normal / max(ratio, 1.0))


NOTHING = Information(*np.zeros((3, len(NAMES), len(NAMES))))


@dataclass(frozen=True)
class Intervals:
    """Relative half widths of the 90 % intervals after an experiment; infinite for a parameter that
    is not identifiable.
    """

    half_widths: Mapping[str, float]

    @property
    def weakest(self) -> str:
        """Name of the parameter with the widest interval relative to the parameter's value."""
        return max(self.half_widths, key=lambda name: self.half_widths[name])

    @property
    def worst(self) -> float:
        """Relative half width of the weakest parameter."""
        return self.half_widths[self.weakest]


def stage_information(stage: PlannedStage, nominals: Sequence[PlannedModel]) -> Information:
    """Return the information of one stage, from simulated runs that are replicates of one another.

    The information is :data:`NOTHING` if a run has too few breakaways or the filter diverges. The
    parameters are taken relative to their values, so that the matrices are well scaled; they are
    the static levels, not the rises.

    Args:
        stage: Command and weight of the stage.
        nominals: Model of each run, three at least; each run has its own noise.
    """
    names = NAMES if stage.weight else SYSTEM_PARAMETERS
    runs = []
    for number, nominal in enumerate(nominals):
        run = at_the_truth([stage], nominal, names, number, whole=False)
        if run is None or run.point.breakaways < LEAST_BREAKAWAYS:
            return NOTHING
        runs.append(run)
    turn = _turn(names, nominals[0])
    found = np.zeros((3, len(NAMES), len(NAMES)))
    for run in runs:
        others = [other for other in runs if other is not run]
        own = np.stack([_replicate_information(run, others), *_scores(run)])
        found[:, : len(names), : len(names)] += turn.T @ own @ turn / len(runs)
    return Information(_bounded(found[0], found[1]), found[1], found[2])


def _replicate_information(run: Replicate, others: Sequence[Replicate]) -> Array:
    """Return a run's information from products with its replicates, (p, p)."""
    point, jacobian = run.point, run.sensitivities
    share = 1.0 / point.experiment.matching_count
    alike = jacobian.mixed(share, instruments(point, jacobian))
    by_segment = replicate_information(point, alike, others)
    return np.asarray(np.sum(by_segment / point.inflation[:, None, None] ** 2, axis=0))


def _scores(run: Replicate) -> tuple[Array, Array]:
    """Return covariances of a stage's scores, by noise model and observed, (p, p) each."""
    jacobian, residual = run.inflated()
    residual = residual * huber_weight(residual, HUBER_THRESHOLD)
    segments, owners = jacobian.blocks, jacobian.owners
    rows = np.column_stack([jacobian.parameters, jacobian.own])
    count = rows.shape[1] - 1
    power = np.zeros((segments, count + 1, count + 1))
    scores = np.zeros((segments, count + 1))
    np.add.at(power, owners, rows[:, :, None] * rows[:, None, :])
    np.add.at(scores, owners, rows * residual[:, None])
    times = power[:, count, count]
    share = np.where(
        times[:, None] > 0.0,
        power[:, :count, count] / np.where(times > 0.0, times, 1.0)[:, None],
        0.0,
    )
    scores = scores[:, :count] - share * scores[:, count:]
    power = power[:, :count, :count] - share[:, :, None] * power[:, count, None, :count]
    scores -= np.mean(scores, axis=0)
    return np.sum(power, axis=0), scores.T @ scores * segments / max(segments - 1, 1)


def _bounded(information: Array, power: Array) -> Array:
    """Return the information, between zero and ``power`` in every direction."""
    # Products of two different runs can by chance be negative, or far greater than ``power``.
    scale = np.sqrt(np.maximum(np.diag(power), 1e-300))
    values, vectors = np.linalg.eigh(power / np.outer(scale, scale))
    clear = values > _CLEAR * np.max(values)
    root = vectors[:, clear] * np.sqrt(values[clear])
    inverse = vectors[:, clear] / np.sqrt(values[clear])
    shares, ways = np.linalg.eigh(inverse.T @ (information / np.outer(scale, scale)) @ inverse)
    half = root @ ways
    return np.asarray((half * np.clip(shares, 0.0, 1.0)) @ half.T * np.outer(scale, scale))


def likelihood_slope(point: Point) -> float:
    """Return the steepness of the likelihood at a point.

    If noise decides whether the joint stops or moves on, the errors of the linearised filter have a
    nonzero mean. The likelihood of other values is then far greater than that of the simulated
    values, and the information of the stage is wrong. With the gradient g of the log likelihood and
    the information I of p parameters, the steepness is g' I^-1 g / p, which is about 1 if noise
    alone causes the gradient. The inertia is excluded, because it is not estimated by likelihood.
    """
    x, count = point.origin(), len(point.free)
    errors, deviations = point.predictions(x)
    jacobian, widening = point.derivatives(x, errors, deviations)
    residual = np.clip(errors / deviations, -HUBER_THRESHOLD, HUBER_THRESHOLD)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    times = list(range(count, len(score)))
    sought = [k for k in range(count) if point.free[k] != INDEX["J"]]
    steepness = _squared(score, known, [*sought, *times]) - _squared(score, known, times)
    return steepness / max(len(sought), 1)


def _squared(score: Array, known: Array, places: Sequence[int]) -> float:
    """Return g' I^-1 g for the scores g and the information I of the unknowns at ``places``."""
    part = score[list(places)]
    return float(part @ np.linalg.pinv(known[np.ix_(places, places)], hermitian=True) @ part)


def _turn(names: Sequence[str], nominal: PlannedModel) -> Array:
    """Return d coordinates of a search / d relative changes of named parameters."""
    turn = np.eye(len(names))
    for k, name in enumerate(names):
        if INDEX[name] not in LOGARITHMIC:
            turn[k, k] = nominal.values[name]
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if static in names:
            turn[names.index(static), names.index(coulomb)] = -nominal.values[coulomb]
    return turn


def weights_of_scores(informations: Sequence[Information], target: str, loaded: bool) -> Array:
    """Return the weights of the scores in the error of an estimate, shape (9,): the row of the
    ``target`` parameter in the inverse of the information of several stages. To first order, the
    error of the estimate is the sum of the scores times these weights.
    """
    count = len(NAMES) if loaded else len(SYSTEM_PARAMETERS)
    total = np.sum([i.normal for i in informations], axis=0)[:count, :count]
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    out = np.zeros(len(NAMES))
    out[:count] = (
        np.linalg.pinv(total / np.outer(scale, scale), hermitian=True)[NAMES.index(target)] / scale
    )
    return out


def effective(informations: Sequence[Information], target: str, loaded: bool) -> list[Information]:
    """Return the effective information of each stage on the ``target`` parameter, which is
    estimated from all stages together.
    """
    weights = weights_of_scores(informations, target, loaded)
    return [i.effective(weights) for i in informations]


def intervals_of(informations: Sequence[Information], loaded: bool) -> Intervals:
    """Return the intervals from all stages together: of all nine parameters if any stage is loaded,
    otherwise of the five system parameters.
    """
    names = NAMES if loaded else SYSTEM_PARAMETERS
    total = np.sum([i.normal for i in informations], axis=0)[: len(names), : len(names)]
    seen = np.flatnonzero(np.diag(total) > 0.0)
    widths = dict.fromkeys(names, math.inf)
    scale = np.sqrt(np.diag(total)[seen])
    values, vectors = np.linalg.eigh(total[np.ix_(seen, seen)] / np.outer(scale, scale))
    clear = values >= 1e-12 * np.max(values, initial=0.0)
    bread = (vectors[:, clear] / values[clear]) @ vectors[:, clear].T / np.outer(scale, scale)
    quantile = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    for k, place in enumerate(seen):
        if not np.any(np.abs(vectors[k, ~clear]) > 1e-6):
            widths[names[place]] = quantile * math.sqrt(bread[k, k])
    return Intervals(widths)


def expected(
    stages: Sequence[PlannedStage], nominals: Sequence[PlannedModel]
) -> tuple[Intervals, float]:
    """Return the relative half widths that the joint fit would state at the simulated values, and
    the steepness of the likelihood there.

    The steepness is stated relative to its value with noise alone, and is at least 1; the fit would
    end about so many standard deviations from the simulated values. Half widths and steepness are
    medians over the runs, and infinite if the filter diverges in one run.

    Args:
        stages: The design.
        nominals: Model of each run, three at least; each run has its own noise.
    """
    names = NAMES if any(s.weight > 0.0 for s in stages) else SYSTEM_PARAMETERS
    nothing = Intervals(dict.fromkeys(names, math.inf)), math.inf
    runs = []
    for number, nominal in enumerate(nominals):
        run = at_the_truth(stages, nominal, names, number)
        if run is None:
            return nothing
        runs.append(run)
    turn = rise_to_static(names)
    found = []
    for run in runs:
        try:
            achieved = covariances(
                run.point, [other for other in runs if other is not run]
            ).achieved
        except np.linalg.LinAlgError:
            return nothing
        spread = Spread(names, turn @ achieved @ turn.T, math.inf)
        found.append([spread.half_width(n) / nominals[0].values[n] for n in names])
    widths = np.where(np.all(np.isfinite(found), axis=0), np.median(found, axis=0), np.inf)
    slopes = [math.sqrt(max(likelihood_slope(run.point), 1.0)) for run in runs]
    return Intervals(dict(zip(names, widths.tolist(), strict=True))), float(np.median(slopes))
