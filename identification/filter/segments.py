"""Stretches of motion: where a recording moves, from one rest to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from identification.contact_force import contact_moment
from identification.even import evened
from identification.filter.segment_table import DIRECTION, FIRST, LAST, TORQUE_RATE
from identification.numerics.arrays import Array, BoolArray
from identification.prepare import drive_torque, joint_angle, resting
from identification.recording import Recording
from identification.signals import quantum

LEAD = 12
"""Samples before the first visible motion at which a stretch that starts from rest begins."""
TAIL = 20
"""Samples before the next rest at which it ends: there the filter cannot know yet that the shaft will stop."""
LEAST_COUNTS = 20.0
"""A stretch moves at least this many encoder steps."""
FINE_STEPS = 8.0
"""Integration steps per sample near rest, where friction falls steeply."""
STEPS = 4.0
"""Those elsewhere: under a slow sine friction falls over all of its speeds, and errors of one step a period add up."""
ONSET_STEPS = 32.0
"""Those right after a breakaway: friction's fall multiplies the error of every step, and the inertia follows."""
FINE_SAMPLES = 30
RISING = 20
"""Samples before the first visible motion over which the torque's rise is taken."""
LEAST_RISE = 0.1
"""Rise that a stretch has at least, over the recording's median: what noise leaves of a slower one is not known."""
STALLED = 0.01
"""Share of the greatest speed below which a stretch all but stops."""
UNSURE = 0.1
"""Deviation that its speed has afterwards, over the greatest speed."""
ALIKE = 0.1
"""Greatest difference of two strokes at any time, over the longer of them, up to which they are the same motion."""
INSTANTS = 64
"""Instants at which that is looked at."""


