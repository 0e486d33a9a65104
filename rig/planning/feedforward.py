"""Friction feed-forward: computes torque offsets for the drive (60B2h) from identified friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.canopen.cia402_objects import FRAMES_WITH_OFFSET
from identification.model import feedforward
from identification.model.parameters import STRIBECK_TERMS
from identification.recording import Bench as BenchConstants
from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.common.sample import Sample
from rig.config.bench import Bench, bus_overload
from rig.config.canopen import Bus
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection
from rig.config.sequence import Array
from rig.planning.reference import moment_per_kg, read_values

UNLOADED = ("Mc", "sigma_2", "J")
LOADED = ("mu_c", "mu_2")
RISES = STRIBECK_TERMS[:2]
"""Parameter names of Coulomb level, static level and Stribeck speed in eq. 9 and in eq. 12."""
CATCH_UP_SHARE = 0.1
"""Speed, as a share of the speed limit, at which damping balances the greatest stiffness torque."""


@dataclass(frozen=True)
class Feedforward:
    """Identified parameters of a bench for the feed-forward torque."""

    # Values of the parameters by name, SI; the load parameters may be missing. A rise of friction
    # toward rest that the identification did not determine is zero.
    values: Mapping[str, float]
    alpha: float
    moment_per_kg: float
    source: str
    sha256: str
    # Parameters of the rise of friction toward rest that the identification did not determine.
    left_open: tuple[str, ...] = ()

    @property
    def remark(self) -> str | None:
        """Message to the operator on undetermined parameters, or None."""
        if not self.left_open:
            return None
        return (
            f"feed-forward: {self.source} leaves {', '.join(self.left_open)} undetermined: the "
            "feed-forward torque contains no rise of friction toward rest, and a stiffness "
            "replaces the rise; a run without feed-forward, in which the joint comes to rest and "
            "breaks away again, determines the rise"
        )

    def missing(self, loaded: bool) -> tuple[str, ...]:
        """Return the parameters that a stage needs and the identification did not determine."""
        return tuple(
            name for name in (*UNLOADED, *(LOADED if loaded else ())) if name not in self.values
        )


@dataclass(frozen=True)
class Offsets:
    """Torque offsets of one stage, one per cycle, shape (n,) each."""

    torque: Array  # torque of the commanded motion, N m
    stiffness: Array  # torque per angle error, N m/rad; fades out while the command rests
    damping: Array  # torque per speed error, N m s/rad; fades out while the command rests
    angle: Array  # commanded joint angle that belongs to the sample before the cycle, rad
    # Commanded joint speed that belongs to the last measured speed before the cycle, rad/s.
    speed: Array
    reach: float  # greatest stiffness torque, N m
    limit: float  # limit on the magnitude of the sent torque, N m


class Compensator:
    """Returns the torque offset of each cycle of one excitation, in order."""

    def __init__(self, offsets: Offsets, gear_ratio: float, cycle_s: float) -> None:
        columns = (offsets.torque, offsets.stiffness, offsets.damping, offsets.angle, offsets.speed)
        self._rows = zip(*(column.tolist() for column in columns), strict=True)
        self._reach, self._limit = offsets.reach, offsets.limit
        self._gear_ratio, self._cycle_s = gear_ratio, cycle_s
        self._before: float | None = None

    def __call__(self, sample: Sample | None) -> float:
        """Return the next torque offset, N m; feedback needs complete samples, damping two."""
        torque, stiffness, damping, commanded, speed = next(self._rows)
        angle = (
            sample.motor_angle / self._gear_ratio if sample is not None and sample.fresh else None
        )
        if angle is not None:
            pull = stiffness * (commanded - angle)
            torque += min(max(pull, -self._reach), self._reach)
            if self._before is not None:
                torque += damping * (speed - (angle - self._before) / self._cycle_s)
        self._before = angle
        return float(min(max(torque, -self._limit), self._limit))


def load_feedforward(path: Path, bench: BenchConstants) -> Feedforward:
    """Read the result of ``rig identify`` on an earlier run of this bench.

    Raises an InputError if it does not determine the parameters of the unloaded joint, other than
    the rise of friction toward rest.
    """
    names = (*UNLOADED, *LOADED, *(name for rise in RISES for name in rise[1:]))
    values, alpha = read_values(path, names)
    left_open = []
    for kinetic, *rise in RISES:
        if kinetic in values and (unknown := [name for name in rise if name not in values]):
            left_open += unknown
            values |= {rise[0]: values[kinetic], rise[1]: 1.0}
    found = Feedforward(
        values, alpha, moment_per_kg(bench), str(path), sha256_file(path), tuple(left_open)
    )
    if missing := found.missing(loaded=False):
        raise InputError([_open(path, name) for name in missing])
    return found


def require_torque_offset(bench: Document[Bench]) -> None:
    """Reject (InputError) a bench whose drive cannot add a torque that is sent in every cycle."""
    value = bench.value
    if isinstance(value.servo, DbcServoSection):
        if value.servo.torque_offset is not None:
            return
        text = (
            "missing; feed-forward needs the signal of a torque that the drive adds to the torque "
            "of its controller; state the signal, or run without feed-forward"
        )
        raise InputError(bench.problem(("servo", "torque_offset"), text))
    if not isinstance(value.bus, Bus):
        text = (
            "feed-forward needs target and torque offset at one time, but a serial line "
            "transmits the offset later"
        )
        raise InputError(
            bench.problem(
                ("bus", "interface"), f"{text}: use a CANopen drive, or run without feed-forward"
            )
        )
    mode = value.servo.commanded(value.servo.device_data(bench.path.parent))
    if mode != "csp":
        text = f"feed-forward needs servo.mode csp, but this drive is commanded in {mode}"
        raise InputError(bench.problem(("servo", "mode"), f"{text}: run without feed-forward"))
    bench.require(
        (("bus", "bitrate"), t) for t in bus_overload(FRAMES_WITH_OFFSET, value.bus, value)
    )


def stage_offsets(
    model: Feedforward,
    targets: Array,
    weight_kg: float,
    cycle_s: float,
    torque_limit: float,
    speed_limit: float,
) -> Offsets:
    """Return the torque offsets of a stage, computed from its commands, shape (n,).

    Args:
        model: Identified parameters of the bench.
        targets: Joint angles, rad, one per cycle; each is reached one cycle after it is sent.
        weight_kg: Mass on the lever.
        cycle_s: Control cycle, s.
        torque_limit: Torque limit of the run, N m.
        speed_limit: Speed limit of the run, rad/s. A joint far from its command, as with soft
            gains, returns with at most :data:`CATCH_UP_SHARE` of this speed.
    """
    moment = model.moment_per_kg * weight_kg
    if missing := model.missing(loaded=moment > 0.0):
        raise InputError([_open(Path(model.source), name) for name in missing])
    torque = feedforward.feedforward(targets, cycle_s, model.values, model.alpha, moment)
    speed = feedforward.commanded_speed(targets, cycle_s)
    gains = feedforward.gains(model.values["J"], cycle_s)
    share = np.abs(feedforward.motion(targets, cycle_s))
    # When target k is sent, the last sample belongs to cycle k - 1, in which the joint should
    # reach target k - 2.
    return Offsets(
        torque,
        gains.stiffness * share,
        gains.damping * share,
        np.concatenate([np.repeat(targets[:1], 2), targets])[: len(targets)],
        np.concatenate([np.zeros(2), speed])[: len(speed)],
        gains.damping * CATCH_UP_SHARE * speed_limit,
        torque_limit,
    )


def _open(path: Path, name: str) -> str:
    return (
        f"{path}: parameters.{name}: not identified, but feed-forward needs it: identify a run "
        "that determines this parameter"
    )
