"""Proves the signs of motor, encoder and loops at a torque that just moves the joint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

from rig.commissioning.moving import SLOW_DEG_S, SMALL_DEG, explained
from rig.commissioning.record import SkippedError, StepRecord, WrongError
from rig.commissioning.setup import REST_S, Setup
from rig.config.sequence import approach
from rig.control.cycle import TripError
from rig.control.motion_proof import MotionWitness

LEAST_SHARE: Final = 1.0 / 16.0
"""First limit of torque and current, as a share of the low limits of a commissioning."""
GROWTH: Final = 1.25
"""Ratio of a limit to the limit before. A joint that breaks away is accelerated by at most a
quarter of its static friction, and by the difference of static and sliding friction.
"""
COUNTS: Final = 4.0  # travel, in counts of the motor encoder, that is a motion
DEAD_DEG: Final = 0.1
"""Travel of the joint after which a motor encoder that shows none counts as dead, deg."""
NOISE: Final = 2.0
"""Travel that is a motion, in units of the range of the angles while the joint rests."""
_HELD: Final = frozenset({"current_A", "torque_N_m"})
"""Limits of the drive that keep the torque small."""
ANNOUNCED: Final = (
    f"The drive is energised with {LEAST_SHARE:.0%} of its low current limit, and with more and "
    f"more of it until the joint just moves, by up to {SMALL_DEG:g} deg to each side; the power "
    "goes off at the first motion."
)


class _Push:
    """One command to one side, until the joint moves.

    Attributes:
        side: 1 or -1, the direction of the command.
        moved: 1 or -1, the direction of the motion by the motor encoder; 0 without a motion.
        joint: The same by the joint encoder.
        current_A: Sum of the currents in the direction of the command.
        last_A: The last of these currents.
        way_rad: Commanded travel.
    """

    def __init__(self, setup: Setup, side: int) -> None:
        self._servo, self._encoder = setup.devices.servo, setup.devices.encoder
        self._gear_ratio = setup.bench.machine.gear_ratio
        self._rest: list[tuple[float, float]] = []
        self._last = (math.nan, math.nan)
        steps = self._servo.limit_steps()
        self._counts = [(0.0 if steps is None else steps.angle_rad) or math.inf, math.inf]
        self.side, self.moved, self.joint, self.current_A = side, 0, 0, 0.0
        self.last_A = self.way_rad = 0.0

    def _look(self) -> tuple[float, float]:
        """Return the angles of motor and joint encoder, rad, and note the least change of each."""
        now = (self._servo.sample().motor_angle_rad / self._gear_ratio, self._encoder.sample()[1])
        for at, (angle, before) in enumerate(zip(now, self._last, strict=True)):
            if angle != before and not math.isnan(before):
                self._counts[at] = min(self._counts[at], abs(angle - before))
        self._last = now
        return now

    def rest(self, _: object = None) -> None:
        self._rest.append(self._look())

    def take(self, _: object = None) -> None:
        self.last_A = self.side * self._servo.sample().current_A
        self.current_A += self.last_A
        found = [
            direction(angle, before, COUNTS * count)
            for angle, before, count in zip(
                self._look(), zip(*self._rest, strict=True), self._counts, strict=True
            )
        ]
        self.moved, self.joint = found

    def coasted(self, angle: float) -> None:
        """Take the angle of the joint encoder after the power went off."""
        before = [joint for _, joint in self._rest]
        self.joint = direction(angle, before, self._counts[1]) or self.joint

    @property
    def ended(self) -> bool:
        """Whether the motor moves, or the joint without its motor encoder."""
        dead = self._last[0] in [motor for motor, _ in self._rest]
        way = abs(self._last[1] - self._rest[-1][1])
        return bool(self.moved) or (dead and bool(self.joint) and way > math.radians(DEAD_DEG))

    def targets(self, course: list[float]) -> Iterator[float]:
        for target in course:
            if self.ended:
                return
            yield target


def direction(angle: float, before: Iterable[float], least: float) -> int:
    """Return 1 or -1 for an angle beyond all before by ``least`` and by their noise, else 0."""
    low, high = min(before), max(before)
    beyond = max(angle - high, 0.0) + min(angle - low, 0.0)
    if not abs(beyond) >= max(least, NOISE * (high - low)) or not beyond:
        return 0
    return int(math.copysign(1.0, beyond))


def signs(setup: Setup, step: StepRecord) -> None:
    """Command a small travel to each side, with a limit of the drive's torque that grows from push
    to push until the joint moves; compare the direction of the motion with that of the command.

    The limit is one of current or torque in the drive. In a drive without such a limit, only the
    small error of the position keeps the torque small.

    Raises:
        WrongError: The joint moves against the command, or is moved by a load.
        SkippedError: The joint does not move.
    """
    servo, cycle_s = setup.devices.servo, setup.bench.cycle_s
    held = (_HELD & servo.limits_taken) - servo.lacks(cycle_s).limits
    if not held:
        setup.interview.tell(
            "note: this drive takes no limit of current or torque, so that only the small travel "
            "keeps the torque small: keep a hand on the emergency stop"
        )
    nominal = setup.devices.nominal
    assert nominal is not None
    moved: dict[int, _Push] = {}
    share = LEAST_SHARE / GROWTH
    while len(moved) < 2 and share < 1.0:
        share = min(share * GROWTH, 1.0) if held else 1.0
        for side in (1, -1):
            if side not in moved:
                setup.cycle.units = witness = MotionWitness(servo, nominal)
                with explained(setup, witness):
                    push = _push(setup, side, share)
                if push.ended:
                    moved[side] = push
    if not moved:
        torque = push.last_A * setup.limits.torque_per_ampere
        setup.stiffness_N_m_rad = torque / push.way_rad
        step.measure("stiffness of the position loop", setup.stiffness_N_m_rad, "N m/rad")
    else:
        step.measure("current limit that moves the joint", share * setup.wanted.current_A, "A")
    if len(moved) < 2:
        raise SkippedError(
            f"the joint does not move within {SMALL_DEG:g} deg at the low limit of the current: "
            "the signs are not proven before the small move"
        )
    up, down = moved[1], moved[-1]
    step.measure("motion after a command up", up.moved)
    step.measure("motion after a command down", down.moved)
    if not up.moved or not down.moved:
        raise WrongError(
            "the joint moves, but the motor encoder does not count: check the cable and the "
            "coupling of the motor encoder"
        )
    if up.moved == down.moved:
        raise WrongError(
            "the joint moves to the same side after commands to both sides: a load moves it, or "
            "the drive takes no commands; take the load off, or balance the joint"
        )
    if up.moved > down.moved:
        step.words = "motor, motor encoder and the loops of the drive have the right signs"
        return
    raise WrongError(_cause(up, down))


def _cause(up: _Push, down: _Push) -> str:
    found = "the joint moves against the command"
    if up.current_A < 0.0 and down.current_A < 0.0:
        return (
            f"{found}, and so does the current: the position loop or the speed loop of the drive "
            "has the wrong sign; correct it with the maker's tool"
        )
    if (up.joint, down.joint) == (-up.moved, -down.moved):
        return (
            f"{found} by the motor encoder, and with it by the joint encoder: the motor encoder "
            "counts the other way; swap its channels A and B, or reverse it with the maker's tool"
        )
    if (up.joint, down.joint) == (up.moved, down.moved):
        return (
            f"{found} by both encoders, although the current does not: two motor phases are "
            "swapped; swap them back, and repeat the commutation with the maker's tool"
        )
    return (
        f"{found}, although the current does not: two motor phases are swapped, or the motor "
        "encoder counts the other way; correct the wiring, and repeat the commutation with the "
        "maker's tool"
    )


def _push(setup: Setup, side: int, share: float) -> _Push:
    """Command a small travel to one side at a share of the low limits, until the joint moves."""
    cycle, bench = setup.cycle, setup.bench
    push = _Push(setup, side)
    with setup.power("signs", share) as here:
        rest = [here] * max(1, round(REST_S / bench.cycle_s))
        cycle.follow(rest, 0, "signs", push.rest)
        end = here + side * min(math.radians(SMALL_DEG), 0.5 * setup.limits.following_error)
        push.way_rad = abs(end - here)
        course = approach(here, end, math.radians(SLOW_DEG_S), bench.cycle_s).tolist()
        try:
            cycle.follow(push.targets(course + [end] * len(rest)), 0, "signs", push.take)
        except TripError:
            push.take()
            if not push.ended:
                raise
        # The power goes off without a ramp, which would go through a loop of the wrong sign.
        setup.devices.servo.disable()
    push.coasted(setup.devices.encoder.reading())
    return push