@dataclass(frozen=True)
class Motion:
    """A recording as the prediction-error filter sees it. Arrays have shape (n,), at the joint, SI.

    Attributes:
        recording: Where it came from.
        time: s.
        angle: rad, as the encoder counted.
        torque: Mean torque over the period that ends at each sample, N m.
        slope: Its slope within that period, N m/s.
        moment: Mean F_P L1 over that period, N m.
        table: Stretches for the kernel, shape (m, 4).
        seen: First sample of each stretch that has visibly moved, shape (m,).
        steps: Integration steps per sample.
        unsure: Variance that the speed gains at each sample, (rad/s)^2.
        inside: Samples inside a stretch.
        extra_inertia: Known inertia added to J, kg m^2.
        angle_variance: Of the encoder's quantisation, rad^2.
    """

    recording: Recording
    time: Array
    angle: Array
    torque: Array
    slope: Array
    moment: Array
    table: Array
    seen: Array
    steps: Array
    unsure: Array
    inside: BoolArray
    extra_inertia: float
    angle_variance: float

    def torque_at(self, when: Array) -> Array:
        """Return the torque at any time, linear between the centres of the periods it was averaged over, N m."""
        return np.interp(when, self.time - 0.5 * self.recording.period, self.torque)

    @property
    def breakaway_moment(self) -> Array:
        """F_P L1 where each stretch begins to move, N m, shape (m,)."""
        return self.moment[self.seen.astype(np.int64)]

    @property
    def alike(self) -> BoolArray:
        """Which stretches make the same motion, either way, as each does, itself among them, shape (m, m).

        All of the recording's, where no other does.
        """
        first, last = self.table[:, [FIRST, LAST]].astype(np.int64).T
        since = np.linspace(0.0, float(np.max(last - first)), INSTANTS).astype(np.int64)
        strokes = self.angle[np.minimum(first[:, None] + since, last[:, None] - 1)] - self.angle[first, None]
        strokes *= self.table[:, DIRECTION, None]
        reach = np.max(np.abs(strokes), axis=1)
        alike = np.empty((len(first), len(first)), dtype=bool)
        for j, stroke in enumerate(strokes):
            alike[j] = np.max(np.abs(strokes - stroke), axis=1) <= ALIKE * np.maximum(reach, reach[j])
        alike[np.sum(alike, axis=1) < 2] = True
        return alike

    def static_crossing(self, static: Array | float) -> Array:
        """Return when each stretch's torque first reaches ``static``, at the latest when it has visibly moved, s.

        ``static`` is one level for all, N m, or one for each, shape (m,).
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
                out[j] = when[k - 1] + (when[k] - when[k - 1]) * excess[k - 1] / (excess[k - 1] - excess[k])
        return np.minimum(out, self.time[self.seen.astype(np.int64)])

    def peak_torque(self) -> float:
        """Return the median over stretches of the greatest torque before visible motion, N m."""
        peaks = [
            np.max(side * self.torque[int(first) : int(seen) + 1])
            for (first, _, side, _), seen in zip(self.table, self.seen, strict=True)
        ]
        return float(np.median(peaks))


def motion(recording: Recording) -> Motion | None:
    """Return the stretches of a recording that start from rest, or None where the filter does not apply.

    It applies to evenly sampled recordings with a quantised joint or motor angle, a measured torque or current and at
    least two breakaways. Single samples may be missing or late; stretches with longer holes are left out.
    """
    if not ({"torque", "current"} & recording.channels.keys()):
        return None
    even = evened(recording)
    if even is None:
        return None
    recording, holes = even
    angle = joint_angle(recording)
    step = 0.0 if angle is None else quantum(angle)
    if angle is None or step == 0.0:
        return None
    velocity = np.gradient(np.convolve(angle, np.ones(5) / 5.0, mode="same"), recording.time)
    at = recording.time
    measured = {"torque", "current"} & recording.averaged
    torque = drive_torque(recording, at - 0.5 * recording.period if measured else at, velocity)
    if not measured:
        torque = 0.5 * (torque + np.concatenate((torque[:1], torque[:-1])))
    extra = 0.0
    if recording.pendulum is not None:
        extra = recording.pendulum.inertia
        torque = torque + recording.pendulum.torque(angle, recording.bench.gravity)
    table, seen = _table(angle, step, holes)
    if len(table) < 2:
        return None
    table[:, TORQUE_RATE] = _rises(at, torque, table, seen)
    steps = np.full(len(at), STEPS)
    inside = np.zeros(len(at), dtype=bool)
    for first, last, _, _ in table.astype(np.int64):
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
        unsure=_unsure(at, angle, step, velocity, table, seen),
        inside=inside,
        extra_inertia=extra,
        angle_variance=step * step / 12.0,
    )


def _unsure(time: Array, angle: Array, step: float, velocity: Array, table: Array, seen: Array) -> Array:
    """Return the variance that the speed gains where a stretch all but stops, (rad/s)^2, shape (n,).

    Whether the shaft stops there or goes on hangs on the least noise, which the fall of friction multiplies: a filter
    that is linear about its prediction would be sure of what nobody can know, and one such stretch would outweigh all
    others.
    """
    period = float(np.median(np.diff(time)))
    fastest = float(np.quantile(np.abs(velocity), 0.99))
    width = max(3, math.ceil(step / (STALLED * fastest * period)))
    out = np.zeros(len(time))
    for (_, last, side, _), visible in zip(table, seen.astype(np.int64), strict=True):
        moved = side * (angle[visible + width : int(last)] - angle[visible : int(last) - width])
        for k in np.flatnonzero(moved < STALLED * fastest * width * period):
            out[visible + k : visible + k + width + 1] = (UNSURE * fastest) ** 2
    return out


def _rises(time: Array, torque: Array, table: Array, seen: Array) -> Array:
    """Return how fast the torque rises toward each breakaway, N m/s, shape (m,); infinite where it rises nowhere."""
    out = np.empty(len(table))
    for j, (side, last) in enumerate(zip(table[:, DIRECTION], seen.astype(np.int64), strict=True)):
        window = slice(max(last + 1 - RISING, 0), last + 1)
        out[j] = side * np.polyfit(time[window] - time[last], torque[window], 1)[0]
    typical = float(np.median(out))
    return np.maximum(out, LEAST_RISE * typical) if typical > 0.0 else np.full(len(out), np.inf)


def _table(angle: Array, step: float, holes: BoolArray) -> tuple[Array, Array]:
    """Return the kernel's table of stretches that start from rest and have no holes, and where each visibly moved.

    The torque's rise is left at one.
    """
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
    """Whether a stretch turns back by more than its encoder's noise without coming to rest."""
    forward = side * angle
    return bool(np.max(np.maximum.accumulate(forward) - forward) > 3.0 * step)
