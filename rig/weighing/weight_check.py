"""Checks the confirmed mass on the lever by the measured friction.

The reference is an accepted identification of the bench, or the friction of stages with other
masses in the same run. At each speed the friction is linear in the mass (eq. 13: the working load
is proportional to the contact force).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from identification.recording import Dataset, Recording
from rig.common.sample import Sample
from rig.config.sequence import Array
from rig.runs.run_record import Verdict, Weighing

if TYPE_CHECKING:
    # At run time these imports would load the drivers, which recordings are checked without.
    from rig.planning.plan import Plan, PlannedStage
    from rig.planning.reference import Reference

EDGES = np.geomspace(2e-3, 4.0, 67)  # edges of the speed bins, rad/s, the same for all motions
SPEED_WINDOW_S = 0.006
"""Time over which speed is computed, s: shorter than the slips of a loaded joint (20 ms)."""
SLOWEST_SHARE = 0.2
"""Least share of the greatest speed; below, friction is steep and the encoder coarse."""
FEWEST_SAMPLES = 100


@dataclass(frozen=True)
class FrictionLevel:
    """Measured friction against speed."""

    speed: Array  # mean speed in each bin, rad/s, shape (66,); 0 in empty bins
    torque: Array  # mean friction torque in each bin, N m, shape (66,)
    path: Array  # distance moved in each bin, rad, shape (66,), which is the weight of the bin


def friction_level(angle: Array, torque: Array, period_s: float) -> FrictionLevel | None:
    """Measure the friction, N m, of samples (n,) of an even period; None with too little motion."""
    half = max(1, round(0.5 * SPEED_WINDOW_S / period_s))
    if len(angle) < 2 * half + FEWEST_SAMPLES:
        return None
    speed = (angle[2 * half :] - angle[: -2 * half]) / (2 * half * period_s)
    middle = slice(half, len(angle) - half)
    step = np.diff(angle, prepend=angle[0])[middle]
    power_sign = np.sign(speed)
    magnitude = np.abs(speed)
    used = magnitude >= max(SLOWEST_SHARE * float(magnitude.max()), EDGES[0])
    if np.count_nonzero(used) < FEWEST_SAMPLES:
        return None
    way = (power_sign * step)[used]
    bins = np.clip(np.digitize(magnitude[used], EDGES) - 1, 0, len(EDGES) - 2)

    def summed(values: Array) -> Array:
        return np.asarray(np.bincount(bins, values, minlength=len(EDGES) - 1))

    path = summed(way)
    seen = path > 0.0
    safe = np.where(seen, path, 1.0)
    return FrictionLevel(
        speed=np.where(seen, summed(way * magnitude[used]) / safe, 0.0),
        torque=np.where(seen, summed(torque[middle][used] * step[used]) / safe, 0.0),
        path=np.where(seen, path, 0.0),
    )


TOLERANCE = 0.075
"""Tolerance of the mass as a share; the least error that must be detected is twice this."""
EMPTY_TOLERANCE_KG = 1.0  # largest measured mass, kg, with which an empty lever counts as empty
UNCERTAINTY_SHARE = 0.4
"""Largest standard error, as a share of the tolerance, for which the check can decide."""


_LEAST_FREEDOM = 0.5
SIGMAS = 2.0
"""Standard errors beyond the tolerance that contradict; a false alarm makes a run useless."""


@dataclass(frozen=True)
class LoadedLevel:
    """The friction level of a stage, and the mass on its label, kg."""

    stage: str
    weight_kg: float
    level: FrictionLevel


def tolerance_kg(weight_kg: float) -> float:
    """Return the tolerance of the measured mass against the confirmed mass, kg."""
    return TOLERANCE * weight_kg if weight_kg else EMPTY_TOLERANCE_KG


def weigh(
    item: LoadedLevel, reference: Reference | None, earlier: Sequence[LoadedLevel]
) -> Weighing:
    """Compare a stage's friction with its confirmed mass, by the best reference available."""
    if reference is not None:
        mass = _mass(item.level, reference)
        errors = (_mass(item.level, reference.shifted(name)) - mass for name in reference.values)
        return _judge(item, mass, math.hypot(*errors), f"the identification {reference.source}")
    if len({other.weight_kg for other in earlier}) < 2:
        text = (
            " yet: the check needs an accepted identification of this bench (--identification), or "
            "earlier stages of two different masses; look at the weight again"
        )
        return _unchecked(item.stage, item.weight_kg, text)
    found = _from_line(item.level, earlier)
    if found is None:
        text = ": the stages before it moved at other speeds"
        return _unchecked(item.stage, item.weight_kg, text)
    return _judge(item, *found, f"the stages {', '.join(other.stage for other in earlier)}")


