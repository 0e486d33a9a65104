"""Simulates a planned experiment on the nominal model: motion, recording, and sensitivities at the
simulated values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.inertia.estimating_equations import inflation_by
from identification.estimate.inertia.half_cycles import Replicate
from identification.estimator_settings import DEFAULT
from identification.filter.breakaway_times import optimise_breakaway_times
from identification.filter.likelihood import Point
from identification.filter.noise import Noise
from identification.filter.noise_level import HUBER_THRESHOLD, likeliest_noise, torque_noise
from identification.filter.segments import motion
from identification.model.parameters import INDEX, pack
from identification.numerics.arrays import Array
from identification.recording import Bench, Model, Recording
from identification.simulate.servo_loop import Loop, Response, respond, usual_loop

NOISE_SEED = 0
ASSUMED, SEEN = (0.75, 1.35), (0.96, 1.04)
"""Ratios of the velocity gain to the nominal gain, of two more drives on which a proposal must be
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

    A proposal must be identifiable with all three drives.
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
