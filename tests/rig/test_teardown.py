"""The teardown: whatever a step raises, every later step runs, and the verdict says what was read
back.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import NS
from drivers.errors import LinkError, StateError
from drivers.interfaces import ServoLimits, ServoState
from drivers.mock.bench import DRIVE_NODE
from drivers.mock.faults import WireFaults
from rig.common.errors import StorageError
from rig.wiring.teardown import SafeState, attempt_all, give_back, make_safe
from tests.drivers.host import enabled, make_host

CYCLE_NS = 10_000_000
OFF, ON, BRAKING = (
    ServoState.SWITCH_ON_DISABLED,
    ServoState.OPERATION_ENABLED,
    ServoState.QUICK_STOP_ACTIVE,
)
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


class Servo:
    """A drive under power, whose verbs raise where they are told to."""

    def __init__(self, raising: dict[str, Callable[[], BaseException]]) -> None:
        self.raising = raising
        self.order: list[str] = []
        self.power = ON
        self.sent: ServoState | None = None

    def _do(self, verb: str) -> None:
        self.order.append(verb)
        if verb in self.raising:
            raise self.raising[verb]()

    def sent_state(self) -> ServoState | None:
        return self.sent

    def quick_stop(self) -> None:
        self._do("quick_stop")
        self.power = BRAKING

    def watch(self) -> None:
        self._do("watch")

    def disable(self) -> None:
        self._do("disable")
        self.power = OFF

    def state(self) -> ServoState:
        self._do("state")
        return self.power

    def write_limits(self, limits: ServoLimits) -> None:
        self._do("write_limits")


def safe(servo: Any, brake: bool = True, hurry: Callable[[], bool] = lambda: False) -> SafeState:
    return make_safe(servo, servo.watch, CYCLE_NS, brake=brake, hurry=hurry)


STEPS = ("quick_stop", "watch", "disable", "state")


@given(
    step=st.sampled_from(STEPS),
    make=st.sampled_from(EXCEPTIONS),
    brake=st.booleans(),
)
def test_whatever_one_step_raises_every_later_step_runs(
    step: str, make: Callable[[], BaseException], brake: bool
) -> None:
    servo = Servo({step: make})
    found = safe(servo, brake)
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
        assert servo.order.count("disable") == 2
    else:
        assert found.verified
    assert found.problems or (step in ("quick_stop", "watch") and not brake)


@given(raising=st.dictionaries(st.sampled_from(STEPS), st.sampled_from(EXCEPTIONS)))
def test_whatever_several_steps_raise_each_is_tried(
    raising: dict[str, Callable[[], BaseException]],
) -> None:
    servo = Servo(raising)
    found = safe(servo)
    order = [verb for verb in servo.order if verb in ("quick_stop", "disable")]
    assert order[:2] == ["quick_stop", "disable"]
    assert servo.order[-1] == "state"
    assert found.verified is (not {"disable", "state"} & set(raising))


def test_only_what_nobody_foresaw_is_handed_on() -> None:
    defect = ZeroDivisionError("a defect")
    servo = Servo({"quick_stop": lambda: defect, "disable": lambda: LinkError("gone")})
    found = safe(servo)
    assert found.unforeseen == (defect,)
    assert found.problems == ("unforeseen ZeroDivisionError: a defect", "gone")
    assert not Servo({}).raising
    assert safe(Servo({"disable": KeyboardInterrupt})).unforeseen == ()


def test_what_the_devices_and_the_disk_say_is_foreseen() -> None:
    for error in (LinkError("gone"), StorageError("the disk is full")):
        found = safe(Servo({"quick_stop": lambda error=error: error}))  # type: ignore[misc]
        assert (found.problems, found.unforeseen) == ((str(error),), ())


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
    assert servo.order == ["state", "state"]


def test_an_orderly_end_takes_the_power_off_where_it_is_on() -> None:
    servo = Servo({})
    assert safe(servo, brake=False) == SafeState(True, "switch on disabled")
    assert servo.order == ["state", "disable", "state"]


def test_a_drive_that_stays_on_is_told_twice_and_said_to_be_on() -> None:
    servo = Servo({})
    servo.disable = lambda: servo.order.append("disable")  # type: ignore[method-assign]
    servo.quick_stop = lambda: servo.order.append("quick_stop")  # type: ignore[method-assign]
    found = safe(servo)
    assert servo.order == ["quick_stop", "state", "disable", "state", "disable", "state"]
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


def test_hurry_ends_the_braking_at_once() -> None:
    servo, asked = Servo({}), iter([False, False, True])
    safe(servo, hurry=lambda: next(asked))
    assert servo.order == ["quick_stop", *["state", "watch"] * 2, "disable", "state"]


def test_braking_ends_after_its_time_out() -> None:
    servo = Servo({})
    safe(servo)
    assert servo.order == ["quick_stop", *["state", "watch"] * 100, "disable", "state"]


@pytest.mark.parametrize("cycle_ms", [1, 2, 4, 10])
def test_the_power_goes_off_within_5_ms_of_the_standstill(cycle_ms: int) -> None:
    servo = Servo({})
    watch = servo.watch

    def stopped() -> None:
        watch()
        if servo.order.count("watch") == 31:
            servo.power = OFF

    servo.watch = stopped  # type: ignore[method-assign]
    found = make_safe(servo, stopped, cycle_ms * NS // 1000, brake=True, hurry=lambda: False)
    assert found.verified
    after_ms = (servo.order.count("watch") - 31) * cycle_ms
    assert after_ms < 5


def test_while_the_drive_sends_that_it_brakes_its_state_is_not_read() -> None:
    servo = Servo({})
    sent = [BRAKING] * 40 + [None, BRAKING, OFF]

    def watch() -> ServoState | None:
        state = sent.pop(0)
        servo.power = state or servo.power
        return state

    found = make_safe(servo, watch, CYCLE_NS, brake=True, hurry=lambda: False)
    # It is read first, after the cycle in which the drive sends none, and to confirm its end.
    assert servo.order == ["quick_stop", *["state"] * 3, "disable", "state"]
    assert sent == []
    assert found.verified


def test_an_old_state_in_late_frames_does_not_end_the_braking() -> None:
    servo = Servo({})
    safe_after = make_safe(servo, lambda: ON, CYCLE_NS, brake=True, hurry=lambda: False)
    assert servo.order == ["quick_stop", *["state"] * 100, "disable", "state"]
    assert safe_after.verified


@pytest.mark.parametrize("state", [BRAKING, None])
def test_after_a_lost_answer_the_state_that_the_drive_sends_counts(
    state: ServoState | None,
) -> None:
    servo = Servo({"state": lambda: LinkError("no answer")})
    servo.sent = state
    sent = iter([BRAKING, BRAKING, OFF, OFF, BRAKING])
    found = make_safe(servo, lambda: next(sent), CYCLE_NS, brake=True, hurry=lambda: False)
    # Without either, the power is taken off at once.
    assert len(list(sent)) == (5 if state is None else 1)
    reads = 1 if state is None else 2
    assert servo.order[: reads + 2] == ["quick_stop", *["state"] * reads, "disable"]
    assert found.problems == ("no answer",)


@pytest.mark.parametrize("lost", [1, 3])
def test_lost_answers_while_the_drive_brakes_do_not_cut_its_ramp_short(lost: int) -> None:
    host = enabled(make_host())
    host.cycles(400, lambda t: t * t)
    speeds: list[float] = []
    braking = False

    def watch() -> ServoState | None:
        nonlocal braking
        if not braking:
            WireFaults(host.bench.bus, host.clock).lose(
                lambda identifier, host: identifier == 0x580 + DRIVE_NODE and not host, lost
            )
            braking = True
        host.cycles(1)
        speeds.append(host.servo.sample().velocity_rad_s)
        return host.servo.sent_state()

    found = make_safe(host.servo, watch, NS // 1000, brake=True, hurry=lambda: False)
    assert found.verified
    assert abs(speeds[0]) > 10 * abs(speeds[-1])
    assert len(speeds) > 10


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


UNVERIFIED = "it could NOT be verified that the drive is de-energised (state unknown; gone; full); "


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (SafeState(True, "fault"), "the drive is de-energised (read back: fault)"),
        (
            SafeState(False, "unknown", ("gone", "full"), watched=False),
            UNVERIFIED + "it has no watchdog and may go on HOLDING UNDER POWER: switch the main "
            "supply off now",
        ),
        (
            SafeState(False, "unknown", ("gone", "full")),
            UNVERIFIED + "its own watchdog takes the power off; "
            "switch the main supply off before approaching the bench",
        ),
    ],
)
def test_how_the_drive_was_left_in_words(found: SafeState, words: str) -> None:
    assert found.message == words


def test_the_record_holds_no_exceptions() -> None:
    found = SafeState(True, "off", ("p",), True, (ValueError(),))
    assert found.record() == {"verified": True, "state": "off", "problems": ["p"], "watched": True}


def test_how_the_drive_was_left_is_a_plain_value() -> None:
    found = SafeState(True, "off", unforeseen=(ValueError("odd"),))
    assert found == SafeState(True, "off")
    assert "odd" not in repr(found)
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.verified = False  # type: ignore[misc]
