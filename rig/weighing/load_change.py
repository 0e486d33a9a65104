"""Checks that the load of a stage was the same from its first to its last half cycle.

A half cycle is the motion from one reversal of the command to the next. Work is compared and not
torque, so that the work of the inertia cancels. A weight that is taken off or falls changes the
friction of all later half cycles at once; warming and wear change it gradually, which is no alarm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from identification.recording import Dataset, Recording
from rig.config.sequence import Array
from rig.planning.reference import Reference
from rig.runs.run_record import Verdict, Weighing
from rig.weighing.weight_check import TOLERANCE, FrictionLevel, friction_level, joint_torque

FALSE_ALARM = 1e-4
"""Probability that half cycles with independent normal errors and no change give an alarm."""
LEAST_SHARE = 2.0 * TOLERANCE
"""Smallest change of the load that must be detected, as a share of the mass."""
BETTER = 3.0  # least ratio of the squared errors of a smooth drift to those of a step
SHORTEST_SHARE = 0.75
"""Least distance of a half cycle over the median; shorter ones, as of a fade-in, are slower."""
FEWEST_HALF_CYCLES = 4
"""Least number of half cycles: with fewer, none repeats another one before and after a change."""
WANTED_PIECES, MOST_PIECES = 24, 4
"""Wanted number of pieces of a stage, and greatest number of pieces of a half cycle."""


@dataclass(frozen=True)
class Change:
    """A change of the load within a stage."""

    # Change of the mass, kg; negative if weight was taken off. Without a reference its magnitude is
    # a lower bound, because the whole friction is then taken as that of the weight.
    mass_kg: float
    sigma_kg: float  # standard error of `mass_kg` by the scatter of the half cycles
    half_cycle: int
    half_cycles: int
    time_s: float
    recording: str


def changed_loads(
    dataset: Dataset, stages: Sequence[str], reference: Reference | None = None
) -> dict[str, tuple[Change, Weighing]]:
    """Find the loaded stages during which the load changed: change, and weighing, by stage."""
    found = {}
    for name in stages:
        recordings = [
            recording
            for recording in dataset.recordings
            if recording.stage == "loaded"
            and recording.weight_mass > 0.0
            and recording.bench.motion == "rotary"
            and (recording.name == name or recording.name.startswith(f"{name}["))
        ]
        change = load_change(recordings, reference)
        if change is not None:
            mass = recordings[0].weight_mass
            if abs(change.mass_kg) > 0.5 * LEAST_SHARE * mass:
                found[name] = change, _weighing(name, mass, change, reference)
    return found


def load_change(
    recordings: Sequence[Recording], reference: Reference | None = None
) -> Change | None:
    """Return the significant change of the load in the recordings of one stage, or None."""
    halves = [half for recording in recordings for half in _half_cycles(recording)]
    if not halves:
        return None
    median = float(np.median([half.path for half in halves]))
    halves = [half for half in halves if half.path >= SHORTEST_SHARE * median]
    if len(halves) < FEWEST_HALF_CYCLES:
        return None
    count = max(1, min(MOST_PIECES, math.ceil(WANTED_PIECES / len(halves))))
    pieces = [piece for k, half in enumerate(halves) for piece in half.pieces(k, count)]
    excess = _excess(pieces, recordings[0].weight_mass, reference)
    found = None if excess is None else _step(pieces, excess)
    if found is None:
        return None
    at, mass, sigma = found
    half = halves[pieces[at].half_cycle]
    return Change(
        mass, sigma, pieces[at].half_cycle + 1, len(halves), half.time_s, half.recording.name
    )


@dataclass(frozen=True)
class _HalfCycle:
    """The motion between two reversals: samples ``first`` to ``last`` of a recording."""

    recording: Recording
    travelled: Array
    first: int
    last: int
    forward: bool

    @property
    def path(self) -> float:
        return float(self.travelled[self.last - 1] - self.travelled[self.first])

    @property
    def time_s(self) -> float:
        time = self.recording.channels["time"]
        return float(time[self.first] - time[0])

    def pieces(self, number: int, count: int) -> Iterator[_Piece]:
        """Yield the half cycle in ``count`` pieces of equal distance."""
        travelled = self.travelled[self.first : self.last]
        ends = travelled[0] + self.path * np.arange(1, count) / count
        bounds = [0, *np.searchsorted(travelled, ends).tolist(), len(travelled)]
        torque = joint_torque(self.recording)
        assert torque is not None
        for part, (first, last) in enumerate(pairwise(bounds)):
            span = slice(self.first + first, self.first + last)
            level = friction_level(
                self.recording.channels["angle"][span], torque[span], self.recording.period
            )
            if level is not None:
                yield _Piece(level, number, (self.forward, part))


class _Piece(NamedTuple):
    """A part of a half cycle. Pieces of one ``kind`` have one direction and one place in it."""

    level: FrictionLevel
    half_cycle: int
    kind: tuple[bool, int]


def _half_cycles(recording: Recording) -> Iterator[_HalfCycle]:
    command = recording.channels.get("command")
    if (
        command is None
        or recording.known_load
        or "angle" not in recording.channels
        or joint_torque(recording) is None
    ):
        return
    steps = np.diff(command, prepend=command[0])
    moving = np.flatnonzero(steps)
    way = np.sign(steps[moving])
    turns = moving[1:][np.diff(way) != 0]
    travelled = np.cumsum(np.abs(steps))
    bounds = [0, *turns.tolist(), len(command)] if len(moving) else []
    forward = bool(way[0] > 0) if len(moving) else False
    for first, last in pairwise(bounds):
        yield _HalfCycle(recording, travelled, first, last, forward)
        forward = not forward


def _excess(pieces: Sequence[_Piece], mass: float, reference: Reference | None) -> Array | None:
    """Return each piece's load above the mean of its kind, kg, or None without friction."""
    excess = np.zeros(len(pieces))
    for kind in {piece.kind for piece in pieces}:
        mine = [k for k, piece in enumerate(pieces) if piece.kind == kind]
        levels = [pieces[k].level for k in mine]
        paths = np.array([level.path for level in levels])
        torques = np.array([level.torque for level in levels])
        speeds = np.array([level.speed for level in levels])
        total = paths.sum(axis=0)
        seen = total > 0.0
        paths, torques, total = paths[:, seen], torques[:, seen], total[seen]
        mean = (paths * torques).sum(axis=0) / total
        if reference is None:
            per_kg = np.full(len(total), float(total @ mean / total.sum()) / mass)
        else:
            per_kg = reference.per_kg((paths * speeds[:, seen]).sum(axis=0) / total)
        if not per_kg.min() > 0.0:
            return None
        excess[mine] = _common(paths, torques, per_kg)
    return excess


