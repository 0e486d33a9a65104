"""The braking: whatever is lost, cycles go on, and the drive ends its ramp."""

import dataclasses
import errno
import itertools
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.clock import NS
from drivers.errors import DriveFault, LinkError
from drivers.interfaces import ServoState
from drivers.mock.bench import DRIVE_NODE
from drivers.mock.dbc_drive import STOP
from drivers.mock.faults import LineFaults, WireFaults
from drivers.mock.plant.machine import Loop
from drivers.mock.power_state import Command
from drivers.mock.power_state import State as State402
from rig.control.cycle import Cycle
from rig.terminal.stop_button import StopButton
from rig.wiring.braking import (
    BRAKING_TIMEOUT_S,
    REACTION_S,
    TRANSITIONS,
    UNHEARD_S,
    Event,
    State,
    brake,
    next_state,
)
from rig.wiring.devices import Devices
from rig.wiring.off import Steps
from rig.wiring.runaway import RunawayError
from rig.wiring.teardown import SafeState
from tests.drivers.dbc_host import DbcHost, make_dbc_host
from tests.drivers.dbc_host import enabled as enabled_dbc
from tests.drivers.host import enabled, make_host
from tests.drivers.serial_host import SerialHost, make_serial_host
from tests.drivers.test_modes import host_in
from tests.drivers.test_servo import LIMITS

from .drives import stopped_by_ramp
from .test_cycle import LIMITS as CYCLE_LIMITS
from .test_teardown import Servo

CYCLE_NS = 10_000_000
OFF, ON, BRAKING, REACTION, FAULT = (
    ServoState.SWITCH_ON_DISABLED,
    ServoState.OPERATION_ENABLED,
    ServoState.QUICK_STOP_ACTIVE,
    ServoState.FAULT_REACTION,
    ServoState.FAULT,
)
STOPPED_RAD_S = 0.05
"""Speed at the end of a ramp; it begins at 0.8 rad/s."""


def braked(
    servo: Any,
    watch: Callable[[], ServoState | None] | None = None,
    watched: bool = True,
    hurry: Callable[[], bool] = lambda: False,
) -> tuple[ServoState | None, Steps]:
    steps = Steps()
    state = brake(servo, watch or servo.watch, servo.clock, CYCLE_NS, hurry, steps, watched)
    return state, steps


def sending(servo: Servo, *states: ServoState | None) -> Callable[[], ServoState | None]:
    """Return a cycle of a prepared drive that sends these states in turn, and has them."""
    left = list(states)
    servo.prepared = True

    def watch() -> ServoState | None:
        servo.watch()
        state = left.pop(0)
        servo.power = state or servo.power
        return state

    return watch


def test_hurry_ends_the_braking_at_once() -> None:
    servo, asked = Servo({}), iter([False, False, True])
    assert braked(servo, hurry=lambda: next(asked))[0] is BRAKING
    assert servo.order == ["quick_stop", *["watch", "state"] * 2]


def test_ctrl_c_in_a_cycle_ends_the_braking_at_once() -> None:
    servo = Servo({"watch": KeyboardInterrupt})
    _, steps = braked(servo)
    assert servo.order == ["quick_stop", "watch"]
    assert steps.problems == ["interrupted again while stopping"]


def test_braking_ends_after_its_time_out() -> None:
    servo = Servo({})
    assert braked(servo)[0] is BRAKING
    assert servo.order == ["quick_stop", *["watch", "state"] * 100]
    assert servo.clock.now_ns() == BRAKING_TIMEOUT_S * NS


