"""A drive for tests of what is done with one: it reports off, without current or motion."""

from collections.abc import Callable
from typing import Any

from drivers.interfaces import Measuring, ServoMotion, ServoReadings, ServoState
from rig.wiring.teardown import SafeState, make_safe


def stopped_by_ramp(
    servo: Any, watch: Callable[[], ServoState | None], clock: Any, cycle_ns: int, **options: bool
) -> SafeState:
    """Brake a drive and take its power off, with nobody in a hurry."""
    return make_safe(servo, watch, clock, cycle_ns, brake=True, hurry=lambda: False, **options)


class FakeDrive:
    """Passes its verbs to :meth:`do`, which a test may let note them, or fail."""

    prepared = asked = False
    watch_s: float | None = None
    power = ServoState.SWITCH_ON_DISABLED
    angle = current = 0.0

    def do(self, verb: str) -> None:
        """Note a verb, take time, or raise its error."""

    def sent_state(self) -> ServoState | None:
        return None

    def quick_stop(self, *, at_once: bool = True) -> None:
        self.do("quick_stop")

    def disable(self) -> None:
        self.do("disable")

    def state(self) -> ServoState:
        self.do("state")
        return self.power

    def glance(self) -> ServoReadings:
        self.do("glance")
        return ServoReadings(self.angle, current_A=self.current)

    def measuring(self) -> Measuring:
        return Measuring(1e-5, 100.0, 0.015, 15.0)

    def motion(self) -> ServoMotion:
        return ServoMotion()

    def promised_deceleration(self) -> float:
        return 1.0
