"""Divides a recording into motion segments, from one rest to the next, for the filter (M5, M11)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from identification.filter.kalman import DIRECTION, FIRST, LAST, TORQUE_RATE
from identification.numerics.arrays import Array, BoolArray
from identification.prepare import contact_moment, drive_torque, evened, joint_angle, resting
from identification.recording import Recording
from identification.signals import quantum

LEAD = 12  # number of samples by which a segment starts before its first visible motion
TAIL = 20  # samples by which a segment ends before a rest: the filter does not know of the stop
LEAST_COUNTS = 20.0  # least travel of a segment, in encoder steps
FINE_STEPS = 8.0  # integration steps per sample near rest, where friction falls steeply
STEPS = 4.0  # integration steps per sample: a slow sine may stay on the falling branch of friction
ONSET_STEPS = 32.0  # integration steps per sample after a breakaway, where friction falls fast
FINE_SAMPLES = 30
RISING = 20
"""Samples before the first visible motion over which the torque's rate of rise is averaged."""
LEAST_RISE = 0.1  # least rate of rise of the torque over the recording's median; less is noise
STALLED = 0.01  # share of the greatest speed below which a segment counts as almost stopping
UNSURE = 0.1
"""Standard deviation, relative to the greatest speed, whose square is added to the variance of the
speed where a segment almost stops.
"""
ALIKE = 0.1  # greatest difference of matching half cycles over the longer displacement (M11)
INSTANTS = 64  # number of instants at which half cycles are compared


@dataclass(frozen=True)
class Motion:
    """A recording prepared for the filter. Arrays have shape (n,), at the joint, SI."""

    recording: Recording
    time: Array
    angle: Array  # angle as the encoder measured it, rad
    torque: Array  # mean torque over the period that ends at each sample, N m
    slope: Array  # rate of change of the torque within that period, N m/s
    moment: Array  # mean contact moment F_P L1 over that period, N m
    table: Array  # motion segments, shape (m, 4); columns of `kalman`
    seen: Array  # first sample of visible motion of each segment, shape (m,)
    steps: Array  # number of integration steps in the period that ends at each sample
    unsure: Array  # variance that is added to the variance of the speed at each sample, (rad/s)^2
    inside: BoolArray  # whether a sample is inside a segment
    extra_inertia: float  # known inertia added to J, kg m^2
    angle_variance: float  # variance of the quantisation error of the angle, rad^2

    def torque_at(self, when: Array) -> Array:
        """Return the torque, interpolated between centres of averaging periods, N m."""
        return np.interp(when, self.time - 0.5 * self.recording.period, self.torque)

    @property
    def breakaway_moment(self) -> Array:
        """F_P L1 at the start of each segment, N m, shape (m,)."""
        return self.moment[self.seen.astype(np.int64)]

    @cached_property
    def matching(self) -> BoolArray:
        """Whether two segments are matching half cycles (M11), of the same or of opposite
        directions, shape (m, m); true on the diagonal.

        A segment without a match matches all segments of its recording.
        """
        first, last = self.table[:, [FIRST, LAST]].astype(np.int64).T
        since = np.linspace(0.0, float(np.max(last - first)), INSTANTS).astype(np.int64)
        half_cycles = (
            self.angle[np.minimum(first[:, None] + since, last[:, None] - 1)]
            - self.angle[first, None]
        )
        half_cycles *= self.table[:, DIRECTION, None]
        reach = np.max(np.abs(half_cycles), axis=1)
        matching = np.empty((len(first), len(first)), dtype=bool)
        for j, half_cycle in enumerate(half_cycles):
            matching[j] = np.max(np.abs(half_cycles - half_cycle), axis=1) <= ALIKE * np.maximum(
                reach, reach[j]
            )
        matching[np.sum(matching, axis=1) < 2] = True
        return matching

    def static_crossing(self, static: Array | float) -> Array:
        """Return the time at which the torque of each segment first reaches ``static``, at the
        latest the time of visible motion, s, shape (m,).

        ``static`` is one level for all segments, N m, or one level for each segment, shape (m,).
        """
        half = 0.5 * self.recording.period
        out = np.empty(len(self.table))
        levels = np.broadcast_to(static, out.shape)
        for j, (first, _, side, _) in enumerate(self.table):
            window = slice(int(first) - 1, int(self.seen[j]) + 2)
            when = self.time[window] - half
            excess = side * self.torque[window] - levels[j]
            above = np.flatnonzero(excess >= 0.0)
            if above.size == 0:
                out[j] = when[1 + int(np.argmax(excess[1:]))]
            elif above[0] == 0:
                out[j] = when[0]
            else:
                k = int(above[0])
                out[j] = when[k - 1] + (when[k] - when[k - 1]) * excess[k - 1] / (
                    excess[k - 1] - excess[k]
                )
        return np.minimum(out, self.time[self.seen.astype(np.int64)])

    def peak_torque(self) -> float:
        """Return the median over segments of the greatest torque before visible motion, N m."""
        peaks = [
            np.max(side * self.torque[int(first) : int(seen) + 1])
            for (first, _, side, _), seen in zip(self.table, self.seen, strict=True)
        ]
        return float(np.median(peaks))


