"""Proves that a drive is off: by its state, its current and the motion of the joint.

The statusword alone proves nothing: a drive whose power stage is stuck obeys the controlword, and
current goes on flowing. A drive counts as off if over :data:`WINDOW_S` its state is de-energised,
its current stays at the zero of its sensor, and the joint rests. A joint that still coasts, and a
current that still decays, are waited for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, Final, TypeVar

from drivers.clock import NS, Clock
from drivers.errors import DeviceError, StateError
from drivers.interfaces import Encoder, Servo, ServoState
from rig.common.errors import StorageError

T = TypeVar("T")


def words_of(error: BaseException) -> str:
    """Return an exception's class and message, even if its ``__str__`` fails."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - the class alone is shown if the message fails
        return type(error).__name__


class Steps:
    """Runs steps in order, and stores their errors."""

    def __init__(self) -> None:
        self.problems: list[str] = []  # text of each error
        # Exceptions other than device errors, storage errors and Ctrl-C, each once.
        self.unforeseen: list[BaseException] = []
        self.interrupted = False  # whether Ctrl-C interrupted a step
        self.cut = ""  # why the power was cut instead of a ramp; empty if it was not

    def attempt(self, step: Callable[[], object]) -> BaseException | None:
        """Run one step; store its error, if any, and return it."""
        return self.result(step)[1]

    def result(self, step: Callable[[], T]) -> tuple[T | None, BaseException | None]:
        """Run one step; return its value and None, or None and its error, which is stored."""
        try:
            return step(), None
        except KeyboardInterrupt as error:
            self.problems.append("interrupted again while stopping")
            self.interrupted = True
            return None, error
        except (DeviceError, StorageError) as error:
            self.problems.append(str(error))
            return None, error
        except BaseException as error:  # noqa: BLE001 - a defect must not keep the power on
            words = f"unforeseen {words_of(error)}"
            if words not in self.problems:
                self.unforeseen.append(error)
            self.problems.append(words)
            return None, error

    def take_first(self, others: Steps) -> None:
        """Store the first error of steps that were repeated, and whether one was interrupted."""
        self.problems += others.problems[:1]
        self.unforeseen += others.unforeseen[:1]
        self.interrupted = self.interrupted or others.interrupted

    def state(self, servo: Servo) -> ServoState | None:
        """Read the drive's state; return None if the read fails."""
        return self.result(servo.state)[0]


WINDOW_S: Final = 0.05  # shortest time, s, over which current and motion are observed
LEAST_READINGS: Final = 8
PATIENCE_S: Final = 2.0  # longest time, s, for which a joint may coast after the power went off
TURN_WINDOWS: Final = 2
"""Windows in succession in which a joint must rest: about a turning point one seems to rest."""
STILL_WINDOWS: Final = 4  # the same number for a joint that was seen moving
DECAY_WINDOWS: Final = 3
"""Windows after which no current may flow in a motor at rest; it decays in milliseconds."""
REQUEST_INTERVAL_NS: Final = NS // 200
OFFSET_SHARE: Final = 0.02  # greatest zero error of a current sensor, in units of the rated current
DRIFT_SHARE: Final = 0.005
"""Greatest change of this error during a session, in units of the rated current."""
REST_SHARE: Final = 0.005
"""Greatest speed of a joint at rest, in units of the speed limit of the bench."""
REST_RAD_S: Final = 0.01  # greatest speed of a joint at rest, rad/s, if no speed limit is known
STEPS: Final = 2.0  # units by which a reading at rest may change
_FAILURES: Final = 3
BEFORE_PROMPT: Final = "before the weight prompt"
HANDS_OFF: Final = (
    "do not touch the weights or the joint; switch the main supply off, and wait until the joint "
    "rests"
)


@dataclass(frozen=True)
class Proof:
    """What was seen of a drive that should be off."""

    state: ServoState | None  # state that the drive reports; None if it could not be read
    # Motor current, A: the mean of the window, or the rms value if this is larger because the
    # current alternates; None if the drive reports none.
    current_A: float | None = None
    # Speed of the joint in the window, by the encoder that moved faster; None if no encoder gave an
    # angle.
    motion_rad_s: float | None = None
    doubt: str = ""  # why the drive does not count as off; empty if it is off
    # Whether the joint encoder gave the angles of the window; None if it was not observed.
    joint_read: bool | None = None

    @property
    def off(self) -> bool:
        """Whether state, current and motion show that the drive is off."""
        return not self.doubt

    @property
    def seen(self) -> dict[str, float | None]:
        """Current and motion, for the record of an event."""
        return {"current_A": self.current_A, "motion_rad_s": self.motion_rad_s}

    def record(self) -> dict[str, Any]:
        """Return the record for a result file."""
        return {
            "off": self.off,
            "state": "unknown" if self.state is None else self.state.value,
            "current_A": self.current_A,
            "motion_rad_s": self.motion_rad_s,
            "doubt": self.doubt,
            "joint_read": self.joint_read,
        }


