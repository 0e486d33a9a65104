"""One connection to the bench during a commissioning: low limits, power, motion, power off."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol, TypeVar

from drivers.errors import DeviceError
from drivers.homing import IN_PLACE, NO_HOMING, Homes, HomingOffer, HomingOrder
from drivers.interfaces import ServoLimits, ServoState
from rig.commissioning.record import StepRecord, WrongError
from rig.config.bench import Bench
from rig.config.sequence import approach
from rig.control.cycle import Cycle
from rig.planning.limits import Limits
from rig.planning.plan import bench_limits, servo_limits
from rig.runs.recorder import Recorder
from rig.terminal.prompt import Asker, InputEndedError
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import require_within_own, require_written
from rig.wiring.off import OffProof
from rig.wiring.teardown import SafeState, give_back, make_safe

_T = TypeVar("_T")


class Interview(Protocol):
    """Interface to the person at the bench."""

    how: str

    def tell(self, words: str) -> None:
        """Show a message that needs no answer."""
        ...

    def agrees(self, words: str) -> bool:
        """Ask for consent to an action, which only an explicit yes is; may stop all."""
        ...

    def angle_deg(self, words: str) -> float | None:
        """Ask for the true joint angle, deg; return None if it is not known."""
        ...


class AutomaticInterview:
    """Agrees to every step (``--yes``, simulated benches only)."""

    how = "--yes"

    def __init__(self, screen: Screen, angle_deg: float | None = None) -> None:
        self._screen = screen
        self._angle_deg = angle_deg

    def tell(self, words: str) -> None:
        """Show the message."""
        self._screen.say(words, err=False)

    def agrees(self, words: str) -> bool:
        """Show the question and agree."""
        self.tell(f"{words} yes (--yes)")
        return True

    def angle_deg(self, words: str) -> float | None:
        """Return the angle given on the command line."""
        return self._angle_deg


class TypedInterview:
    """Asks the operator at the terminal; a stop signal interrupts a question."""

    how = "typed"

    def __init__(
        self, screen: Screen, asker: Asker, stop: StopButton, angle_deg: float | None = None
    ) -> None:
        self._screen = screen
        self._asker = asker
        self._stop = stop
        self._angle_deg = angle_deg

    def tell(self, words: str) -> None:
        """Show the message."""
        self._screen.say(words, err=False)

    def agrees(self, words: str) -> bool:
        """Ask until yes, no or abort is typed; an empty answer means no.

        Raises:
            OperatorStopError: The operator pressed Ctrl-C or typed ``abort``, or the input ended.
        """
        while True:
            typed = self._ask(f"{words} yes, no or abort [no]: ").lower()
            if typed in ("y", "yes"):
                return True
            if typed in ("", "n", "no"):
                return False
            self.tell(f"{typed!r} is not one of `yes`, `no`, `abort`")

    def angle_deg(self, words: str) -> float | None:
        """Ask for an angle, deg; an empty answer means None; raises as :meth:`agrees`.

        The angle of the command line is the answer to the first question: later the joint has
        moved.
        """
        if self._angle_deg is not None:
            given, self._angle_deg = self._angle_deg, None
            return given
        while True:
            typed = self._ask(f"{words} (empty: not known): ")
            if not typed:
                return None
            try:
                return float(typed.replace(",", "."))
            except ValueError:
                self.tell(f"{typed!r} is not an angle in degrees")

    def _ask(self, words: str) -> str:
        try:
            with self._stop.interruptible():
                typed = self._asker.ask(words)
        except InputEndedError as error:
            raise OperatorStopError(f"stopped at a question: {error}") from error
        except KeyboardInterrupt as error:
            raise OperatorStopError("stopped by the operator at a question") from error
        if typed.lower() == "abort":
            raise OperatorStopError("aborted by the operator at a question")
        return typed


FASTEST_DEG_S: Final = 12.0
"""Default limit on the joint speed, deg/s; at most a quarter of the limit of the bench."""
SPEED_SHARE: Final = 0.25
TORQUE_SHARE: Final = 0.6
"""Torque and current limits of a commissioning, as a share of those of the bench."""
REST_S: Final = 0.2


@dataclass(frozen=True)
class HomeRequest:
    """A homing by a method of 6098h, with the true angle there and the longest time, or None."""

    method: int
    home_deg: float | None = None
    time_limit_s: float | None = None

    @property
    def in_place(self) -> bool:
        """Whether the joint does not move in this homing."""
        return self.method in IN_PLACE


@dataclass
class Setup:
    """A connected bench."""

    bench: Bench
    devices: Devices
    interview: Interview
    stop: StopButton
    recorder: Recorder
    limits: Limits
    cycle: Cycle
    # Limits stored in the drive before the commissioning; None until the limits are read.
    own: ServoLimits | None = None
    # State in which the drive was left after it was last energised, or in which it was found if it
    # was not off at the start; else None.
    safe: SafeState | None = None
    home: HomeRequest | None = None
    true_deg: float | None = None  # true joint angle as given by the operator, or None if unknown
    # Joint torque per position error of a drive that did not move the joint within the small travel
    # of the step `signs`; else None.
    stiffness_N_m_rad: float | None = None

    @classmethod
    def of(
        cls,
        bench: Bench,
        devices: Devices,
        interview: Interview,
        stop: StopButton,
        recorder: Recorder,
        fastest_deg_s: float = FASTEST_DEG_S,
        home: HomeRequest | None = None,
    ) -> Setup:
        """Return the setup of a bench whose link is open."""
        limits = bench_limits(bench)
        limits = dataclasses.replace(
            limits,
            speed=min(math.radians(fastest_deg_s), SPEED_SHARE * limits.speed),
            torque=TORQUE_SHARE * limits.torque,
            current=TORQUE_SHARE * limits.current,
        )
        cycle = Cycle(limits, bench.cycle_ns, devices, recorder, stop, lambda *_: None)
        recorder.begin(cycle.start_ns)
        return cls(bench, devices, interview, stop, recorder, limits, cycle, home=home)

    @cached_property
    def homing_offer(self) -> HomingOffer:
        """The homing that the drive supports; the drive is asked once."""
        servo = self.devices.servo
        return servo.homing_offer() if isinstance(servo, Homes) else NO_HOMING

    @cached_property
    def off(self) -> OffProof:
        """Proves that the drive is off."""
        return self.devices.off_proof(bench_limits(self.bench))

    @property
    def homes_in_place(self) -> bool:
        """Whether a homing without motion sets the drive's zero."""
        home = self.home
        return home is not None and home.in_place and not self.homing_offer.problem(home.method)

    @property
    def wanted(self) -> ServoLimits:
        """The low limits, as written into the drive."""
        return servo_limits(self.limits, self.bench)

    def prepare(self, share: float = 1.0) -> None:
        """Map process data and write the low limits, torque and current times ``share``."""
        servo, bench, low = self.devices.servo, self.bench, self.wanted
        wanted = dataclasses.replace(
            low, torque_N_m=share * low.torque_N_m, current_A=share * low.current_A
        )
        self.devices.prepare(bench.cycle_s)
        if self.own is None:
            own, unheld = servo.read_limits(), servo.lacks(bench.cycle_s).limits
            require_within_own(wanted, own, servo.limit_steps(), servo.limit_places, unheld)
            self.own = own
        servo.write_limits(wanted)
        require_written(servo, wanted, bench.cycle_s)

    @contextmanager
    def power(self, what: str, share: float = 1.0) -> Iterator[float]:
        """Energise the drive, hold the joint, and switch the power off at the end in any case;
        yields the joint angle that is held, rad. The drive gives at most a ``share`` of the low
        limits of torque and current.

        Raises:
            WrongError: The drive could not be verified to be without power.
        """
        cycle, servo = self.cycle, self.devices.servo
        with self._energised(what, servo.enable, share):
            here = servo.sample().motor_angle_rad / self.bench.machine.gear_ratio
            cycle.ask_reset()
            cycle.begin(here)
            yield here

    @contextmanager
    def homing(self, order: HomingOrder, step: StepRecord) -> Iterator[None]:
        """Energise in homing mode; at the end, also after an error, take the power off, select the
        bench's mode again and read the mode back (6061h).

        Raises:
            WrongError: The drive could not be verified to be without power.
            DeviceError: The mode could not be selected.
        """
        servo = self.devices.servo
        assert isinstance(servo, Homes)  # the homing is offered
        ended = False
        try:
            with self._energised("homing", lambda: servo.begin_homing(order)) as held:
                known = {(item.name, item.value) for item in step.measured}
                for name, value in held.items():
                    words = f"written and read back, {name}"
                    if (words, str(value)) not in known:
                        step.measure(words, value)
                yield
            ended = True
        finally:
            try:
                shown, usual = servo.end_homing()
            except DeviceError as failure:
                step.measure("mode of operation afterwards, 6061h", f"not restored: {failure}")
                if ended:
                    raise
            else:
                later = "" if shown == usual else f", {usual} after the drive is switched on"
                step.measure("mode of operation afterwards, 6061h", f"{shown}{later}")

    @contextmanager
    def _energised(self, what: str, energise: Callable[[], _T], share: float = 1.0) -> Iterator[_T]:
        """Energise, and take the power off at the end, also after an error; verify that."""
        cycle, servo = self.cycle, self.devices.servo
        self.recorder.event(cycle.now_ns, "power on", step=what)
        done = False
        try:
            self.prepare(share)
            yield energise()
            done = True
        finally:
            self.safe = make_safe(
                servo,
                cycle.watch,
                self.devices.link.clock,
                self.bench.cycle_ns,
                brake=not done,
                hurry=self.stop.hurry(),
                watched=self.devices.link.has_watchdog,
                insistent=not self.devices.link.has_watchdog,
                off=self.off,
                insist=self.devices.insist,
            )
            cycle.end()
        self.recorder.event(cycle.now_ns, "power off", step=what, state=self.safe.state)
        if not self.safe.verified:
            raise WrongError(self.safe.message)

    def rest(self, angle: float, seconds: float = REST_S) -> None:
        """Hold the joint at an angle."""
        self.cycle.follow([angle] * max(1, round(seconds / self.bench.cycle_s)), 0, "hold")

    def go(self, start: float, end: float, speed: float) -> None:
        """Move the joint to an angle with a peak speed, rad/s, and rest there."""
        self.cycle.follow(approach(start, end, speed, self.bench.cycle_s).tolist(), 0, "move")
        self.rest(end)

    def clear(self) -> None:
        """Clear a fault that a step has caused; the drive stays off."""
        servo = self.devices.servo
        if servo.state() is ServoState.FAULT:
            servo.reset_fault()

    def give_back(self) -> tuple[BaseException, ...]:
        """Restore the drive's own limits after the drive was verified off."""
        if self.own is None or (self.safe is not None and not self.safe.verified):
            return ()
        return give_back(self.devices.servo, self.own, self.safe or SafeState(True, "off"))
