"""The teardown: whatever a step raises, every later step runs, and the verdict is read back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import NS, SimulatedClock
from drivers.errors import LinkError, StateError
from drivers.interfaces import ServoLimits, ServoMotion, ServoState
from rig.common.errors import StorageError
from rig.wiring.teardown import INSISTENT_ATTEMPTS, SafeState, attempt_all, give_back, make_safe

from .drives import FakeDrive, stopped_by_ramp

CYCLE_NS = 10_000_000
OFF, ON, BRAKING = (
    ServoState.SWITCH_ON_DISABLED,
    ServoState.OPERATION_ENABLED,
    ServoState.QUICK_STOP_ACTIVE,
)
SEEN_OFF = SafeState(True, "switch on disabled", current_A=0.0, motion_rad_s=0.0)
LIMITS = ServoLimits(-1.0, 1.0, 3.0, 80.0, 30.0, None, 2, 10.0)


def all_exceptions() -> list[type[BaseException]]:
    """Return every exception class of this process that can be made without arguments."""
    found: list[type[BaseException]] = []
    waiting: list[type[BaseException]] = [BaseException]
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        try:
            kind()
        except Exception:  # noqa: BLE001 those that want arguments are left out
            continue
        found.append(kind)
    return sorted(set(found), key=lambda kind: (kind.__module__, kind.__qualname__))


EXCEPTIONS = [
    *all_exceptions(),
    lambda: LinkError("gone"),
    lambda: StateError("no"),
    lambda: StorageError("full"),
]


class Clock(SimulatedClock):
    def __init__(self, servo: Servo) -> None:
        super().__init__()
        self._servo = servo

    def now_ns(self) -> int:
        self._servo.fail("now_ns")
        return super().now_ns()

    def sleep_until_ns(self, time_ns: int) -> None:
        self._servo.fail("sleep")
        super().sleep_until_ns(time_ns)


class Servo(FakeDrive):
    """A drive under power, whose verbs raise where they are told to."""

    def __init__(self, raising: dict[str, Callable[[], BaseException]]) -> None:
        self.raising = raising
        self.order: list[str] = []
        self.power = ON
        self.sent: ServoState | None = None
        self.moved = (0.0, 0.0)
        self.clock = Clock(self)

    def pass_time(self, ns: int) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + ns)

    def fail(self, verb: str) -> None:
        if verb in self.raising:
            raise self.raising[verb]()

    def do(self, verb: str) -> None:
        self.order.append(verb)
        self.fail(verb)
        if verb == "glance":
            self.pass_time(NS // 1000)
        self.power = {"quick_stop": BRAKING, "disable": OFF}.get(verb, self.power)

    def hurry(self) -> bool:
        self.fail("hurry")
        return False

    def sent_state(self) -> ServoState | None:
        return self.sent

    def watch(self) -> ServoState | None:
        self.do("watch")
        self.pass_time(CYCLE_NS)
        return self.sent

    def motion(self) -> ServoMotion:
        return ServoMotion(*self.moved)

    def write_limits(self, limits: ServoLimits) -> None:
        self.do("write_limits")


def safe(servo: Any, brake: bool = True, insistent: bool = False) -> SafeState:
    return make_safe(
        servo,
        servo.watch,
        servo.clock,
        CYCLE_NS,
        brake=brake,
        hurry=servo.hurry,
        insistent=insistent,
    )


STEPS = ("quick_stop", "watch", "disable", "state")
PROOF = ("state", "disable", "glance", "now_ns", "sleep")
"""Verbs without which nothing is proved."""
IN_BRAKING = ("hurry", "now_ns", "sleep")
VERBS = (*STEPS, *IN_BRAKING, "glance")


@given(
    step=st.sampled_from(VERBS),
    make=st.sampled_from(EXCEPTIONS),
    brake=st.booleans(),
    insistent=st.booleans(),
)
def test_whatever_one_step_raises_every_later_step_runs(step, make, brake, insistent):
    servo = Servo({step: make})
    found = safe(servo, brake, insistent)
    assert "disable" in servo.order
    assert servo.order[-1] == "state"
    assert servo.order.index("disable") < len(servo.order) - 1
    if brake:
        assert servo.order[0] == "quick_stop"
    if step == "state":
        assert not found.verified
        assert found.state == "unknown"
    elif step == "disable":
        assert not found.verified
        assert servo.order.count("disable") == (INSISTENT_ATTEMPTS if insistent else 2)
    else:
        assert found.verified is (step not in PROOF)
    assert found.problems or (step in ("quick_stop", "watch", *IN_BRAKING) and not brake)


@pytest.mark.parametrize("prepared", [True, False])
def test_a_defect_of_hurry_is_told_and_does_not_end_the_ramp(prepared: bool) -> None:
    servo = Servo({"hurry": lambda: ValueError("a defect")})
    servo.prepared, servo.sent = prepared, BRAKING
    found = safe(servo)
    assert found.verified
    assert found.problems == ("unforeseen ValueError: a defect",)
    assert servo.order.count("watch") > 90


@given(
    raising=st.dictionaries(
        st.sampled_from((*STEPS, *IN_BRAKING, "glance")), st.sampled_from(EXCEPTIONS)
    )
)
def test_whatever_several_steps_raise_each_is_tried(raising):
    servo = Servo(raising)
    found = safe(servo)
    order = [verb for verb in servo.order if verb in ("quick_stop", "disable")]
    assert set(order[: order.index("disable")]) == {"quick_stop"}
    assert servo.order[-1] == "state"
    assert found.verified is (not set(PROOF) & set(raising))


def test_only_what_nobody_foresaw_is_handed_on() -> None:
    defect = ZeroDivisionError("a defect")
    servo = Servo({"quick_stop": lambda: defect, "disable": lambda: LinkError("gone")})
    found = safe(servo)
    assert found.unforeseen == (defect,)
    assert found.problems == ("unforeseen ZeroDivisionError: a defect", "gone")
    assert not Servo({}).raising
    assert safe(Servo({"disable": KeyboardInterrupt})).unforeseen == ()


def test_an_exception_that_cannot_be_shown_is_named() -> None:
    class Mute(Exception):
        def __str__(self) -> str:
            raise ValueError

    found = safe(Servo({"quick_stop": Mute}))
    assert found.problems == ("unforeseen Mute",)
    assert found.verified


def test_an_orderly_end_does_not_touch_a_drive_that_is_off() -> None:
    servo = Servo({})
    servo.power = OFF
    assert safe(servo, brake=False).verified
    assert set(servo.order) == {"state", "glance"}


def test_an_orderly_end_takes_the_power_off_where_it_is_on() -> None:
    servo = Servo({})
    assert safe(servo, brake=False) == SEEN_OFF
    assert [verb for verb in servo.order if verb != "glance"] == [
        "state",
        "disable",
        *2 * ["state"],
    ]


def test_a_drive_that_stays_on_is_told_twice_and_said_to_be_on() -> None:
    servo = Servo({})
    servo.disable = lambda: servo.order.append("disable")  # type: ignore[method-assign]
    servo.quick_stop = lambda **_: servo.order.append("quick_stop")  # type: ignore[method-assign]
    found = safe(servo)
    assert [verb for verb in servo.order if verb == "disable"] == ["disable"] * 2
    assert servo.order[-4:] == ["disable", "state"] * 2
    assert found == SafeState(False, "operation enabled")


def test_a_first_disable_that_was_interrupted_is_done_again() -> None:
    servo = Servo({"disable": KeyboardInterrupt})
    real = servo.disable

    def once() -> None:
        try:
            real()
        finally:
            servo.raising.clear()

    servo.disable = once  # type: ignore[method-assign]
    found = safe(servo)
    assert found.verified
    assert found.problems == ("interrupted again while stopping",)


def test_limits_go_back_only_into_a_drive_that_is_verified_off() -> None:
    for verified in (True, False):
        servo = Servo({"write_limits": lambda: ValueError("odd")})
        found = give_back(servo, LIMITS, SafeState(verified, "x"))  # type: ignore[arg-type]
        assert servo.order == (["write_limits"] if verified else [])
        assert [type(error) for error in found] == ([ValueError] if verified else [])


def test_all_steps_are_tried_in_order() -> None:
    done: list[int] = []

    def fail() -> None:
        done.append(1)
        raise RuntimeError

    assert [type(e) for e in attempt_all(fail, lambda: done.append(2))] == [RuntimeError]
    assert done == [1, 2]


def test_the_record_holds_no_exceptions() -> None:
    found = SafeState(False, "off", ("p",), True, (ValueError(),), 3.98, 0.5, "it flows")
    assert found.record() == {
        "verified": False,
        "state": "off",
        "problems": ["p"],
        "watched": True,
        "current_A": 3.98,
        "motion_rad_s": 0.5,
        "doubt": "it flows",
        "joint_read": None,
    }


class Deaf(Servo):
    """A drive that hears nothing until a number of frames is lost."""

    def __init__(self, frames: int) -> None:
        super().__init__({})
        self.frames = frames
        self.word = ON

    def do(self, verb: str) -> None:
        self.order.append(verb)
        self.word = {"quick_stop": BRAKING, "disable": OFF}.get(verb, self.word)
        self.frames -= 1
        if self.frames >= 0:
            raise LinkError("gone")
        if verb == "glance":
            self.pass_time(NS // 1000)
        if verb in ("quick_stop", "disable", "watch"):
            self.power = self.word

    def watch(self) -> ServoState | None:
        self.pass_time(CYCLE_NS)
        self.do("watch")
        return self.sent


def stopped(servo: Any, insistent: bool) -> SafeState:
    options = {"watched": False, "insistent": insistent}
    return stopped_by_ramp(servo, servo.watch, servo.clock, CYCLE_NS, **options)


@pytest.mark.parametrize(("insistent", "verified"), [(True, True), (False, False)])
def test_cycles_repeat_a_power_off_that_got_no_answer(insistent: bool, verified: bool) -> None:
    """Without a watchdog, a drive that missed both commands would hold under power for ever."""
    servo = Deaf(20)
    found = stopped(servo, insistent)
    assert found.verified == verified
    assert (servo.power is OFF) == verified
    assert found.problems == ("gone",)


def test_a_dead_line_ends_the_insistent_attempts() -> None:
    servo = Deaf(10**9)
    assert not stopped(servo, insistent=True).verified
    assert servo.order.count("disable") == INSISTENT_ATTEMPTS
