"""Draws the torques that a host sends, open loop, and predicts the motion that these torques cause.

The host adds the torque of a weak spring, which keeps the joint near zero; how far a torque moves
the joint depends almost only on friction. The motion is predicted with the nominal machine, so that
an amplitude can be found that moves the machine well within its travel and speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from benchmarks.worlds.motion import Reach, command
from benchmarks.worlds.world import CENTRING_DAMPING, COMMAND_S, Array, Constants
from identification.numerics.compiled import compiled
from rig.results.prove.draw import log

OVER_STATIC = (1.15, 4.0)
"""Range of the ratio of the greatest torque sent to the static friction."""
LARGEST_SHARE = 0.85
"""Ratio of the greatest torque sent, without the torque of a steady load, to the greatest torque of
the machine.
"""
CENTRED = (0.6, 2.0)
"""Range of the ratio of the spring's torque at the end of the travel to the static friction."""
MOVED = 0.15
"""Least share of the travel that a recorded motion has; for less, the torque is increased."""
FASTER = (1.0, 2.0, 4.0, 8.0)
"""Factors on the speed of a course that are tried until the joint moves for a useful time: under a
slowly varying torque, the joint rests while the torque is below the static friction, and moves to
the end of its travel when the torque exceeds it.
"""
MOVING = 0.3
"""Least share of the time in motion that is useful."""
TRIES = 24
CHANGE = 1.12
"""Number of amplitudes that are tried, and the ratio of successive amplitudes."""
SUBSTEPS = 4
FAR = 1e9
(
    INERTIA, MC, MS, W_SF, VISCOUS, LOAD, LOAD_MC, LOAD_MS, W_SL, LOAD_VISCOUS,
    HUNG, ZERO, SPRING, DAMPING, LEVELS,
) = range(15)  # fmt: skip


class Load(NamedTuple):
    """Known load of one recording, at the joint.

    Attributes:
        moment: Moment of the contact force, N m.
        inertia: Inertia of known masses, kg m^2.
        hung: Greatest torque of the weight that turns with the joint, N m.
        zero: Angle at which the weight that turns with the joint hangs straight down, rad.
        steady: Torque that does not depend on the angle, N m.
    """

    moment: float = 0.0
    inertia: float = 0.0
    hung: float = 0.0
    zero: float = 0.0
    steady: float = 0.0

    def static(self, constants: Constants) -> float:
        """Return the static friction under this load, N m."""
        return constants.Ms + self.moment * constants.mu_s


class Course(NamedTuple):
    """A torque that is sent, N m, and the expected angle, rad, every :data:`COMMAND_S`."""

    torque: Array
    angle: Array


def centring(rng: np.random.Generator, constants: Constants, static: float, travel: float) -> float:
    """Draw the stiffness of the virtual spring, whose torque the host computes, N m/rad.

    Args:
        rng: Generator.
        constants: Constants of the machine.
        static: Greatest static friction under load, N m.
        travel: Travel of the machine, rad.
    """
    return max(static, constants.Ms) * float(rng.uniform(*CENTRED)) / travel


def course(
    rng: np.random.Generator,
    motion: str,
    times: tuple[float, float],
    machine: tuple[Constants, float, Reach, float],
    load: Load,
) -> Course:
    """Draw the torque of one recording, which begins at rest at zero.

    Args:
        rng: Generator.
        motion: Name of a shape.
        times: Length of the log, and time before the log begins, s.
        machine: Constants, greatest torque, limits of travel and speed, stiffness of the spring.
        load: The known load.
    """
    constants, peak, reach, stiffness = machine
    seed, most = int(rng.integers(1 << 62)), LARGEST_SHARE * peak
    size = min(load.static(constants) * log(*OVER_STATIC)(rng), most)
    values = _values(constants, load, stiffness)
    best, moved = Course(np.zeros(0), np.zeros(0)), -1.0
    for faster in FASTER:
        shape = _shape(np.random.default_rng(seed), motion, times, faster)
        tried = _within(values, shape, (size, most), reach)
        share = float(np.mean(np.diff(tried.angle) != 0.0))
        if share > moved:
            best, moved = tried, share
        if moved > MOVING:
            break
    return Course(np.asarray(best.torque - load.steady), best.angle)


def _shape(
    rng: np.random.Generator, motion: str, times: tuple[float, float], faster: float
) -> Array:
    """Return a course without scale, from -1 to 1 at most."""
    duration, lead = times
    path = command(rng, motion, faster * duration, faster * lead, Reach(1.0, FAR, FAR))
    at = np.arange(round((duration + lead) / COMMAND_S)) * faster
    shape = np.interp(at, np.arange(len(path)), path)
    return np.asarray(shape / max(float(np.abs(shape).max()), 1e-12))


def _within(values: Array, shape: Array, sizes: tuple[float, float], reach: Reach) -> Course:
    """Return the course, scaled down until the motion stays within travel and speed, or scaled up
    until the joint moves far enough.

    Args:
        values: Values of the nominal machine.
        shape: Course without scale.
        sizes: Size to begin with, and greatest size, N m.
        reach: Limits of travel and speed.
    """
    size, most = sizes
    chosen = shape * size
    path = _predicted(values, chosen)
    lowered = False
    for _ in range(TRIES):
        speed = float(np.abs(np.diff(path)).max()) / COMMAND_S
        far = max(float(np.abs(path).max()) / reach.travel, speed / reach.speed)
        if far > 1.0:
            size, lowered = size / CHANGE, True
        elif far < MOVED and size < most and not lowered:
            size = min(size * CHANGE, most)
        else:
            break
        chosen = shape * size
        path = _predicted(values, chosen)
    return Course(chosen, path)


def _values(constants: Constants, load: Load, stiffness: float) -> Array:
    out = np.zeros(LEVELS)
    out[[INERTIA, MC, MS, W_SF, VISCOUS]] = (
        constants.J + load.inertia,
        constants.Mc,
        constants.Ms,
        constants.omega_sf,
        constants.sigma_2,
    )
    out[[LOAD, LOAD_MC, LOAD_MS, W_SL, LOAD_VISCOUS]] = (
        load.moment,
        constants.mu_c,
        constants.mu_s,
        constants.omega_sL,
        constants.mu_2,
    )
    out[HUNG], out[ZERO], out[SPRING] = load.hung, load.zero, stiffness
    out[DAMPING] = 2.0 * CENTRING_DAMPING * math.sqrt(stiffness * constants.J)
    return out


@compiled
def _predicted(p: Array, torque: Array) -> Array:
    """Return the angle of the nominal machine at each sample of the torque.

    In one step, dry friction does not reverse the speed but reduces it to zero at most, so that a
    joint stopped by friction stays at rest.
    """
    out = np.zeros(len(torque))
    q, w, dt = 0.0, 0.0, COMMAND_S / SUBSTEPS
    for k in range(len(torque)):
        out[k] = q
        for _ in range(SUBSTEPS):
            push = torque[k] - p[SPRING] * q - p[HUNG] * math.sin(q - p[ZERO])
            push -= (p[DAMPING] + p[VISCOUS] + p[LOAD] * p[LOAD_VISCOUS]) * w
            level = p[MC] + (p[MS] - p[MC]) * math.exp(-((w / p[W_SF]) ** 2))
            level += p[LOAD] * (
                p[LOAD_MC] + (p[LOAD_MS] - p[LOAD_MC]) * math.exp(-((w / p[W_SL]) ** 2))
            )
            free = w + push * dt / p[INERTIA]
            lost = level * dt / p[INERTIA]
            w = free - lost if free > lost else (free + lost if free < -lost else 0.0)
            q += w * dt
    return out
