"""How tightly a planned experiment would pin each parameter: Fisher information on the nominal model.

The nominal response, with the bench's noise, is put through its sensors and handed to the very residuals that the
default method minimises. So the information knows of the encoder's quantisation, of the current's noise, of unknown
breakaway times, and of what the estimator leaves out around them. The sensitivities are means over a stage's stretches:
a stretch's own hold the current's noise, and where no two stretches are alike they promise more than the estimator can
have. Whole designs are then judged by several runs of each (:mod:`identification.design.rehearsal`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from identification.estimate.prediction.arrow import Arrow
from identification.estimate.prediction.information import settle
from identification.estimate.prediction.instruments import instruments
from identification.estimate.prediction.leverage import bounded
from identification.estimate.prediction.noise import Noise
from identification.estimate.prediction.noise_level import CLIP
from identification.estimate.prediction.problem import INDEX, LOGARITHMIC, Problem, pack, static_limit
from identification.estimate.prediction.stretches import motion
from identification.estimate.result import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.estimate.uncertainty import CONFIDENCE
from identification.recording import Array, Bench, Model, Recording
from identification.simulate.servo_loop import Loop, Response, respond, usual_loop

NAMES = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS)
LEAST_BREAKAWAYS = 4
"""Breakaways below which a stage is taken to say nothing: the estimator needs some to tell their times from Ms."""

MOST = 2.0
"""Median stretches that one is believed as at most: the stretches of a sine differ by chance alone, and where one says
far more than the others it was all but stopped there, which no other run need repeat."""

NOISE_SEED = 0
GREATEST_RMS, GREATEST_PEAK, WHITE = 1.1, 6.0, 0.1
"""Size of the nominal model's own residuals, in units of their noise, and correlation of neighbours, above which the
filter has lost the shaft (it creeps, or nearly stops and goes on) and its slopes would promise far too much."""


@dataclass(frozen=True)
class Sensors:
    """What the bench logs.

    Attributes:
        period: Of the log, s.
        joint_step: Joint angle of one step of the finer encoder, rad.
        torque_noise: Noise of the torque as logged, a mean over the period, N m rms at the joint.
    """

    period: float
    joint_step: float
    torque_noise: float


@dataclass(frozen=True)
class PlannedStage:
    """One stage of an experiment, repeats written out: joint angles commanded, rad, shape (n,), and the weight, kg."""

    command: Array
    weight: float


@dataclass(frozen=True)
class Information:
    """What a stage says about the nine, each relative to its value, in the order of NAMES; it adds over stages.

    Attributes:
        normal: Fisher information, shape (9, 9).
    """

    normal: Array


NOTHING = Information(np.zeros((len(NAMES), len(NAMES))))


@dataclass(frozen=True)
class Pinned:
    """Relative half widths of the 90 % intervals that an experiment would leave; infinite where it says nothing."""

    half_widths: Mapping[str, float]

    @property
    def weakest(self) -> str:
        """The parameter with the widest interval for its value."""
        return max(self.half_widths, key=lambda name: self.half_widths[name])

    @property
    def worst(self) -> float:
        """Its relative half width."""
        return self.half_widths[self.weakest]


@dataclass(frozen=True)
class Nominal:
    """The model an experiment is planned on: the nine by name, SI, the bench, its sensors, the greatest torque, N m.

    ``loop`` is the drive as recordings showed it, None where it is assumed from the inertia; ``stiffness`` is the
    velocity gain over that one's.
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


def stage_response(
    stage: PlannedStage, nominal: Nominal, rng: np.random.Generator | None = None, share: float = 1.0
) -> Response:
    """Return what the nominal bench does in one stage.

    Args:
        stage: What is commanded, under which weight.
        nominal: The model.
        rng: Of the torque's noise; None for the same noise in every stage of one length, so that designs compare.
        share: Of the noise that is in the torque itself.
    """
    moment, sensors = nominal.moment(stage.weight), nominal.sensors
    chance = rng or np.random.default_rng(NOISE_SEED)
    noise = share * sensors.torque_noise * chance.standard_normal(len(stage.command))
    return respond(stage.command, sensors.period, nominal.values, moment, nominal.alpha, nominal.drive(), noise)