@pytest.mark.parametrize("cycle_ms", [1, 2, 4, 10])
def test_the_power_goes_off_within_5_ms_of_the_standstill(cycle_ms: int) -> None:
    servo: Any = Servo({})
    began = servo.clock.now_ns()

    def stopped() -> None:
        servo.order.append("watch")
        servo.pass_time(cycle_ms * NS // 1000)
        if servo.order.count("watch") == 31:
            servo.power = OFF

    cycle_ns = cycle_ms * NS // 1000
    brake(servo, stopped, servo.clock, cycle_ns, lambda: False, Steps(), True)
    assert 0 <= servo.clock.now_ns() - began - 31 * cycle_ns < 5 * NS // 1000


def test_a_control_cycle_longer_than_the_time_out_is_run_once() -> None:
    servo = Servo({})
    servo.prepared, servo.sent, servo.power = True, OFF, OFF
    order = servo.quick_stop
    servo.quick_stop = lambda at_once=True: order() if at_once else None  # type: ignore[method-assign]
    watch = servo.watch
    state = brake(servo, watch, servo.clock, 3 * NS, lambda: False, Steps(), True)  # type: ignore
    assert state is OFF
    assert servo.order == ["watch", "state"]


def test_while_the_drive_sends_that_it_brakes_its_state_is_not_read() -> None:
    servo = Servo({})
    watch = sending(servo, ON, *[BRAKING] * 40, REACTION, BRAKING, OFF)
    state, _ = braked(servo, watch)
    # It is read after a cycle in which the drive sends another state, and to confirm its end.
    assert [verb for verb in servo.order if verb != "watch"] == ["quick_stop"] * 2 + ["state"] * 2
    assert state is OFF


def test_an_old_state_in_late_frames_does_not_end_the_braking() -> None:
    servo = Servo({})
    servo.sent, servo.prepared = ON, True
    assert braked(servo)[0] is BRAKING
    assert servo.order[:4] == ["quick_stop", "watch", "quick_stop", "state"]
    assert servo.order[4:] == ["watch", "state"] * 99


def test_after_a_lost_answer_an_old_state_in_a_late_frame_does_not_end_the_braking() -> None:
    servo = Servo({"state": lambda: LinkError("no answer")})
    watch = sending(servo, BRAKING, ON, None, ON, OFF)
    state, steps = braked(servo, watch)
    assert state is OFF
    assert set(steps.problems) == {"no answer"}


def test_a_lost_answer_of_a_drive_that_is_not_prepared_ends_the_braking() -> None:
    servo = Servo({"state": lambda: LinkError("no answer")})
    assert braked(servo)[0] is None
    assert servo.order == ["quick_stop", "watch", "state"]


@pytest.mark.parametrize(("answers", "watched"), [(True, True), (True, False), (False, False)])
def test_a_drive_that_goes_on_operating_is_given_up_after_its_time(answers, watched):
    servo = Servo({} if answers else {"state": lambda: LinkError("no answer")})
    servo.quick_stop = lambda **_: servo.order.append("quick_stop")  # type: ignore
    servo.sent, servo.prepared = ON, True
    state, _ = braked(servo, watched=watched)
    assert state is ON
    cycles = servo.order.count("watch") * CYCLE_NS / NS
    assert UNHEARD_S < cycles < 3 * UNHEARD_S if watched else cycles > REACTION_S
    late_s = servo.clock.now_ns() / NS - REACTION_S
    assert CYCLE_NS / NS <= late_s <= 2 * CYCLE_NS / NS


def test_a_drive_whose_state_is_read_by_a_command_is_left_in_silence_for_its_watchdog() -> None:
    servo, asked_s = Servo({}), list[float]()
    servo.quick_stop = lambda **_: servo.order.append("quick_stop")  # type: ignore
    servo.sent, servo.prepared = ON, True
    servo.asked, servo.watch_s = True, 0.1
    plain = servo.state

    def state() -> ServoState:
        asked_s.append(servo.clock.now_ns() / NS)
        return plain()

    servo.state = state  # type: ignore
    braked(servo)
    assert max(np.diff([0.0, *asked_s])) >= 0.2


def test_the_reaction_to_a_fault_is_waited_for() -> None:
    servo = Servo({})
    assert braked(servo, sending(servo, *[REACTION] * 50, FAULT))[0] is FAULT
    assert servo.order.count("watch") == 51


@pytest.mark.parametrize("watched", [True, False])
def test_only_a_drive_with_a_watchdog_is_left_alone_if_nothing_reaches_it(watched: bool) -> None:
    gone = lambda: LinkError("gone")  # noqa: E731
    servo = Servo({"quick_stop": gone, "state": gone})
    servo.prepared = True
    state, steps = braked(servo, watched=watched)
    cycles = round(UNHEARD_S * NS) // CYCLE_NS
    assert servo.order.count("watch") == (cycles if watched else 100)
    assert (state, set(steps.problems)) == (None, {"gone"})
    assert servo.clock.now_ns() == BRAKING_TIMEOUT_S * NS


@pytest.mark.parametrize("error", [LinkError("the encoder is lost"), DriveFault(1, "a warning")])
def test_cycles_that_fail_do_not_end_the_braking_and_keep_their_period(error: Exception) -> None:
    servo = Servo({})
    servo.prepared, servo.sent = True, BRAKING

    def watch() -> ServoState | None:
        servo.order.append("watch")
        if servo.order.count("watch") == 30:
            servo.sent = servo.power = OFF
        raise error

    state, steps = braked(servo, watch)
    assert state is OFF
    assert servo.order == ["quick_stop", *["watch"] * 30, "state"]
    assert servo.clock.now_ns() == 30 * CYCLE_NS
    assert steps.problems == [str(error)]


def test_a_defect_of_the_cycle_is_kept_once_and_the_state_is_read() -> None:
    servo = Servo({"watch": ZeroDivisionError})
    servo.prepared, servo.sent = True, OFF  # of an exchange before the defect
    state, steps = braked(servo)
    assert state is BRAKING
    assert [type(defect) for defect in steps.unforeseen] == [ZeroDivisionError]
    assert "state" in servo.order


class Wire:
    """A drive under power on a simulated bus, in motion, with the recorded course of its stop.

    Attributes:
        speeds: Speed that the drive sends in each cycle, rad/s.
        entered: States of the drive.
        entered_s: Time from the stop until each.
        off_rad_s: Speed of the joint as the power goes off.
        off_s: Time from the stop until then.
    """

    def __init__(self, mode: str = "csp") -> None:
        self.host = make_host() if mode == "csp" else host_in(mode)
        self.host.servo.write_limits(dataclasses.replace(LIMITS, quick_stop_option=2))
        enabled(self.host)
        self.host.cycles(400, lambda t: t * t)
        self.faults = WireFaults(self.host.bench.bus, self.host.clock)
        self.speeds: list[float] = []
        self.entered: list[State402] = []
        self.off_rad_s = self.off_s = float("nan")
        self.watched = self.host.link.has_watchdog
        self.began_ns = self.host.clock.now_ns()
        self.entered_s: list[float] = []
        self.host.bench.drive.entered.append(self._enter)
        switch = self.host.bench.machine.power

        def power(on: bool) -> None:
            self.off_rad_s = self.host.bench.machine.truth().velocity_rad_s
            self.off_s = (self.host.clock.now_ns() - self.began_ns) / NS
            switch(on)

        self.host.bench.machine.power = power  # type: ignore[method-assign]

    def _enter(self, state: State402) -> None:
        self.entered.append(state)
        self.entered_s.append((self.host.clock.now_ns() - self.began_ns) / NS)

    def lose_answers(self, count: int) -> None:
        self.faults.lose(lambda identifier, host: identifier == 0x580 + DRIVE_NODE, count)

    def lose_all(self, for_s: float, *, orders: bool = True) -> None:
        """Lose the frames from the drive and, with ``orders``, all to it except heartbeats."""
        end_ns = self.host.clock.now_ns() + round(for_s * NS)

        def lost(identifier: int, host: bool) -> bool:
            mine = identifier & 0x7F == DRIVE_NODE
            return mine and (orders or not host) and self.host.clock.now_ns() < end_ns

        self.faults.lose(lost, 1 << 30)

    def watch(self) -> ServoState | None:
        self.host.cycles(1)
        self.speeds.append(self.host.servo.sample().velocity_rad_s)
        return self.host.servo.sent_state()

    def safe(self) -> SafeState:
        host = self.host
        return stopped_by_ramp(host.servo, self.watch, host.clock, NS // 1000, watched=self.watched)

    def stop(self) -> None:
        """Bring the drive to a stop, which must be that of its own ramp."""
        assert self.safe().verified
        assert self.entered == [State402.QUICK_STOP_ACTIVE, State402.SWITCH_ON_DISABLED]
        assert abs(self.off_rad_s) < STOPPED_RAD_S

    def stop_from_speed(self) -> None:
        self.stop()
        assert abs(self.speeds[0]) > 10 * abs(self.speeds[-1])
        assert len(self.speeds) > 10


@pytest.mark.parametrize("lost", [1, 3])
def test_lost_answers_while_the_drive_brakes_do_not_cut_its_ramp_short(lost: int) -> None:
    wire = Wire()
    watch = wire.watch

    def lossy() -> ServoState | None:
        if not wire.speeds:
            wire.lose_answers(lost)
        return watch()

    wire.watch = lossy  # type: ignore[method-assign]
    wire.stop_from_speed()


def test_a_drive_without_process_data_is_braked_by_sdo() -> None:
    wire = Wire()
    wire.faults.lose(lambda identifier, host: identifier == 0x200 + DRIVE_NODE, 1 << 30)
    wire.stop_from_speed()
    assert wire.off_s > UNHEARD_S / 4


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_an_outage_only_delays_the_stop(mode: str) -> None:
    wire = Wire(mode)
    outage_s = 0.75 * UNHEARD_S
    wire.lose_all(outage_s)
    wire.stop()
    assert outage_s < wire.entered_s[0] < outage_s + 0.002


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_a_drive_that_hears_heartbeats_only_is_braked_by_its_watchdog(mode: str) -> None:
    wire = Wire(mode)
    wire.lose_all(10.0)
    assert not wire.safe().verified
    assert wire.entered == [State402.FAULT_REACTION, State402.FAULT]
    assert abs(wire.off_rad_s) < STOPPED_RAD_S
    watch_s = wire.host.servo.watch_s
    assert watch_s is not None
    assert watch_s < wire.entered_s[0] < UNHEARD_S + watch_s + 0.002


@pytest.mark.parametrize("heard", [0, 3])
def test_a_ramp_of_which_nothing_is_heard_is_not_cut_short(heard: int) -> None:
    """The drive hears all, and of the drive nothing arrives from the start or from a cycle on."""
    wire = Wire()
    watch = wire.watch

    def deaf() -> ServoState | None:
        if len(wire.speeds) == heard:
            wire.lose_all(10.0, orders=False)
        return watch()

    wire.watch = deaf  # type: ignore[method-assign]
    assert not wire.safe().verified
    assert wire.entered[0] is State402.QUICK_STOP_ACTIVE
    assert abs(wire.off_rad_s) < STOPPED_RAD_S
    assert wire.entered[-1] is State402.SWITCH_ON_DISABLED


def test_a_drive_in_torque_mode_that_refuses_the_stop_has_no_torque() -> None:
    wire = Wire("cst")
    drive = wire.host.bench.drive
    drive.deaf_to = frozenset({Command.QUICK_STOP})
    torques: list[int] = []
    watch = wire.watch

    def noting() -> ServoState | None:
        state = watch()
        torques.append(drive.objects.integer(0x6071))
        return state

    wire.watch = noting  # type: ignore[method-assign]
    assert wire.safe().verified
    assert wire.entered[:2] == [State402.FAULT_REACTION, State402.FAULT]  # by its watchdog
    assert len(torques) > UNHEARD_S / 0.001
    assert not any(torques[1:])
    assert abs(wire.off_rad_s) < STOPPED_RAD_S


@pytest.fixture
def moving() -> Iterator[DbcHost]:
    host = make_dbc_host()
    enabled_dbc(host)
    host.cycles(200, lambda t: 0.5 * t)
    yield host
    host.link.close()


def times_of(host: DbcHost, wanted: int) -> list[int]:
    times: list[int] = []

    def note(time_ns: int, found: int, data: bytes, by_host: bool) -> tuple[int, bytes]:
        if found == wanted:
            times.append(time_ns)
        return found, data

    host.bench.bus.frame_filters.append(note)
    return times


def braked_dbc(
    host: DbcHost, watched: bool, note: Callable[[], None] = lambda: None
) -> ServoState | None:
    def watch() -> ServoState | None:
        note()
        host.cycles(1)
        return host.servo.sent_state()

    return brake(host.servo, watch, host.clock, NS // 1000, lambda: False, Steps(), watched)


@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("code", [0, 7])
def test_a_fault_code_does_not_show_that_a_drive_brakes(moving, code, watched):
    """A drive that reports that it runs does not brake, whatever its fault code is."""
    drive, clock = moving.bench.drive, moving.clock
    drive._obey = lambda order: None
    drive._port.listen(STOP, lambda data: None)
    drive.fault_code = code
    drive._send_status()
    moving.wait(0.0005)
    orders = times_of(moving, STOP)
    began_ns = clock.now_ns()
    state = braked_dbc(moving, watched)
    assert state is (FAULT if watched else ON)  # with a watchdog, this brakes the drive
    assert clock.now_ns() - began_ns < (REACTION_S + 0.02) * NS
    assert len(orders) > 3


def test_a_drive_without_a_watchdog_gets_its_cycles_although_it_sends_nothing(moving):
    moving.bench.bus.frame_filters.append(
        lambda _t, found, data, by_host: (found, data) if by_host else None
    )
    cycles: list[int] = []
    began_ns = moving.clock.now_ns()
    state = braked_dbc(moving, False, lambda: cycles.append(moving.clock.now_ns()))
    assert state is None
    assert max(b - a for a, b in itertools.pairwise(cycles)) < 0.05 * NS
    assert moving.clock.now_ns() - began_ns < (BRAKING_TIMEOUT_S + 0.05) * NS


@pytest.fixture
def serial() -> Iterator[SerialHost]:
    host = make_serial_host()
    host.servo.write_limits(dataclasses.replace(LIMITS, quick_stop_option=2))
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.servo.enable()
    host.cycles(100, lambda t: 0.5 * t)
    yield host
    host.link.close()


def test_a_serial_drive_is_ordered_at_once_although_its_answers_are_lost(serial):
    entered: list[State402] = []
    serial.bench.drive.entered.append(entered.append)
    clock = serial.bench.clock
    LineFaults(serial.line, clock).lose(False, 0)
    serial.cycles(2)
    began_ns = clock.now_ns()
    serial.servo.quick_stop(at_once=False)
    assert clock.now_ns() == began_ns  # no answer is waited for
    clock.sleep_until_ns(began_ns + round(serial.cycle_s * NS))
    assert entered[0] is State402.QUICK_STOP_ACTIVE


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_a_drive_that_takes_no_process_data_is_ordered_at_once(mode: str) -> None:
    wire = Wire(mode)
    wire.host.bench.bus.attach().send(0x000, bytes([0x80, DRIVE_NODE]))  # PRE-OPERATIONAL
    with pytest.raises(LinkError, match="left the NMT state OPERATIONAL"):
        wire.host.cycles(100)
    wire.began_ns = wire.host.clock.now_ns()
    wire.stop()
    assert wire.entered_s[0] < 0.002


def test_a_drive_that_leaves_the_exchange_while_its_order_is_lost_is_ordered_at_once() -> None:
    wire = Wire("cst")
    wire.faults.lose(lambda identifier, host: identifier == 0x200 + DRIVE_NODE, 1 << 30)
    wire.host.bench.bus.attach().send(0x000, bytes([0x80, DRIVE_NODE]))
    wire.host.clock.sleep_until_ns(wire.host.clock.now_ns() + NS // 20)
    wire.began_ns = wire.host.clock.now_ns()
    wire.stop()
    assert wire.entered_s[0] < 0.004


def test_a_bus_that_is_sent_to_but_not_read_carries_the_order_at_once() -> None:
    """The reception fails before an exchange sends its frames."""
    wire = Wire("cst")
    bus = wire.host.bench.bus

    def collect(timeout_s: float) -> list[Any]:
        raise OSError(errno.ENOBUFS, "no room")

    bus.collect = collect  # type: ignore[method-assign]
    assert not wire.safe().verified
    assert wire.entered[0] is State402.QUICK_STOP_ACTIVE
    assert wire.entered_s[0] < 0.002


def test_a_drive_that_answers_no_order_gets_no_heartbeat() -> None:
    """A drive in NMT STOPPED receives nothing; its watchdog brakes it."""
    wire = Wire("cst")
    wire.host.bench.bus.attach().send(0x000, bytes([0x02, DRIVE_NODE]))
    with pytest.raises(LinkError, match="left the NMT state OPERATIONAL"):
        wire.host.cycles(100)
    wire.began_ns = wire.host.clock.now_ns()
    assert wire.safe().verified
    watch_s = wire.host.servo.watch_s
    assert watch_s is not None
    assert wire.entered == [State402.FAULT_REACTION, State402.FAULT]
    assert wire.entered_s[0] < watch_s + 0.002


def test_every_state_has_an_answer_to_every_event() -> None:
    going = {state for state, _ in TRANSITIONS}
    assert {(state, event) for state in going for event in Event} == set(TRANSITIONS)
    ended = set(State) - going
    assert ended == {State.OFF, State.GIVEN_UP, State.RUNAWAY}
    for state in ended:
        with pytest.raises(ValueError, match=f"{state.name} on GROWS"):
            next_state(state, Event.GROWS)


def test_from_every_state_the_braking_ends() -> None:
    for state in {state for state, _ in TRANSITIONS}:
        ends = [next_state(state, e) for e in (Event.STOPPED, Event.TIME_OVER, Event.GROWS)]
        assert ends == [State.OFF, State.GIVEN_UP, State.RUNAWAY]
        assert next_state(state, Event.BRAKES) is State.BRAKING


def test_a_drive_without_process_data_that_becomes_faster_is_cut_by_request() -> None:
    """As the guardian finds a drive that it has not prepared."""
    for growth, cut in ((0.0, False), (0.5, True)):
        servo = Servo({})
        moved = servo.motion

        def faster(moved: Any = moved, servo: Servo = servo, growth: float = growth) -> Any:
            angle, speed = servo.moved
            servo.moved = angle + speed * CYCLE_NS / NS, speed + growth
            return moved()

        servo.moved = (0.0, 0.2)
        servo.motion = faster  # type: ignore[method-assign]
        state, steps = braked(servo)
        assert state is (OFF if cut else BRAKING)
        assert bool(steps.cut) is cut
        assert servo.order.count("disable") == cut
        if cut:
            assert servo.clock.now_ns() < 0.1 * NS


def test_a_cycle_that_shows_a_runaway_ends_the_ramp_at_once() -> None:
    servo = Servo({"watch": lambda: RunawayError("faster")})
    servo.prepared = True
    state, steps = braked(servo)
    assert servo.order == ["quick_stop", "watch", "disable", "state"]
    assert (state, steps.cut) == (OFF, "faster")


@pytest.mark.parametrize("loop", ["velocity", "phases"])
def test_a_ramp_that_goes_the_wrong_way_is_cut_by_the_control_cycle(loop: Loop) -> None:
    """The loop changes its sign in motion, when the program orders the drive to brake."""
    wire = Wire()
    host, sink = wire.host, SimpleNamespace(sample=lambda *_: None)
    devices = Devices(host.link, host.servo, host.encoder)
    cycle = Cycle(CYCLE_LIMITS, NS // 1000, devices, sink, StopButton(), lambda *_: None)
    cycle.ask_reset()
    cycle.begin(0.16)
    cycle.follow([0.16 + 0.8 * n / 1000 for n in range(1, 50)], 0, "motion")
    host.bench.machine.reverse(loop)
    wire.began_ns = host.clock.now_ns()
    safe = stopped_by_ramp(host.servo, cycle.watch, host.clock, NS // 1000, watched=True)
    assert (safe.verified, bool(safe.cut)) == (True, True)
    assert wire.entered == [State402.QUICK_STOP_ACTIVE, State402.SWITCH_ON_DISABLED]
    assert wire.off_s < 0.02
    assert 0.8 < abs(wire.off_rad_s) < 3.0