def motion(recording: Recording) -> Motion | None:
    """Return the motion segments of a recording that start from rest, or None if the filter does
    not apply to the recording.

    The filter applies to evenly sampled recordings with a quantised joint or motor angle, a
    measured torque or current, and at least two segments. Single samples may be missing or late;
    segments with longer gaps are left out.
    """
    basis = _basis(recording)
    if isinstance(basis, str):
        return None
    recording, holes, angle, step = basis
    smoothed = np.convolve(np.pad(angle, 2, mode="edge"), np.ones(5) / 5.0, mode="valid")
    velocity = np.gradient(smoothed, recording.time)
    at = recording.time
    measured = {"torque", "current"} & recording.averaged
    torque = drive_torque(recording, at - 0.5 * recording.period if measured else at, velocity)
    if not measured:
        torque = 0.5 * (torque + np.concatenate((torque[:1], torque[:-1])))
    extra = recording.known_inertia
    if recording.known_load:
        torque = torque + recording.known_torque(angle)
    table, seen = _table(angle, step, holes)
    if len(table) < 2:
        return None
    table[:, TORQUE_RATE] = _rises(at, torque, table, seen)
    steps = np.full(len(at), STEPS)
    inside = np.zeros(len(at), dtype=bool)
    for first, last in table[:, [FIRST, LAST]].astype(np.int64):
        inside[first:last] = True
        steps[max(first, last - FINE_SAMPLES) : last] = FINE_STEPS
    slow = np.abs(velocity) < 0.3 * float(np.max(np.abs(velocity)))
    steps[slow] = FINE_STEPS
    for first in table[:, FIRST].astype(np.int64):
        steps[first : first + LEAD + FINE_SAMPLES] = ONSET_STEPS
    moment = contact_moment(recording, at, angle)
    return Motion(
        recording=recording,
        time=at,
        angle=angle,
        torque=np.ascontiguousarray(torque),
        slope=np.gradient(torque, at),
        moment=0.5 * (moment + np.concatenate((moment[:1], moment[:-1]))),
        table=table,
        seen=seen,
        steps=steps,
        unsure=_unsure(at, angle, step, velocity, inside, table, seen),
        inside=inside,
        extra_inertia=extra,
        angle_variance=step * step / 12.0,
    )


def lacking(recording: Recording) -> str:
    """Return what a recording without motion segments lacks."""
    basis = _basis(recording)
    return basis if isinstance(basis, str) else "two breakaways from rest"


def _basis(recording: Recording) -> tuple[Recording, BoolArray, Array, float] | str:
    """Return the even recording, gaps, angle and encoder step, rad; or what it lacks."""
    if not ({"torque", "current"} & recording.channels.keys()):
        return "a measured torque or current"
    even = evened(recording)
    if even is None:
        return "even sampling"
    angle = joint_angle(even[0])
    step = 0.0 if angle is None else quantum(angle)
    if angle is None or step == 0.0:
        return "a quantised encoder"
    return *even, angle, step


