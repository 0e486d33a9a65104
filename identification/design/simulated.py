"""Simulates a planned experiment on the nominal model: motion, recording, and sensitivities at the
simulated values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.covariance import covariances, rise_to_static
from identification.estimate.inertia import Replicate, inflation_by
from identification.estimate.searches import MOST_WHITENESS
from identification.filter.likelihood import (
    HUBER_THRESHOLD,
    Point,
    likeliest_noise,
    optimise_breakaway_times,
    torque_noise,
)
from identification.filter.segments import Noise, motion
from identification.model.parameters import INDEX, LOAD_PARAMETERS, SYSTEM_PARAMETERS, pack
from identification.numerics.arrays import Array
from identification.numerics.spread import Spread
from identification.recording import Bench, Model, Recording
from identification.simulation.drive_loop import Loop, Response, respond, usual_loop

NAMES = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS)
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


def _response(
    stage: PlannedStage, nominal: PlannedModel, rng: np.random.Generator, share: float
) -> Response:
    """Return the response of the nominal model to the command of one stage.

    Args:
        stage: Command and weight.
        nominal: The model.
        rng: Random generator of the torque noise.
        share: Share of the noise variance that is in the true torque, and not only in the log.
    """
    moment, sensors = nominal.moment(stage.weight), nominal.sensors
    noise = share * sensors.torque_noise * rng.standard_normal(len(stage.command))
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
    response = _response(stage, nominal, rng, math.sqrt(0.5))
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
    stages: Sequence[PlannedStage], nominal: PlannedModel, names: Sequence[str], noise: int
) -> Replicate | None:
    """Return a simulated run of some stages with its sensitivities at the simulated values; None
    where the filter diverges.

    Args:
        stages: Commands and weights.
        nominal: The model.
        names: Names of the parameters that would be fitted.
        noise: Seed of the noise.
    """
    rng = np.random.default_rng(noise)
    motions = [motion(recorded(k, s, nominal, rng)) for k, s in enumerate(stages)]
    known = [m for m in motions if m is not None]
    if len(known) < len(stages):
        return None
    free = [INDEX[n] for n in names]
    vector = pack(nominal.values, nominal.alpha)
    begun = Point.of(known, vector, free, Model(), Noise(torque_noise(known)))
    point = optimise_breakaway_times(begun)
    point = replace(point, noise=likeliest_noise(point))
    _, _, residual, jacobian = point.linearised()
    inside = residual[: len(residual) - point.breakaways]
    neighbours = abs(float(np.mean(inside[1:] * inside[:-1])))
    if neighbours > MOST_WHITENESS * float(np.mean(inside**2)):
        return None
    inflation = inflation_by(point.experiment, jacobian.without(free.index(INDEX["J"])))
    return Replicate(replace(point, inflation=inflation), jacobian, residual, noise)


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


def likelihood_slope(point: Point) -> float:
    """Return the steepness of the likelihood at a point.

    If noise decides whether the joint stops or moves on, the errors of the linearised filter have a
    nonzero mean. The likelihood of other values is then far greater than that of the simulated
    values, and the stated intervals are wrong. With the gradient g of the log likelihood and
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
