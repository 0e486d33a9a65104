import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import pytest

from drivers.dbc.bind import bind
from drivers.dbc.file import read_dbc
from drivers.dbc.link import DbcLink
from drivers.dbc.map import Protection, Quantity
from drivers.dbc.servo import DbcServo
from drivers.errors import ConfigurationError, DeviceError, DriveFault, LinkError, StateError
from drivers.interfaces import ServoState
from drivers.mock.dbc_drive import COMMISSIONED, DRIVE_DBC, POWERED, DbcDrive, Order, State
from drivers.mock.encoder import ENCODER_EDS

from .dbc_host import DRIVE, HELD, MAP, DbcHost, enabled, make_dbc_host, prepared
from .servo_steps import Case, StepsContract

COMMAND, MOTION, POWER, STOP, LIMITS = 0x110, 0x190, 0x191, 0x010, 0x120
VERBS: dict[str, Callable[[DbcHost], object]] = {
    "state": lambda host: host.servo.state(),
    "identity": lambda host: host.servo.identity(),
    "read_limits": lambda host: host.servo.read_limits(),
    "write_limits": lambda host: host.servo.write_limits(HELD),
    "prepare": lambda host: host.servo.prepare(host.cycle_s),
    "disable": lambda host: host.servo.disable(),
    "quick_stop": lambda host: host.servo.quick_stop(),
    "reset_fault": lambda host: host.servo.reset_fault(),
    "set_target": lambda host: host.servo.set_target(0.1),
    "exchange": lambda host: host.cycles(30, lambda _: 0.1),
    "close": lambda host: host.link.close(),
}


@pytest.fixture
def host(dbc: DbcHost) -> DbcHost:
    return dbc


def orders(host: DbcHost) -> list[int]:
    """Orders in the commands that the host has sent since the last call."""
    return [frame.data[0] & 15 for frame in host.link.take_frames() if frame.identifier == COMMAND]


def put(drive: DbcDrive, state: State) -> None:
    """Bring the drive, not the host, into a state."""
    for between in (State.READY, State.RUN):
        if state in (State.OFF, State.FAULT) or drive.state is state:
            break
        drive._enter(between)
    if state in (State.FAULT, State.BRAKING):
        drive.fail(9)
    if drive.state is not state:
        drive._enter(state)
    assert drive.state is state


class Fake:
    """The simulated drive, as the suite of steps sees it."""

    def __init__(self, host: DbcHost) -> None:
        self.host = host
        self.clock = host.clock
        self.sends: list[tuple[int, bytes]] = []
        self.loses: dict[int, Callable[[], None]] = {}
        self.passed = 0
        link, send, exchange = host.link, host.link.send, host.link.exchange

        def noted(identifier: int, data: bytes) -> None:
            self.sends.append((identifier, data))
            send(identifier, data)

        def losing() -> None:
            self.passed += 1
            exchange()
            self.loses.pop(self.passed, lambda: None)()

        link.send, link.exchange = noted, losing  # type: ignore[method-assign]

    @property
    def cycle(self) -> int:
        return self.passed

    @property
    def follows(self) -> bool:
        return True

    @follows.setter
    def follows(self, _: bool) -> None:
        self.host.bench.drive._obey = lambda order: None
        self.host.bench.drive._port.listen(STOP, lambda data: None)

    def put(self, state: ServoState) -> None:
        put(self.host.bench.drive, DRIVE_STATES[state])

    def take(self) -> list[tuple[int, bytes]]:
        sent, self.sends = self.sends, []
        return sent


DRIVE_STATES = {
    ServoState.OPERATION_ENABLED: State.RUN,
    ServoState.QUICK_STOP_ACTIVE: State.STOPPING,
    ServoState.FAULT_REACTION: State.BRAKING,
    ServoState.FAULT: State.FAULT,
}


