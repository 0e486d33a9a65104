"""What every servo does step by step; one joins by subclassing and giving ``case``."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from drivers.clock import NS
from drivers.errors import ConfigurationError, DriveFault, LinkError, StateError
from drivers.interfaces import Servo
from drivers.interfaces import ServoState as S


@dataclass
class Case:
    """A fake drive with its servo; ``off`` recognises an order to switch the power off."""

    fake: Any
    prepared: Callable[..., Servo]
    put: Callable[[S], None]
    sent: Callable[[], list[Any]]
    off: Callable[[Any], bool]
    deafen: Callable[[], None]
    cycle_s: float = 0.004
    # Exchanges of an enabling before those that are timed.
    more: int = 0

    def ready(self, **options: Any) -> Servo:
        servo = self.prepared(**options)
        self.sent()
        return servo


class StepsContract:
    @pytest.fixture
    def case(self) -> Case:
        raise NotImplementedError

    @pytest.mark.parametrize(
        ("verb", "state", "error"),
        [
            ("prepare", S.OPERATION_ENABLED, StateError),
            ("enable", S.FAULT, DriveFault),
            ("enable", S.FAULT_REACTION, DriveFault),
            ("enable", S.QUICK_STOP_ACTIVE, StateError),
            ("reset_fault", S.OPERATION_ENABLED, StateError),
            ("reset_fault", S.FAULT_REACTION, StateError),
        ],
    )
    def test_what_its_state_does_not_allow_sends_nothing(self, case, verb, state, error):
        servo = case.ready()
        case.put(state)
        with pytest.raises(error):
            servo.prepare(case.cycle_s) if verb == "prepare" else getattr(servo, verb)()
        assert case.sent() == []

    @pytest.mark.parametrize("state", [S.FAULT, S.FAULT_REACTION])
    def test_a_fault_on_the_way_ends_the_enabling(self, case: Case, state: S) -> None:
        servo = case.ready()

        def fault() -> None:
            case.fake.follows = False
            case.put(state)

        case.fake.loses[2] = fault
        with pytest.raises(DriveFault):
            servo.enable()
        assert any(map(case.off, case.sent()))
        assert case.fake.cycle <= 4

    def test_a_bus_that_fails_on_the_way_is_told_though_the_drive_cannot_be(self, case):
        servo = case.ready()

        def lose() -> None:
            case.deafen()
            raise LinkError("bus-off")

        case.fake.loses[2] = lose
        with pytest.raises(LinkError, match="bus-off"):
            servo.enable()
        assert any(map(case.off, case.sent()))

    @pytest.mark.parametrize("timeout_s", [1.0, 0.1])
    def test_a_drive_that_does_not_come_up_is_given_its_time(self, case, timeout_s):
        servo = case.ready(state_timeout_s=timeout_s)
        case.fake.follows = False
        with pytest.raises(StateError, match=f" {timeout_s:g} s after the command"):
            servo.enable()
        assert case.fake.cycle == case.more + round(timeout_s / case.cycle_s)

    @pytest.mark.parametrize("verb", ["disable", "reset_fault"])
    def test_a_drive_that_does_not_obey_is_given_a_second(self, case: Case, verb: str) -> None:
        servo = case.ready()
        if verb == "disable":
            servo.enable()
        else:
            case.put(S.FAULT)
        case.fake.follows = False
        began = case.fake.clock.now_ns()
        with pytest.raises(StateError, match="1 s after the command"):
            getattr(servo, verb)()
        assert NS <= case.fake.clock.now_ns() - began <= NS + NS // 20
        assert any(map(case.off, case.sent()))

    def test_before_it_is_prepared_no_exchange_stops_it(self, case: Case) -> None:
        servo = case.prepared(prepare=False)
        servo.quick_stop()
        assert not servo.prepared
        assert case.sent()

    def test_a_target_beyond_its_range_is_not_sent(self, case: Case) -> None:
        servo = case.ready()
        with pytest.raises(ConfigurationError):
            servo.set_target(1e9)
        assert case.sent() == []