def _unchecked(stage: str, weight_kg: float, text: str) -> Weighing:
    words = f"stage {stage}: the weight cannot be checked{text}"
    return Weighing(stage, weight_kg, Verdict.UNCHECKED, None, None, words)


def suspects(items: Sequence[LoadedLevel], reference: Reference | None) -> list[Weighing]:
    """Find the stages of a finished run whose mass differs from their label.

    With a reference each stage is judged by itself. Without a reference, a stage is reported if the
    other stages are mutually consistent; if this holds for several stages, the data do not decide
    between them, and all are reported.
    """
    if reference is not None:
        return [
            found
            for item in items
            if (found := weigh(item, reference, ())).verdict is Verdict.WRONG
        ]
    if _consistent(items):
        return []
    left_out = [[other for other in items if other is not item] for item in items]
    candidates = [
        item
        for item, others in zip(items, left_out, strict=True)
        if item.weight_kg and _consistent(others)
    ]
    return [_named(item, items, [c.stage for c in candidates]) for item in candidates]


def _named(item: LoadedLevel, items: Sequence[LoadedLevel], candidates: Sequence[str]) -> Weighing:
    others = [other for other in items if other is not item]
    mass, sigma = _from_line(item.level, others) or (None, None)
    words = (
        f"its friction is that of {mass or math.nan:.3g} kg, its label says {item.weight_kg:g} kg"
    )
    if len(candidates) > 1:
        words = (
            f"its mass may not be the {item.weight_kg:g} kg of its label; the label of one of "
            f"{', '.join(candidates)} is wrong, and an identification or a stage with one more "
            "mass would show which label"
        )
    words = f"stage {item.stage}: {words}; weigh it before using the data"
    return Weighing(item.stage, item.weight_kg, Verdict.WRONG, mass, sigma, words)


def _consistent(items: Sequence[LoadedLevel]) -> bool:
    """Whether each loaded stage agrees with the line through the others, or none exists."""
    for item in items:
        others = [other for other in items if other is not item]
        if not item.weight_kg or len({other.weight_kg for other in others}) < 2:
            continue
        found, allowed = _from_line(item.level, others), tolerance_kg(item.weight_kg)
        if found is None or found[1] > UNCERTAINTY_SHARE * allowed:
            continue
        if abs(found[0] - item.weight_kg) > allowed + SIGMAS * found[1]:
            return False
    return True


def _mass(level: FrictionLevel, reference: Reference) -> float:
    """Return the mass for which the friction of the reference gives the measured work, kg."""
    seen = level.path > 0.0
    speed, path = level.speed[seen], level.path[seen]
    excess = float(np.sum(path * (level.torque[seen] - reference.unloaded(speed))))
    return excess / float(np.sum(path * reference.per_kg(speed)))


def _judge(item: LoadedLevel, mass: float, sigma: float, reference: str) -> Weighing:
    allowed = tolerance_kg(item.weight_kg)
    found = (
        f"stage {item.stage}: by {reference} its friction is that of {mass:.3g} kg; "
        f"{item.weight_kg:g} kg were confirmed, and {allowed:.2g} kg of difference is the limit"
    )
    if not sigma <= UNCERTAINTY_SHARE * allowed:
        verdict = Verdict.UNCHECKED
        rest = f"but that is uncertain by {sigma:.2g} kg: the weight cannot be checked"
    elif abs(mass - item.weight_kg) <= allowed:
        verdict, rest = Verdict.RIGHT, "the weight is taken as right"
    else:
        # An empty lever has no friction by a weight: the cause is the bench or its torque unit.
        first = (
            "hang the right weight, or look for what else rubs"
            if item.weight_kg
            else "take every weight off, and look for what rubs, and for a changed torque "
            "constant or unit of the current"
        )
        verdict, rest = Verdict.WRONG, f"{first}, then go on with `rig resume`"
    return Weighing(item.stage, item.weight_kg, verdict, mass, sigma, f"{found}; {rest}")