class TestSteps(StepsContract):
    @pytest.fixture
    def case(self, host: DbcHost) -> Case:
        fake = Fake(host)

        def servo(prepare: bool = True, state_timeout_s: float = 1.0) -> DbcServo:
            made = DbcServo(host.link, host.channel, DRIVE, state_timeout_s)
            if prepare:
                made.prepare(host.cycle_s)
            return made

        return Case(
            fake,
            servo,
            fake.put,
            fake.take,
            lambda entry: entry[0] == COMMAND and entry[1][0] & 15 == Order.OFF,
            lambda: setattr(host.bench.bus, "down", True),
            host.cycle_s,
        )


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("state", State)
def test_no_verb_but_enable_leads_toward_power(host: DbcHost, state: State, verb: str) -> None:
    put(prepared(host).bench.drive, state)
    host.powered.clear()
    host.link.take_frames()
    with suppress(DeviceError):
        VERBS[verb](host)
        host.wait(0.01)
    toward = {Order.READY, Order.RUN}
    assert not toward & set(orders(host))
    assert True not in host.powered
    if state not in POWERED:
        assert host.bench.drive.state not in POWERED


@pytest.mark.parametrize("verb", ["disable", "quick_stop"])
def test_a_stop_survives_lost_commands(host: DbcHost, verb: str) -> None:
    enabled(host)
    host.lose(COMMAND, 1)
    host.lose(STOP, 1)
    VERBS[verb](host)
    host.cycles(2)
    assert host.bench.drive.state in (State.OFF, State.STOPPING)


def test_the_stop_frame_alone_stops(host: DbcHost) -> None:
    enabled(host)
    host.lose(COMMAND)
    host.servo.quick_stop()
    host.servo.disable()
    assert host.bench.drive.state is State.OFF


def test_a_reset_survives_a_lost_frame(host: DbcHost) -> None:
    prepared(host)
    host.bench.drive.fail(0x42)
    host.lose(COMMAND, 2)
    host.servo.reset_fault()
    assert host.bench.drive.state is State.OFF


@pytest.mark.parametrize("sign", [1, -1])
def test_sign_scale_and_zero_of_a_sample(sign: int) -> None:
    reported = replace(
        MAP.inputs,
        position=replace(MAP.inputs.position, sign=sign),
        velocity=replace(MAP.inputs.velocity, sign=sign),
        current=replace(MAP.inputs.current, sign=sign),
        voltage=replace(MAP.inputs.voltage, sign=sign),
    )
    spec = replace(MAP, inputs=reported, target=replace(MAP.target, sign=sign))
    host = make_dbc_host(spec=spec, drive=replace(DRIVE, offset_rad=0.1))
    enabled(host)
    host.cycles(400, lambda t: 0.1 + 0.2 * t)
    sample = host.servo.sample()
    assert sample.motor_angle_rad / 100.0 == pytest.approx(0.18, abs=2e-3)
    assert host.bench.machine.truth().angle_rad == pytest.approx(sign * 0.08, abs=2e-3)
    assert sample.velocity_rad_s == pytest.approx(0.2, rel=0.1)
    assert sample.current_A > 1.0
    assert sample.voltage_V > 1.0
    assert (sample.supply_voltage_V, sample.temperature_C) == (60.0, 25.0)
    assert abs(sample.following_error_rad) < 5e-3


def test_limits_survive_the_way_to_the_drive_and_back(host: DbcHost) -> None:
    wanted = replace(HELD, angle_min_rad=-0.4, angle_max_rad=0.3, speed_rad_s=1.5, torque_N_m=30.0)
    host.servo.write_limits(wanted)
    held = host.servo.read_limits()
    unit = 0.01 * math.tau / 100
    assert 0 <= held.angle_min_rad - wanted.angle_min_rad < unit
    assert 0 <= wanted.angle_max_rad - held.angle_max_rad < unit
    assert 0 <= wanted.speed_rad_s - held.speed_rad_s < 1.1e-3
    assert 0 <= wanted.torque_N_m - held.torque_N_m < 0.1
    assert held.current_A == pytest.approx(held.torque_N_m / 3.0)
    assert 0 <= wanted.following_error_rad - held.following_error_rad < 1e-4
    host.servo.write_limits(held)
    assert host.servo.read_limits() == held


def test_limits_that_do_not_arrive_are_named(host: DbcHost) -> None:
    host.lose(LIMITS)
    with pytest.raises(
        ConfigurationError,
        match=r"house servo does not accept.*speed \(limits\.speed_deg_s\) reads 240 after",
    ):
        host.servo.write_limits(HELD)