def _common(paths: Array, torques: Array, per_kg: Array) -> Array:
    """Fit torques by a function of speed, common to all half cycles, plus a load for each half
    cycle, and return the loads, kg, with mean zero.

    Strokes that reach different speeds are compared at the speeds that they share.
    """
    # The common torque of each bin is eliminated: it is the mean of the bin for given loads.
    total = paths.sum(axis=0)
    weight = paths * per_kg
    normal = np.diag((weight * per_kg).sum(axis=1)) - (weight / total) @ weight.T
    mean = (paths * torques).sum(axis=0) / total
    right = (weight * (torques - mean)).sum(axis=1)
    return np.asarray(np.linalg.lstsq(normal, right, rcond=1e-9)[0])


def _step(pieces: Sequence[_Piece], excess: Array) -> tuple[int, float, float] | None:
    """Fit a step at each piece in turn, beside the kinds' means, and return the best step: its
    piece, its size and its standard error, kg.

    The piece itself is left out, because the load changed within it. A whole half cycle is required
    on both sides: the first and last half cycles differ from the others on stick-slipping benches.
    The result is None if the step is not significant, or if a smooth drift explains the loads
    nearly as well.
    """
    # Imported late: most runs have no loaded stage, and none waits for it before its end.
    from scipy.special import stdtrit

    count = len(pieces)
    place = np.arange(count) / count
    kinds = sorted({piece.kind for piece in pieces})
    if count < len(kinds) + 3:
        return None
    means = np.column_stack([[float(piece.kind == kind) for piece in pieces] for kind in kinds])
    freedom = count - len(kinds) - 2
    best, greatest = None, -float(stdtrit(freedom, 0.5 * FALSE_ALARM / count))
    inside = [k for k, piece in enumerate(pieces) if 0 < piece.half_cycle < pieces[-1].half_cycle]
    for at in inside:
        left = place != place[at]
        step = (place > place[at]).astype(float)
        design = np.column_stack([step, means])[left]
        solution, _, rank, _ = np.linalg.lstsq(design, excess[left], rcond=None)
        if rank < design.shape[1]:
            continue
        rest = float(np.sum((excess[left] - design @ solution) ** 2))
        drift = np.column_stack([place, place**2, means])[left]
        smooth, *_ = np.linalg.lstsq(drift, excess[left], rcond=None)
        drifted = float(np.sum((excess[left] - drift @ smooth) ** 2))
        sigma = math.sqrt(rest / freedom * float(np.linalg.inv(design.T @ design)[0, 0]))
        size = float(solution[0])
        if abs(size) > greatest * sigma and drifted > BETTER * rest:
            best, greatest = (at, size, sigma), abs(size) / sigma if sigma else math.inf
    return best


def _weighing(name: str, mass: float, change: Change, reference: Reference | None) -> Weighing:
    least = "" if reference is not None else "at least "
    side = "less" if change.mass_kg < 0 else "more"
    words = (
        f"stage {name}: the load changed during the stage: from half cycle {change.half_cycle} "
        f"of {change.half_cycles} on ({change.recording}, {change.time_s:.1f} s), the friction is "
        f"that of {least}{abs(change.mass_kg):.2g} kg {side} than before; {mass:g} kg were "
        f"confirmed; look whether the weight fell, was taken off or touches something, and repeat "
        f"the stage"
    )
    return Weighing(
        name, mass, Verdict.WRONG, max(0.0, mass + change.mass_kg), change.sigma_kg, words
    )