def _from_line(level: FrictionLevel, others: Iterable[LoadedLevel]) -> tuple[float, float] | None:
    """Return the mass at which the straight lines through other stages' levels give the measured
    work, and its standard error.

    The result is None if there are no such lines. The standard error is computed from the scatter
    over the speed bins, which includes the work that the inertia exchanges between speeds, and the
    slope of friction.

    Each speed bin has its own line, fitted by least squares to the stages with motion in this bin.
    The weight of a bin is the reciprocal of the sum of the stages' reciprocal distances in this
    bin, so that the stage with the shortest distance dominates.
    """
    stages = list(others)
    masses = np.array([other.weight_kg for other in stages])
    paths = np.array([other.level.path for other in stages])
    torques = np.array([other.level.torque for other in stages])
    weight = np.where(paths > 0.0, 1.0, 0.0)
    count = weight.sum(axis=0)
    shared = (count >= 2) & (level.path > 0.0)
    mean_mass = _mean(masses[:, None] * weight, count)
    mean_torque = _mean(torques * weight, count)
    spread = (weight * (masses[:, None] - mean_mass) ** 2).sum(axis=0)
    shared &= spread > 0.0
    if float(level.path[shared].sum()) < 0.5 * float(level.path.sum()):
        return None
    rise = (weight * (masses[:, None] - mean_mass) * torques).sum(axis=0)
    slope = rise[shared] / spread[shared]
    unsure = np.divide(1.0, paths, out=np.zeros_like(paths), where=paths > 0.0).sum(axis=0)[shared]
    weight_of = slope / (1.0 / level.path[shared] + unsure)
    total = float(np.sum(weight_of))
    if not total > 0.0:
        return None
    masses_there = mean_mass[shared] + (level.torque[shared] - mean_torque[shared]) / np.where(
        slope, slope, np.inf
    )
    mass = float(np.sum(weight_of * masses_there)) / total
    squares = weight_of**2
    independent = total**2 / float(np.sum(squares))
    scatter = math.sqrt(float(np.sum(squares * (masses_there - mass) ** 2))) / total
    return mass, scatter * math.sqrt(independent / max(independent - 1.0, _LEAST_FREEDOM))


def _mean(weighted: Array, count: Array) -> Array:
    return np.asarray(weighted.sum(axis=0) / np.maximum(count, 1.0))


def off_label(dataset: Dataset, reference: Reference | None = None) -> list[Weighing]:
    """Find the recordings whose mass differs from their label, by a reference or two masses."""
    return suspects(_levels(dataset.recordings), reference)


def judged(dataset: Dataset) -> list[Weighing]:
    """Check the mass of each loaded recording by the recordings of other masses.

    Returns:
        One weighing for each loaded recording with enough motion; none with fewer than three
        different masses, of which two would always agree.
    """
    items = _levels(dataset.recordings)
    if len({item.weight_kg for item in items}) < 3:
        return []
    off = {found.stage: found for found in suspects(items, None)}
    sound = [item for item in items if item.stage not in off]
    return [
        off.get(item.stage)
        or weigh(item, None, [other for other in sound if other.weight_kg != item.weight_kg])
        for item in items
        if item.weight_kg
    ]


def comparable(dataset: Dataset, reference: Reference | None = None) -> bool:
    """Whether masses can be judged: by a reference, or by loaded stages of different masses."""
    masses = [recording.weight_mass for recording in dataset.recordings if not recording.hot_fire]
    return reference is not None or (
        len(set(masses)) >= 2 and sum(mass > 0 for mass in masses) >= 2
    )


def _levels(recordings: Iterable[Recording]) -> list[LoadedLevel]:
    found = []
    for recording in recordings:
        angle, torque = recording.channels.get("angle"), joint_torque(recording)
        rotary = recording.bench.motion == "rotary"
        if (
            angle is None
            or torque is None
            or recording.known_load
            or recording.hot_fire
            or not rotary
        ):
            continue
        level = friction_level(angle, torque, recording.period)
        if level is not None:
            found.append(LoadedLevel(recording.name, recording.weight_mass, level))
    return found


def joint_torque(recording: Recording) -> Array | None:
    """Return the torque at the joint, N m, or None if it was not measured."""
    torque, current = recording.channels.get("torque"), recording.channels.get("current")
    if torque is not None:
        return torque
    constant = recording.bench.torque_constant
    if current is None or constant is None:
        return None
    return np.asarray(current * constant * recording.bench.gear_ratio)


class Scale:
    """Friction levels of the stages of a run at low amplitude."""

    def __init__(self, reference: Reference | None = None) -> None:
        self._reference = reference
        self._seen: dict[str, LoadedLevel] = {}

    def weigh(self, stage: PlannedStage, level: FrictionLevel | None) -> Weighing:
        """Check a weight by the first pass; the level is kept unless the weight is wrong."""
        if level is None:
            text = (
                ": its first pass hardly moves the joint, even at "
                f"{stage.first_passes[-1].amplitude:.0%} amplitude; lengthen "
                "first_pass.duration_s or stiffen the drive"
            )
            return _unchecked(stage.name, stage.weight_kg, text)
        item = LoadedLevel(stage.name, stage.weight_kg, level)
        others = [other for name, other in self._seen.items() if name != stage.name]
        weighing = weigh(item, self._reference, others)
        if weighing.verdict is not Verdict.WRONG:
            self._seen[stage.name] = item
        return weighing


def measured_level(samples: Sequence[Sample], plan: Plan) -> FrictionLevel | None:
    """Return the friction level of the samples of a pass, or None if the joint hardly moved."""
    angle = np.array([sample.angle for sample in samples])
    current = np.array([sample.current for sample in samples])
    return friction_level(angle, current * plan.limits.torque_per_ampere, plan.cycle_s)