def stage_information(stage: PlannedStage, nominal: Nominal, response: Response | None = None) -> Information:
    """Return the Fisher information of one stage on all nine, each relative to its value, in the order of NAMES.

    Zero where the stage has too few breakaways, or moves so that the estimator could not follow. Less by as much as the
    likelihood is steeper at the values simulated than noise makes it: the filter errs by about the root of that there.
    Relative, so that the matrix is well scaled; static limits count as themselves, not as the rise above the Coulomb
    level.

    Args:
        stage: What is commanded, under which weight.
        nominal: The model.
        response: Of the stage, where it is already known.
    """
    found = motion(_recording(stage, nominal, response or stage_response(stage, nominal)))
    if found is None or len(found.table) < LEAST_BREAKAWAYS:
        return NOTHING
    names = NAMES if stage.weight else SYSTEM_PARAMETERS
    free = [INDEX[n] for n in names]
    noise = Noise(nominal.sensors.torque_noise)
    problem = Problem([found], pack(nominal.values), free, Model(alpha=nominal.alpha), noise)
    problem.begins = [found.static_crossing(static_limit(problem.start, found))]
    settle(problem, CLIP)
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    if not _follows(residual[: len(residual) - problem.breakaways]):
        return NOTHING
    jacobian, slope = likelihood_slope(problem)
    others = instruments(problem, jacobian)
    mean = jacobian.mixed(1.0 / problem.siblings, others)
    turn = _turn(names, nominal)
    normal = np.zeros((len(NAMES), len(NAMES)))
    normal[: len(names), : len(names)] = turn.T @ bounded(mean.told(), problem.lengths, MOST) @ turn
    return Information(normal / max(slope, 1.0))


def likelihood_slope(problem: Problem) -> tuple[Arrow, float]:
    """Return the sensitivities at a problem's start, and how steep the likelihood is there.

    Where noise decides what the shaft does next, the filter, linear about its prediction, errs with a mean: values
    other than those simulated are then likelier by far, and what such a stage says is wrong. Steepness is that of the
    log likelihood in the parameters, squared, in the metric of their information and over their number: chi-squared
    and about 1 where only noise makes it. The inertia does not count, as it is not estimated by likelihood.
    """
    x, count = problem.origin(), len(problem.free)
    errors, deviations = problem.predictions(x)
    jacobian, widening = problem.derivatives(x, errors, deviations)
    residual = np.clip(errors / deviations, -CLIP, CLIP)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    times = list(range(count, len(score)))
    sought = [k for k in range(count) if problem.free[k] != INDEX["J"]]
    steepness = _squared(score, known, [*sought, *times]) - _squared(score, known, times)
    return jacobian, steepness / max(len(sought), 1)


def _squared(score: Array, known: Array, places: Sequence[int]) -> float:
    """Return the size of some unknowns' scores in the metric of what is known of them."""
    part = score[list(places)]
    return float(part @ np.linalg.pinv(known[np.ix_(places, places)], hermitian=True) @ part)


def _recording(stage: PlannedStage, nominal: Nominal, response: Response) -> Recording:
    """Return what the bench would log of a response."""
    step = nominal.sensors.joint_step
    return Recording(
        name="planned",
        channels={
            "time": np.asarray(nominal.sensors.period * np.arange(len(stage.command)), dtype=np.float64),
            "angle": np.asarray(np.floor(response.angle / step) * step),
            "torque": response.torque,
        },
        bench=nominal.bench,
        stage="loaded" if stage.weight else "unloaded",
        weight_mass=stage.weight,
        averaged=frozenset({"torque"}),
    )


def _follows(errors: Array) -> bool:
    """Return whether prediction errors over their deviations are what they are where the filter holds the shaft."""
    power = float(np.mean(errors**2))
    white = abs(float(np.mean(errors[1:] * errors[:-1]))) < WHITE * power
    return power < GREATEST_RMS**2 and float(np.max(np.abs(errors))) < GREATEST_PEAK and white


def _turn(names: Sequence[str], nominal: Nominal) -> Array:
    """Return the map from relative changes of named parameters to the search's coordinates (logarithms, rises)."""
    turn = np.eye(len(names))
    for k, name in enumerate(names):
        if INDEX[name] not in LOGARITHMIC:
            turn[k, k] = nominal.values[name]
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if static in names:
            turn[names.index(static), names.index(coulomb)] = -nominal.values[coulomb]
    return turn


def pinned(informations: Sequence[Information], loaded: bool) -> Pinned:
    """Return how tightly stages together pin each parameter: the nine, or five where none of them is ``loaded``."""
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
    return Pinned(widths)
