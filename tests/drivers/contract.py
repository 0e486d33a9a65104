"""What every servo on every transport must do; one joins by subclassing and giving ``rig``."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import pytest

from drivers.clock import NS
from drivers.errors import StateError
from drivers.interfaces import Encoder, Link, Servo, ServoState


@dataclass
class Rig:
    link: Link
    servo: Servo
    encoder: Encoder
    cycle_s: float

    @property
    def clock(self) -> Any:
        return self.link.clock

    def cycles(self, count: int, target: Callable[[float], float] | None = None) -> None:
        """Exchange at the cycle's pace, with a target angle as a function of time."""
        start = due = self.clock.now_ns()
        for _ in range(count):
            due += round(self.cycle_s * NS)
            self.clock.sleep_until_ns(due)
            if target is not None:
                self.servo.set_target(target((due - start) / NS))
            self.link.exchange()

    def wait(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * NS))

    def lose(self, identifier: int, count: float = math.inf) -> None:
        """Lose the next frames with an identifier on the simulated bus."""

        def lost(_t: int, found: int, data: bytes, _s: bool) -> tuple[int, bytes] | None:
            nonlocal count
            count -= found == identifier
            return None if found == identifier and count >= 0 else (found, data)

        self.bench.bus.frame_filters.append(lost)  # type: ignore[attr-defined]


R = TypeVar("R", bound=Rig)


def prepared(rig: R) -> R:
    rig.servo.prepare(rig.cycle_s)
    rig.encoder.prepare(rig.cycle_s)
    return rig


def enabled(rig: R) -> R:
    prepared(rig).servo.enable()
    return rig


class ServoContract:
    @pytest.fixture
    def rig(self) -> Rig:
        raise NotImplementedError

    @pytest.fixture
    def ready(self, rig: Rig) -> Rig:
        return prepared(rig)

    @pytest.fixture
    def live(self, ready: Rig) -> Rig:
        ready.servo.enable()
        return ready

    def test_before_it_is_prepared_it_shows_what_it_is_and_takes_no_power(self, rig: Rig) -> None:
        identity = rig.servo.identity()
        assert identity.name
        assert identity.vendor_id > 0
        # A run that ends before its drive was prepared samples it while it brakes.
        try:
            assert isinstance(rig.servo.sample().motor_angle_rad, float)
        except StateError as error:
            assert "prepare" in str(error)  # noqa: PT017 either outcome is right
        with pytest.raises(StateError, match="prepare"):
            rig.servo.enable()
        assert not rig.servo.state().energised
        rig.link.close()
        rig.link.close()

    def test_preparing_gives_no_power_and_enabling_holds_the_position(self, ready: Rig) -> None:
        assert not ready.servo.state().energised
        ready.cycles(20)
        assert not ready.servo.state().energised
        before = ready.encoder.sample().angle_rad
        ready.servo.enable()
        ready.cycles(50)
        assert ready.servo.state() is ServoState.OPERATION_ENABLED
        assert ready.encoder.sample().angle_rad == pytest.approx(before, abs=1e-3)

    def test_follows_the_target_and_keeps_time_and_frames(self, live: Rig) -> None:
        live.cycles(round(0.4 / live.cycle_s), lambda t: 0.1 * math.sin(math.pi / 0.8 * t))
        sample = live.servo.sample()
        assert sample.fresh
        assert sample.motor_angle_rad / 100.0 == pytest.approx(0.1, abs=5e-3)
        assert live.encoder.sample().angle_rad == pytest.approx(0.1, abs=5e-3)
        live.link.take_frames()
        live.cycles(100)
        assert live.servo.sample().device_time_s - sample.device_time_s == pytest.approx(
            100 * live.cycle_s, abs=live.cycle_s
        )
        frames = live.link.take_frames()
        assert [f.time_ns for f in frames] == sorted(f.time_ns for f in frames)
        assert {f.sent for f in frames} == {True, False}
        assert live.link.take_frames() == []

    def test_disable_is_verified_and_final_until_the_next_enabling(self, live: Rig) -> None:
        with pytest.raises(StateError, match="operation enabled"):
            live.servo.reset_fault()
        live.servo.disable()
        assert not live.servo.state().energised
        live.cycles(50, lambda _: 0.2)
        assert not live.servo.state().energised
        live.servo.enable()
        assert live.servo.state() is ServoState.OPERATION_ENABLED

    def test_quick_stop_is_never_undone_by_the_exchange(self, live: Rig) -> None:
        live.servo.quick_stop()
        for _ in range(5):
            live.cycles(20, lambda _: 0.2)
            # A drive that sends no state has it read.
            assert live.servo.sent_state() in (None, live.servo.state())
            assert live.servo.state() in (
                ServoState.QUICK_STOP_ACTIVE,
                ServoState.SWITCH_ON_DISABLED,
            )
        live.servo.disable()
        assert not live.servo.state().energised

    def test_a_stopped_loop_ends_without_power_and_can_begin_again(self, live: Rig) -> None:
        live.cycles(50)
        live.wait(0.3)
        # A transport either has a watchdog that works, or says that it has none.
        assert live.servo.state().energised is not live.link.has_watchdog
        live.servo.disable()
        if live.servo.state() is ServoState.FAULT:
            live.servo.reset_fault()
        live.servo.prepare(live.cycle_s)
        live.servo.enable()
        live.cycles(50)
        assert live.servo.state() is ServoState.OPERATION_ENABLED
