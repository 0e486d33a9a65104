"""Friction feed-forward: an identification of the bench turned into torque that its drive adds (60B2h)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.cia402_servo import FRAMES_WITH_OFFSET
from identification.model import compensation
from identification.recording import Bench as BenchConstants
from rig.bench import Bench, Bus, bus_overload
from rig.configuration import Document
from rig.dbc import DbcServoSection
from rig.errors import InputError
from rig.provenance import sha256_file
from rig.reference import moment_per_kg, read_identification
from rig.sample import Sample
from rig.sequence import Array

UNLOADED = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
LOADED = ("mu_c", "mu_s", "omega_sL", "mu_2")


@dataclass(frozen=True)
class Feedforward:
    """What is known of a bench, to compute torque from.

    Attributes:
        values: Parameter name to value, SI; those of the load may be missing.
        alpha: Stribeck exponent.
        moment_per_kg: Contact moment of one kilogram on the lever, N m.
        source: The result file.
        sha256: Of that file.
    """

    values: Mapping[str, float]
    alpha: float
    moment_per_kg: float
    source: str
    sha256: str

    def missing(self, loaded: bool) -> tuple[str, ...]:
        """Return the parameters that a stage needs and the identification does not give."""
        return tuple(name for name in (*UNLOADED, *(LOADED if loaded else ())) if name not in self.values)


@dataclass(frozen=True)
class Offsets:
    """Torque offsets of one stage, one a cycle, shape (n,) each.

    Attributes:
        torque: What the commanded motion takes, N m.
        damping: Torque per speed error, N m s/rad; fades out where nothing is commanded to move.
        speed: Commanded joint speed that belongs to the speed measured last before the cycle, rad/s.
        limit: Greatest magnitude that is sent, N m.
    """

    torque: Array
    damping: Array
    speed: Array
    limit: float


class Compensator:
    """Gives the torque offset of each cycle of one excitation, in order.

    Args:
        offsets: Of the stage.
        gear_ratio: Motor turns per joint turn.
        cycle_s: Control cycle, s.
    """

    def __init__(self, offsets: Offsets, gear_ratio: float, cycle_s: float) -> None:
        self._rows = zip(offsets.torque.tolist(), offsets.damping.tolist(), offsets.speed.tolist(), strict=True)
        self._limit = offsets.limit
        self._span = gear_ratio * cycle_s
        self._before: float | None = None

    def __call__(self, sample: Sample | None) -> float:
        """Return the torque offset to send next, N m, within its limit.

        Args:
            sample: Of the cycle before; None in the first. What is not fresh, or has no fresh one before it, damps
                nothing.
        """
        torque, damping, commanded = next(self._rows)
        angle = sample.motor_angle if sample is not None and sample.fresh else None
        if angle is not None and self._before is not None:
            torque += damping * (commanded - (angle - self._before) / self._span)
        self._before = angle
        return float(min(max(torque, -self._limit), self._limit))


def load_feedforward(path: Path, bench: BenchConstants) -> Feedforward:
    """Read the result of ``rig identify`` on an earlier run of this bench.

    Raises:
        InputError: It cannot be read, is no such result, or leaves open a parameter of the unloaded joint.
    """
    raw = read_identification(path)
    try:
        known = {name: raw["parameters"].get(name, {}).get("value") for name in (*UNLOADED, *LOADED)}
        values = {name: float(value) for name, value in known.items() if value is not None and math.isfinite(value)}
        alpha = float(raw["alpha"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}; run `rig identify` again") from error
    found = Feedforward(values, alpha, moment_per_kg(bench), str(path), sha256_file(path))
    if missing := found.missing(loaded=False):
        raise InputError([_open(path, name) for name in missing])
    return found


def require_torque_offset(bench: Document[Bench]) -> None:
    """Refuse a bench whose drive cannot add a torque that is sent once a cycle.

    Raises:
        InputError: Says why, with the place in the bench file.
    """
    value = bench.value
    if isinstance(value.servo, DbcServoSection):
        text = "feed-forward needs the torque offset 60B2h, which this drive's own frames lack; run without it"
        raise InputError(bench.problem(("servo", "kind"), text))
    if not isinstance(value.bus, Bus):
        text = "feed-forward needs the torque offset in the instant of the target; a serial line brings it later"
        raise InputError(bench.problem(("bus", "interface"), f"{text}: use a CANopen drive, or run without it"))
    bench.require((("bus", "bitrate"), t) for t in bus_overload(FRAMES_WITH_OFFSET, value.bus, value))


def stage_offsets(model: Feedforward, targets: Array, weight_kg: float, cycle_s: float, limit: float) -> Offsets:
    """Compute the torque offsets of a stage from what it will command, shape (n,).

    Args:
        model: What is known of the bench.
        targets: Joint angles, rad, one a cycle; each is reached one cycle after it is sent.
        weight_kg: Mass on the lever.
        cycle_s: Control cycle, s.
        limit: Torque limit of the run, N m.

    Raises:
        InputError: The stage is loaded, and the identification leaves open a parameter of the load.
    """
    moment = model.moment_per_kg * weight_kg
    if missing := model.missing(loaded=moment > 0.0):
        raise InputError([_open(Path(model.source), name) for name in missing])
    torque = compensation.feedforward(targets, cycle_s, model.values, model.alpha, moment)
    speed = compensation.commanded_speed(targets, cycle_s)
    damping = compensation.damping(model.values, model.alpha, moment, cycle_s)
    share = np.abs(compensation.motion(targets, cycle_s))
    # When cycle k is sent, the last sample is that of cycle k - 1, in which the joint was to arrive at target k - 2.
    behind = np.concatenate([np.zeros(2), speed])[: len(speed)]
    return Offsets(torque, damping * share, behind, limit)


def _open(path: Path, name: str) -> str:
    return f"{path}: parameters.{name}: not identified; feed-forward needs it: identify a run in which this can be seen"