def test_limits_that_a_restart_took_away_are_missed(host: DbcHost) -> None:
    host.servo.write_limits(replace(HELD, speed_rad_s=1.0))
    enabled(host)
    host.cycles(300)
    host.bench.drive.limits = COMMISSIONED
    with pytest.raises(
        StateError, match=r"no longer reports the limits written into it .*speed.* restarted"
    ):
        host.cycles(300)
    # Told once, so that the drive can be stopped.
    host.cycles(300)
    host.servo.disable()


def test_the_exchanges_contain_the_state_after_the_last_order_to_stop(host: DbcHost) -> None:
    host.servo.state()
    assert host.servo.sent_state() is None
    enabled(host)
    assert host.servo.sent_state() is ServoState.OPERATION_ENABLED
    host.cycles(20, lambda t: t)
    host.servo.quick_stop(at_once=False)
    assert host.servo.sent_state() is None
    host.cycles(2)
    assert host.servo.sent_state() is ServoState.QUICK_STOP_ACTIVE
    host.lose(MOTION)
    host.cycles(1)
    assert host.servo.sent_state() is ServoState.QUICK_STOP_ACTIVE
    host.cycles(3)
    assert host.servo.sent_state() is None


def test_a_silent_drive_is_found_out(host: DbcHost) -> None:
    enabled(host)
    host.lose(MOTION)
    with pytest.raises(
        LinkError,
        match=r"sent no valid DRV_Motion \(190h\) in 0\.3 s: check the supply and the bus",
    ):
        host.servo.state()


def test_a_wrong_checksum_in_the_map_is_told_apart_from_silence() -> None:
    messages = {**MAP.messages, "DRV_Motion": Protection("Life", "Check", "sum8")}
    host = make_dbc_host(spec=replace(MAP, messages=messages))
    with pytest.raises(
        LinkError, match=r"\d+ had a wrong length, checksum or counter: check these in the map"
    ):
        host.servo.state()


def test_a_status_that_the_map_does_not_name_is_an_error() -> None:
    states = {name: values for name, values in MAP.status.states.items() if name != "ready"}
    host = make_dbc_host(spec=replace(MAP, status=replace(MAP.status, states=states)))
    prepared(host)
    host.bench.drive._obey = lambda order: None
    host.bench.drive._enter(State.READY)
    host.cycles(1)
    assert host.servo.sample().statusword & 0x6F == 0
    with pytest.raises(StateError, match="reports the status 1, which the map does not contain"):
        host.servo.state()


def test_enabling_does_not_jump_to_an_old_target(host: DbcHost) -> None:
    enabled(host)
    host.cycles(100, lambda t: t)
    host.servo.disable()
    host.wait(0.2)
    at = host.bench.machine.truth().angle_rad
    host.servo.set_target(-0.3)
    host.servo.enable()
    host.cycles(50)
    assert host.bench.machine.truth().angle_rad == pytest.approx(at, abs=2e-4)


def test_a_torque_signal_gives_the_current() -> None:
    torque = Quantity("DRV_Motion.Current", 0.03)
    spec = replace(
        MAP, inputs=replace(MAP.inputs, current=None, torque=torque, voltage=None, time=None)
    )
    host, plain = make_dbc_host(spec=spec), make_dbc_host()
    for each in (host, plain):
        enabled(each)
        each.cycles(100, lambda t: 0.2 * t)
    first, second = host.servo.sample(), plain.servo.sample()
    assert first.current_A == pytest.approx(second.current_A)
    assert math.isnan(first.voltage_V)
    # Without a time signal the host's time of arrival stands in.
    assert first.device_time_s == pytest.approx(host.clock.now_ns() * 1e-9, abs=1e-3)


def test_a_cycle_too_slow_for_the_watchdog_is_refused(host: DbcHost) -> None:
    with pytest.raises(ConfigurationError, match="every 60 ms, but the drive stops after 100 ms"):
        host.servo.prepare(0.06)
    assert host.link.has_watchdog
    without = make_dbc_host(drive=replace(DRIVE, watchdog_s=None))
    assert not without.link.has_watchdog
    without.servo.prepare(0.06)