def energised_doubt(state: ServoState) -> str:
    """Return why a drive in an energised state is not off."""
    return f"the drive is in {state.value!r}; it must be de-energised"


def seen_words(current_A: float | None, motion_rad_s: float | None, joint_read: bool | None) -> str:
    """Return current and motion of a drive that is off as the end of a sentence."""
    if motion_rad_s is None:
        return ""
    current = "current not reported" if current_A is None else f"{abs(current_A):.2f} A"
    by = " by the motor alone, because the joint encoder could not be read"
    return f", {current}, joint at rest{by if joint_read is False else ''}"


@dataclass
class _Window:
    """Readings of one window: currents, A; times, s, and angles, rad; errors of the encoder."""

    currents: list[float] = field(default_factory=list)
    motor: list[tuple[float, float]] = field(default_factory=list)
    joint: list[tuple[float, float]] = field(default_factory=list)
    encoder: Steps = field(default_factory=Steps)


class OffProof:
    """Observes one drive; learns the zero of its current sensor from the first proof.

    Args:
        encoder: The joint encoder, or None to observe the motor alone.
        speed_limit_rad_s: Speed limit of the bench, at the joint; NaN if it is not known.
        current_limit_A: Current limit of the bench; it or the rated current counts, if smaller.
    """

    def __init__(
        self,
        servo: Servo,
        clock: Clock,
        encoder: Encoder | None = None,
        speed_limit_rad_s: float = math.nan,
        current_limit_A: float = math.nan,
    ) -> None:
        self._servo, self._encoder, self._clock = servo, encoder, clock
        self._speed_limit, self._current_limit = speed_limit_rad_s, current_limit_A
        # Reading of the current sensor without current, or None before the first proof.
        self.zero_A: float | None = None
        self._noise_A = 0.0
        self._flowed = ""
        self._unsettled = 0

    def prove(self, steps: Steps | None = None, patience_s: float = PATIENCE_S) -> Proof:
        """Observe the drive by requests until it is proved off, or until the patience ends. Nothing
        is commanded, and no error is raised.

        If the motor carried current while the joint rested and the drive reported off, every later
        proof fails too: a position loop that is still active may need so little current at times
        that a later window looks off.

        Args:
            steps: Stores the errors of the reads.
            patience_s: Longest time for which the joint may coast, s.
        """
        steps = steps or Steps()
        found = [Proof(None, doubt="nothing could be read")]
        steps.attempt(lambda: self._observe(found, steps, patience_s))
        return found[-1]

    def require(self, when: str) -> Proof:
        """Prove that the drive is off; ``when`` begins the message, as "before the weight prompt".

        Raises:
            StateError: The drive is not proved off.
            KeyboardInterrupt: The operator interrupted the reads.
        """
        steps = Steps()
        proof = self.prove(steps)
        if steps.interrupted:
            raise KeyboardInterrupt
        for defect in steps.unforeseen:
            raise defect
        if not proof.off:
            problems = "; ".join(dict.fromkeys((proof.doubt, *steps.problems)))
            raise StateError(f"{when}: {problems}")
        return proof

    def _observe(self, found: list[Proof], steps: Steps, patience_s: float) -> None:
        deadline_ns = self._clock.now_ns() + round(patience_s * NS)
        flowing = 0
        while True:
            window = self._window(steps)
            proof = self._judge(steps.state(self._servo), window)
            if not self._unsettled and self._stirs(window):
                self._unsettled = TURN_WINDOWS
            if proof.off and self._unsettled > 1:
                # The last proof that was found states the motion.
                self._unsettled -= 1
                continue
            found.append(proof)
            if proof.off:
                self._unsettled = 0
                self._learn(window)
                return
            state, motion = proof.state, proof.motion_rad_s
            if state is None or state.energised or motion is None:
                return
            if motion > self.rest_rad_s:
                self._unsettled = STILL_WINDOWS
                if self._clock.now_ns() >= deadline_ns:
                    return
                flowing = 0
                continue
            flowing += 1
            if flowing == DECAY_WINDOWS:
                if self._flows(window):
                    self._flowed = proof.doubt
                return

    def _window(self, steps: Steps) -> _Window:
        """Read for the time and number of readings of a window; repeat readings that fail."""
        window, failures, count = _Window(), 0, 0
        begin_ns = self._clock.now_ns()
        while failures < _FAILURES and (
            count < LEAST_READINGS or self._clock.now_ns() - begin_ns < WINDOW_S * NS
        ):
            before = len(window.motor)
            steps.attempt(lambda: self._read(window))
            good = len(window.motor) > before
            count, failures = count + good, failures + (not good)
        steps.take_first(window.encoder)
        return window

    def _read(self, window: _Window) -> None:
        due_ns = self._clock.now_ns() + REQUEST_INTERVAL_NS
        seen, encoder = self._servo.glance(), self._encoder
        missing = self._reports_current and math.isnan(seen.current_A)
        if not (missing or math.isnan(seen.motor_angle_rad)):
            window.motor.append((self._clock.now_ns() / NS, seen.motor_angle_rad))
            if self._reports_current:
                window.currents.append(seen.current_A)
        if encoder is not None and not window.encoder.problems:
            # Without its encoder, the joint is observed by the motor alone.
            found: list[float] = []
            window.encoder.attempt(lambda: found.append(encoder.reading()))
            now_s = self._clock.now_ns() / NS
            window.joint += [(now_s, angle) for angle in found if not math.isnan(angle)]
        self._clock.sleep_until_ns(due_ns)

    @property
    def _reports_current(self) -> bool:
        return not math.isnan(self._servo.measuring().current_step_A)

    def _judge(self, state: ServoState | None, window: _Window) -> Proof:
        speeds = [_speed(angles, slack) for angles, slack in self._angles(window)]
        motion = max((speed for speed in speeds if speed is not None), default=None)
        current = _stated(window.currents, self.zero_A or 0.0)
        read = None if self._encoder is None else len(window.joint) >= LEAST_READINGS
        return Proof(state, current, motion, self._doubt(state, current, motion, window), read)

    def _angles(self, window: _Window) -> list[tuple[list[tuple[float, float]], float]]:
        """Return times and joint angles by each encoder, and what its resolution explains, rad."""
        measuring = self._servo.measuring()
        motor = [(at, angle / measuring.gear_ratio) for at, angle in window.motor]
        found = [(motor, measuring.joint_step_rad)]
        if self._encoder is not None:
            found.append((window.joint, self._encoder.step_rad()))
        return [(angles, 0.0 if math.isnan(step) else STEPS * step) for angles, step in found]

    def _stirs(self, window: _Window) -> bool:
        """Return whether an angle has changed by more than the resolution of its encoder."""
        return any(
            max(angle for _, angle in angles) - min(angle for _, angle in angles) > slack
            for angles, slack in self._angles(window)
            if angles
        )

    def _doubt(
        self, state: ServoState | None, current: float | None, motion: float | None, window: _Window
    ) -> str:
        if state is None:
            return "its state could not be read"
        if state.energised:
            return energised_doubt(state)
        if motion is None:
            return f"the drive reports {state.value!r}, but current and angle could not be read"
        if current is not None and self._flows(window):
            return (
                f"the drive reports {state.value!r}, but {abs(current):.2f} A flow (limit "
                f"{self.current_limit_A:.2f} A)"
            )
        if motion > self.rest_rad_s:
            return (
                f"the drive reports {state.value!r}, but the joint moves at "
                f"{math.degrees(motion):.2f} deg/s (limit {math.degrees(self.rest_rad_s):.2f} "
                "deg/s)"
            )
        return self._flowed and f"{self._flowed} before"

    def _flows(self, window: _Window) -> bool:
        return not _rms(window.currents, self.zero_A or 0.0) <= self.current_limit_A

    @property
    def current_limit_A(self) -> float:
        """Greatest rms current, A, of a drive that is off, about the zero of its sensor."""
        measuring = self._servo.measuring()
        rated = min(
            (x for x in (measuring.rated_current_A, self._current_limit) if x > 0.0), default=0.0
        )
        share = OFFSET_SHARE if self.zero_A is None else DRIFT_SHARE
        step = measuring.current_step_A
        return share * rated + 3.0 * self._noise_A + STEPS * (0.0 if math.isnan(step) else step)

    @property
    def rest_rad_s(self) -> float:
        """Greatest speed, rad/s, of a joint that counts as at rest."""
        limit = REST_SHARE * self._speed_limit
        return min(limit, REST_RAD_S) if limit > 0.0 else REST_RAD_S

    def _learn(self, window: _Window) -> None:
        if self.zero_A is None and window.currents:
            self.zero_A = fmean(window.currents)
            self._noise_A = _rms(window.currents, self.zero_A)


def _rms(values: list[float], about: float) -> float:
    return math.sqrt(fmean((value - about) ** 2 for value in values)) if values else 0.0


def _stated(currents: list[float], zero_A: float) -> float | None:
    """Return the mean, or the rms value about the zero if the current alternates."""
    if not currents:
        return None
    mean, rms = fmean(currents), _rms(currents, zero_A)
    return mean if abs(mean - zero_A) >= 0.5 * rms else rms


def _speed(angles: list[tuple[float, float]], slack_rad: float) -> float | None:
    """Return the speed, rad/s, between both halves, less the resolution; None without angles."""
    if len(angles) < LEAST_READINGS:
        return None
    half = len(angles) // 2
    first, last = angles[:half], angles[-half:]
    moved = abs(fmean(x for _, x in last) - fmean(x for _, x in first))
    time_s = fmean(t for t, _ in last) - fmean(t for t, _ in first)
    return max(0.0, moved - slack_rad) / time_s if time_s > 0.0 else None
