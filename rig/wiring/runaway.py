"""Finds a joint that runs away: a drive whose loop has the wrong sign accelerates the joint when it
should brake it, or away from the position that it should follow.

Every threshold follows from the bench: from the noise of the speeds before the order, from the
resolution of the angles, from the time between two samples, and from the deceleration that the
drive promises (6085h). A load that the drive can brake accelerates the joint by less than this
deceleration, and only until the drive executes the order.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from statistics import median
from typing import Final, NamedTuple

from drivers.errors import DeviceError

REACTION: Final = 2
"""Number of samples until the ramp shows: the first contains the order, in the second it acts."""
NOISE: Final = 4.0  # ratio of a change of the speed that is not noise to the median change
PAST: Final = 32  # number of samples from which the noise of the speeds is found
VOTES: Final = 2
"""Number of speeds in one sample, or of samples in succession with one speed, that show a runaway.
One wrong bit changes one speed, in two samples with opposite signs.
"""

SIGNS: Final = (
    "look for two swapped motor phases, a motor encoder that counts the other way, and a position "
    "or speed loop of the wrong sign in the drive, then go through `rig commission`, which proves "
    "the signs at a small torque"
)
"""Remedy for a joint that runs away."""


class RunawayError(DeviceError):
    """The joint runs away; only switching the power off stops it."""


class Seen(NamedTuple):
    """The joint in one sample."""

    time_s: float
    speed_rad_s: float  # joint speed as the drive reports it, rad/s
    drive_rad: float  # joint angle by the encoder of the drive, rad
    joint_rad: float = math.nan  # joint angle by the joint encoder, rad; NaN without one
    # Joint angle that is commanded in this sample, rad; NaN without one. A drive reaches it by the
    # next sample, some drives at once.
    target_rad: float = math.nan


class Runaway:
    """Judges the motion of a joint, sample by sample.

    Three speeds are compared: as the drive reports it, and by the changes of both angles. A wrong
    unit of the reported speed does not matter, because each speed is compared with itself.

    Args:
        deceleration_rad_s2: Deceleration that the drive promises; if it is NaN, a speed must double
            to count as a runaway.
        count_rad: Upper bound of the resolution of the drive's angle at the joint, rad; 0 if
            unknown. The resolution of each angle is the least change of it so far.

    Attributes:
        speed_rad_s: Speed in the sample that shows a runaway, rad/s.
        limit_rad_s: Greatest speed in this sample that would be none, rad/s.
    """

    def __init__(self, deceleration_rad_s2: float, count_rad: float = 0.0) -> None:
        self._deceleration = deceleration_rad_s2
        self._counts = [count_rad, count_rad, 0.0]
        self._last: Seen | None = None
        self._step_s = self._target_rad_s = self._fastest_rad_s = 0.0
        self._left = [math.inf] * 3
        self._off = [0.0] * 3
        self._approach = 0.0
        self._speeds: deque[tuple[float, float, float]] = deque(maxlen=PAST)
        self._limits: tuple[float, ...] | None = None
        self._doubted: tuple[float, ...] = (0.0,) * 3
        self.speed_rad_s = self.limit_rad_s = 0.0

    def see(self, seen: Seen) -> None:
        """Store a sample."""
        last, self._last = self._last, seen
        self._step_s = step_s = 0.0 if last is None else seen.time_s - last.time_s
        if last is None or step_s <= 0.0:
            return
        drive, joint = seen.drive_rad - last.drive_rad, seen.joint_rad - last.joint_rad
        for at, moved in enumerate((drive, drive, joint)):
            if moved and math.isfinite(moved):
                self._counts[at] = min(self._counts[at] or math.inf, abs(moved))
        error = seen.target_rad + last.target_rad - seen.drive_rad - last.drive_rad
        if math.isfinite(error * drive):
            self._approach += 0.5 * error * drive
        now = seen.speed_rad_s, drive / step_s, joint / step_s
        self._speeds.append(now)
        low = min(last.target_rad, seen.target_rad)
        high = max(last.target_rad, seen.target_rad)
        for at, angle in enumerate((seen.drive_rad, seen.drive_rad, seen.joint_rad)):
            off = max(angle - high, 0.0) + min(angle - low, 0.0)
            leaves = abs(off) > REACTION * self._counts[at] and now[at] * off > 0.0
            self._left[at] = min(self._left[at], abs(now[at])) if leaves else math.inf
            self._off[at] = abs(off)
        self._target_rad_s = abs(seen.target_rad - last.target_rad) / step_s
        if self._target_rad_s > self._fastest_rad_s:
            self._fastest_rad_s = self._target_rad_s

    def leaves(self) -> bool:
        """Return whether the joint moves away from its target, is faster than when it left it, and
        faster than the target by more than a load accelerates it.
        """
        self._doubted = (0.0,) * 3
        return self._faster(self._target_rad_s)

    @property
    def leaving(self) -> bool:
        """Whether the joint moves away from its target in the last sample."""
        return not all(map(math.isinf, self._left))

    @property
    def against(self) -> bool:
        """Whether the joint moves away from its target, and has moved away from it rather than
        towards it so far: the integral of the error over the travel, which is positive also of a
        joint that overshoots, is negative.
        """
        return self.leaving and self._approach < -((REACTION * self._counts[0]) ** 2)

    def escapes(self, far_rad: float = math.inf) -> bool:
        """Return what :meth:`leaves` returns, compared with the fastest motion of the target so
        far; to be called in each sample. Of a joint that is farther than ``far_rad`` from its
        target, the speed is compared only with that at which it left the target.
        """
        return self._faster(self._fastest_rad_s, far_rad)

    def _faster(self, target_rad_s: float, far_rad: float = math.inf) -> bool:
        if not self.leaving:
            self._doubted = (0.0,) * 3
            return False
        growth = REACTION * self._step_s * self._deceleration
        least = target_rad_s + (target_rad_s if math.isnan(growth) else growth)
        return self._vote(
            tuple(
                max(left, 0.0 if off > far_rad else least) + noise
                for left, off, noise in zip(
                    self._left, self._off, self._noise(self._step_s), strict=True
                )
            )
        )

    def order(self, cycle_s: float) -> None:
        """Take the last sample as that of the order to brake, with samples every ``cycle_s``."""
        self._doubted = (0.0,) * 3
        self._limits = None
        if self._speeds:
            growth = REACTION * cycle_s * self._deceleration
            self._limits = tuple(
                abs(speed) + (abs(speed) if math.isnan(growth) else growth) + noise
                for speed, noise in zip(self._speeds[-1], self._noise(cycle_s), strict=True)
            )

    def grows(self) -> bool:
        """Return whether the joint is now faster than a load explains since the order."""
        if self._limits is None:
            # The first two samples after the order show the speed at the order.
            self.order(self._step_s)
            return False
        return self._step_s > 0.0 and self._vote(self._limits)

    def _noise(self, step_s: float) -> list[float]:
        """Return the change of each speed between two samples that may be noise."""
        past = list(self._speeds)[:-1]
        noise = [0.0, 0.0, 0.0]
        for at, count in enumerate(self._counts):
            changes = [abs(b[at] - a[at]) for a, b in pairwise(past)]
            usual = median(changes) if len(changes) > VOTES else 0.0
            noise[at] = NOISE * (0.0 if math.isnan(usual) else usual) + REACTION * count / step_s
        return noise

    def _vote(self, limits: tuple[float, ...]) -> bool:
        """Return whether enough speeds of the last sample are over their limits."""
        now = self._speeds[-1]
        signs = tuple(
            math.copysign(1.0, speed) if abs(speed) > limit else 0.0
            for speed, limit in zip(now, limits, strict=True)
        )
        again = any(s and s == d for s, d in zip(signs, self._doubted, strict=True))
        self._doubted = signs
        if not (again or signs.count(1.0) >= VOTES or signs.count(-1.0) >= VOTES):
            return False
        at = next(n for n, sign in enumerate(signs) if sign)
        self.speed_rad_s, self.limit_rad_s = abs(now[at]), limits[at]
        return True