def _unsure(
    time: Array,
    angle: Array,
    step: float,
    velocity: Array,
    inside: BoolArray,
    table: Array,
    seen: Array,
) -> Array:
    """Return variance added to the speed's where a segment almost stops, (rad/s)^2, (n,)."""
    # Whether the joint stops there depends on the noise; without the added variance one segment
    # that almost stops would outweigh all others.
    period = float(np.median(np.diff(time)))
    fastest = float(np.quantile(np.abs(velocity[inside] if np.any(inside) else velocity), 0.99))
    if fastest == 0.0:
        return np.zeros(len(time))
    width = max(3, math.ceil(step / (STALLED * fastest * period)))
    out = np.zeros(len(time))
    for (_, last, side, _), visible in zip(table, seen.astype(np.int64), strict=True):
        moved = side * (angle[visible + width : int(last)] - angle[visible : int(last) - width])
        for k in np.flatnonzero(moved < STALLED * fastest * width * period):
            out[visible + k : visible + k + width + 1] = (UNSURE * fastest) ** 2
    return out


def _rises(time: Array, torque: Array, table: Array, seen: Array) -> Array:
    """Return the torque's rate of rise before each breakaway, N m/s, shape (m,)."""
    out = np.empty(len(table))
    for j, (side, last) in enumerate(zip(table[:, DIRECTION], seen.astype(np.int64), strict=True)):
        window = slice(max(last + 1 - RISING, 0), last + 1)
        out[j] = side * np.polyfit(time[window] - time[last], torque[window], 1)[0]
    typical = float(np.median(out))
    return np.maximum(out, LEAST_RISE * typical) if typical > 0.0 else np.full(len(out), np.inf)


def _table(angle: Array, step: float, holes: BoolArray) -> tuple[Array, Array]:
    """Return segments that start from rest without gaps, and their first visible motion."""
    rest = resting(angle)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (~rest).astype(np.int64), [0]))))
    rows: list[tuple[float, float, float, float]] = []
    seen: list[int] = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        end = min(int(stop), len(angle) - 1)
        travel = angle[end] - angle[max(start - 1, 0)]
        last = int(stop) - TAIL if stop < len(angle) else int(stop)
        begin = max(int(start) - LEAD, 1)
        while begin < start and not rest[begin]:
            begin += 1
        if np.any(holes[begin : int(stop)]):
            continue
        if start == 0 or begin >= start or abs(travel) < LEAST_COUNTS * step or last - begin < LEAD:
            continue
        visible = int(start)
        while abs(angle[visible] - angle[start - 1]) < 1.5 * step:
            visible += 1
        if last <= visible + 2 or _reverses(angle[visible:last], np.sign(travel), step):
            continue
        rows.append((begin + 1, last, float(np.sign(travel)), 1.0))
        seen.append(visible)
    columns = TORQUE_RATE + 1
    return np.array(rows, dtype=np.float64).reshape(-1, columns), np.array(seen, dtype=np.float64)


def _reverses(angle: Array, side: float, step: float) -> bool:
    """Return whether a segment reverses, without rest, by more than encoder noise."""
    forward = side * angle
    return bool(np.max(np.maximum.accumulate(forward) - forward) > 3.0 * step)


@dataclass(frozen=True)
class Noise:
    """Levels of white and correlated noise of the measured torque, and of the angle's noise."""

    torque: float  # white part of the torque noise, N m rms over a period
    # Noise of the angle in addition to the quantisation error of the encoder, rad rms.
    angle: float = 0.0
    # Correlated part of the torque noise, a first-order process, N m rms; zero for white noise.
    correlated: float = 0.0
    # Time over which the autocorrelation of the correlated part falls to 1/e, s.
    correlation_s: float = 0.0

    @property
    def whole_torque(self) -> float:
        """Standard deviation of the torque noise, white and correlated part together, N m."""
        return math.hypot(self.torque, self.correlated)

    def louder(self, factor: float) -> Noise:
        """Return a copy with the white part of the torque noise multiplied by a factor."""
        return replace(self, torque=factor * self.torque)

    def drawn(
        self, rng: np.random.Generator, shape: tuple[int, int], period: float, share: float
    ) -> Array:
        """Return simulated torque noise, times ``share``, N m, a row each, every ``period`` s."""
        white = np.asarray(share * self.torque * rng.standard_normal(shape), dtype=np.float64)
        if self.correlated == 0.0:
            return white
        pole = math.exp(-period / self.correlation_s)
        shocks = share * self.correlated * rng.standard_normal(shape)
        shocks[:, 1:] *= math.sqrt(1.0 - pole * pole)
        return np.asarray(
            white + scipy.signal.lfilter([1.0], [1.0, -pole], shocks, axis=1), dtype=np.float64
        )