@pytest.mark.parametrize("identifier", [MOTION, POWER, COMMAND])
def test_a_lost_frame_makes_one_sample_stale(host: DbcHost, identifier: int) -> None:
    enabled(host)
    host.cycles(5)
    assert host.servo.sample().fresh
    host.lose(identifier, 1)
    host.cycles(1)
    assert not host.servo.sample().fresh
    host.cycles(1)
    assert host.servo.sample().fresh


def test_an_answer_of_the_cycle_before_is_not_taken_for_this_one(host: DbcHost) -> None:
    """It lies in the receive buffer when the exchange begins."""
    enabled(host)
    host.cycles(5)
    host.bench.drive._tell_power()
    seen: list[bytes] = []

    def keep_first(_time: int, found: int, data: bytes, _sent: bool) -> tuple[int, bytes] | None:
        if found == POWER:
            seen.append(data)
        return None if len(seen) > 1 and found == POWER else (found, data)

    host.bench.bus.frame_filters.append(keep_first)
    host.cycles(1)
    assert len(seen) == 2
    assert host.channel.slots[POWER].data == seen[0]
    assert not host.servo.sample().fresh


def test_command_and_sync_leave_together(host: DbcHost) -> None:
    prepared(host)
    host.cycles(3)
    host.link.take_frames()
    host.cycles(1)
    sent = [frame.identifier for frame in host.link.take_frames() if frame.sent]
    assert sent[:2] == [COMMAND, 0x080]


def test_closing_sends_the_stop_frame(host: DbcHost) -> None:
    enabled(host)
    host.cycles(3)
    host.link.take_frames()
    host.link.close()
    assert [(f.identifier, f.data) for f in host.link.take_frames() if f.sent] == [(STOP, b"\xa5")]
    host.wait(0.1)
    assert host.bench.drive.state is State.OFF
    assert not host.powered[-1]


def test_a_bus_that_was_only_listened_to_is_left_alone(host: DbcHost) -> None:
    host.servo.state()
    host.servo.identity()
    host.servo.read_limits()
    host.link.close()
    assert not [frame for frame in host.link.take_frames() if frame.sent]


def test_a_fault_while_running_is_raised_once(host: DbcHost) -> None:
    enabled(host)
    host.cycles(10)
    host.bench.drive.fail(0x42)
    with pytest.raises(DriveFault, match="0042h: the house servo is in fault") as caught:
        host.cycles(3)
    assert caught.value.code == 0x42
    host.cycles(50)
    assert host.bench.drive.state is State.FAULT


@pytest.mark.parametrize(
    ("change", "owner"),
    [
        ((" 400 ", " 386 "), "CANopen node 2"),
        ((" 272 ", " 128 "), "SYNC"),
        ((" 400 ", " 1919 "), "CANopen node 127"),
    ],
)
def test_identifiers_may_not_collide(host, tmp_path, change, owner):
    path = tmp_path / "moved.dbc"
    path.write_text(DRIVE_DBC.read_text().replace(*change))
    link = DbcLink(host.clock, lambda: host.bench.bus, "simulated bus")
    link.add_node(2, ENCODER_EDS)
    link.add_channel(bind(MAP, read_dbc(path)), "the drive")
    with pytest.raises(ConfigurationError, match=f"the drive and {owner} both use the CAN identi"):
        link.open()


def test_a_command_may_go_less_often_than_the_cycle() -> None:
    messages = {**MAP.messages, "DRV_Command": replace(MAP.messages["DRV_Command"], period_ms=4)}
    # Then the drive answers as seldom, and the map says so.
    for name in ("DRV_Motion", "DRV_Power"):
        messages[name] = replace(messages[name], period_ms=4)
    host = make_dbc_host(spec=replace(MAP, messages=messages))
    enabled(host)
    host.link.take_frames()
    for _ in range(40):
        host.cycles(1, lambda t: 0.01)
        assert host.servo.sample().fresh
    assert sum(frame.identifier == COMMAND for frame in host.link.take_frames()) == 10
