"""Behaviour of the simulated drive that the safety of a bench leans on."""

import math
from contextlib import suppress
from dataclasses import replace

import pytest

from drivers.errors import DeviceError, DriveFault
from drivers.interfaces import ServoState
from drivers.mock.drive import FOLLOWING_ERROR
from drivers.mock.plant.parts.constants import Machine, Motor, Sensing
from drivers.mock.power_state import POWERED, State
from drivers.mock.sampler import encoder_resolution

from .host import Host, enabled, make_host, prepared

MOVING_S = 0.2


def moving(host: Host, speed_rad_s: float = 0.3, **objects: int) -> Host:
    """Leave the joint moving at constant speed, after writing objects (``x605A=2``)."""
    prepared(host)
    for name, value in objects.items():
        host.drive.write(int(name[1:], 16), 0, value)
    host.servo.enable()
    host.cycles(round(MOVING_S * 1e3), lambda t: speed_rad_s * t)
    return host


def bring(host: Host, state: State) -> None:
    """Bring the drive into a state by SDO, as a careless master could."""
    prepared(host)
    write = host.drive.write
    write(0x6060, 0, 8)
    write(0x605A, 0, 6)
    write(0x6085, 0, 1)
    words = {
        State.SWITCH_ON_DISABLED: [],
        State.READY: [0x06],
        State.SWITCHED_ON: [0x06, 0x07],
        State.OPERATION_ENABLED: [0x06, 0x07, 0x0F],
        State.QUICK_STOP_ACTIVE: [0x06, 0x07, 0x0F, 0x02],
        State.FAULT_REACTION: [0x06, 0x07, 0x0F],
        State.FAULT: [0x06],
    }
    for word in words[state]:
        write(0x6040, 0, word)
    if state in (State.FAULT_REACTION, State.FAULT):
        host.bench.drive.connection_lost(0x8130)
    assert host.bench.drive.power_state is state


@pytest.mark.parametrize("verb", ["disable", "quick_stop", "reset_fault"])
@pytest.mark.parametrize("state", [s for s in State if s is not State.NOT_READY])
def test_no_verb_but_enable_leads_to_power(host: Host, state: State, verb: str) -> None:
    bring(host, state)
    host.powered.clear()
    with suppress(DeviceError):
        getattr(host.servo, verb)()
    for _ in range(30):
        with suppress(DeviceError):
            host.cycles(1, lambda _: 0.1)
    assert True not in host.powered
    if state not in POWERED:
        assert host.bench.drive.power_state not in POWERED
    if verb == "disable":
        assert host.bench.drive.power_state not in POWERED


@pytest.mark.parametrize(
    ("option", "first", "last"),
    [
        (0, State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED),
        (1, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
        (2, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
        (5, State.QUICK_STOP_ACTIVE, State.QUICK_STOP_ACTIVE),
        (6, State.QUICK_STOP_ACTIVE, State.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_options(host: Host, option: int, first: State, last: State) -> None:
    moving(host, x605A=option, x6084=1_000_000)
    host.drive.write(0x6040, 0, 0x02)
    assert host.bench.drive.power_state is first
    # Past the ramp, short of the 100 ms after which the silent master would be noticed.
    host.wait(0.05)
    host.link.heartbeat()
    host.wait(0.045)
    assert host.bench.drive.power_state is last
    assert bool(host.drive.read(0x6041) & 0x0400) is (last is State.QUICK_STOP_ACTIVE)
    assert abs(host.bench.machine.truth().velocity_rad_s) < 1e-3


@pytest.mark.parametrize(("option", "deceleration"), [(1, "x6084"), (2, "x6085")])
def test_a_ramp_takes_the_time_of_its_deceleration(host, option, deceleration):
    speed = 0.3
    ramp = round(10 * speed * 4096 * 100 / math.tau)
    moving(host, speed, x605A=option, **{deceleration: ramp})
    at = host.bench.machine.truth().angle_rad
    host.drive.write(0x6040, 0, 0x02)
    host.wait(0.09)
    assert host.bench.drive.power_state is State.QUICK_STOP_ACTIVE
    host.link.heartbeat()
    host.wait(0.05)
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED
    assert host.bench.machine.truth().angle_rad - at == pytest.approx(speed * 0.1 / 2, rel=0.2)


def test_quick_stop_is_left_toward_power_only_where_the_option_allows(host: Host) -> None:
    bring(host, State.QUICK_STOP_ACTIVE)
    host.drive.write(0x605A, 0, 2)
    host.drive.write(0x6040, 0, 0x0F)
    assert host.bench.drive.power_state is State.QUICK_STOP_ACTIVE
    host.drive.write(0x605A, 0, 6)
    host.drive.write(0x6040, 0, 0x0F)
    assert host.bench.drive.power_state is State.OPERATION_ENABLED


def test_a_silent_master_ends_motion_and_power(host: Host) -> None:
    moving(host)
    off_after = None
    for millisecond in range(200):
        host.wait(0.001)
        if host.bench.drive.power_state not in POWERED:
            off_after = millisecond + 1
            break
    # 100 ms after the last heartbeat, which is up to 25 ms old, then the ramp and 20 ms to settle.
    assert off_after is not None
    assert 75 <= off_after <= 100 + 50
    assert host.bench.drive.power_state is State.FAULT
    assert host.drive.read(0x603F) == 0x8130
    assert abs(host.bench.machine.truth().velocity_rad_s) < 1e-3
    with pytest.raises(DriveFault, match="8130h"):
        host.link.exchange()


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.OPERATION_ENABLED),
        (1, State.FAULT_REACTION),
        (2, State.SWITCH_ON_DISABLED),
        (3, State.QUICK_STOP_ACTIVE),
    ],
)
def test_abort_connection_options(host: Host, option: int, state: State) -> None:
    enabled(host)
    host.drive.write(0x6007, 0, option)
    host.bench.drive.connection_lost(0x8130)
    assert host.bench.drive.power_state is state


@pytest.mark.parametrize(
    ("command", "state"),
    [(2, State.FAULT), (129, State.SWITCH_ON_DISABLED), (130, State.SWITCH_ON_DISABLED)],
)
def test_an_nmt_stop_or_reset_ends_power(host: Host, command: int, state: State) -> None:
    enabled(host)
    assert host.powered[-1]
    host.link.send(0x000, bytes([command, 1]))
    host.wait(0.1)
    assert host.bench.drive.power_state is state
    assert not host.powered[-1]


@pytest.mark.parametrize(
    ("reaction", "first"), [(0, State.FAULT), (1, State.FAULT_REACTION), (2, State.FAULT_REACTION)]
)
def test_fault_reaction_options(host: Host, reaction: int, first: State) -> None:
    enabled(host)
    host.drive.write(0x605E, 0, reaction)
    host.bench.drive.connection_lost(0x8130)
    assert host.bench.drive.power_state is first
    host.wait(0.1)
    assert host.bench.drive.power_state is State.FAULT
    assert not host.powered[-1]


def test_following_error_beyond_its_window_is_a_fault_and_within_is_none(host: Host) -> None:
    prepared(host)
    host.servo.write_limits(replace(host.servo.read_limits(), following_error_rad=0.02))
    host.servo.enable()
    host.cycles(50, lambda _: 0.015)
    assert host.servo.state() is ServoState.OPERATION_ENABLED
    with pytest.raises(DriveFault, match="following error") as caught:
        host.cycles(50, lambda _: 0.5)
    assert caught.value.code == 0x8611
    assert host.servo.sample().statusword & 0x2000
    host.wait(0.1)
    assert host.servo.state() is ServoState.FAULT
    assert not host.powered[-1]
    with pytest.raises(DriveFault, match="8611h"):
        host.servo.enable()
    host.servo.reset_fault()
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    host.servo.enable()
    assert not host.servo.sample().statusword & 0x2000


def test_software_limits_clamp_the_target(host: Host) -> None:
    prepared(host)
    host.servo.write_limits(
        replace(host.servo.read_limits(), angle_min_rad=-0.05, angle_max_rad=0.05)
    )
    host.servo.enable()
    host.cycles(50, lambda _: 0.02)
    assert not host.servo.sample().statusword & 0x0800
    host.cycles(300, lambda t: 0.02 + 0.3 * t)
    assert host.encoder.sample().angle_rad == pytest.approx(0.05, abs=1e-3)
    assert host.servo.sample().statusword & 0x0800
    host.cycles(500, lambda t: 0.11 - 0.3 * t)
    assert not host.bench.machine.truth().angle_rad < -0.051


def test_max_speed_holds_the_target_back(host: Host) -> None:
    prepared(host)
    host.servo.write_limits(replace(host.servo.read_limits(), speed_rad_s=0.1))
    host.servo.enable()
    host.cycles(200, lambda _: 0.5)
    assert host.encoder.sample().angle_rad == pytest.approx(0.02, abs=2e-3)
    assert host.servo.sample().statusword & 0x0800


@pytest.mark.parametrize("limit", [{"current_A": 3.0}, {"torque_N_m": 9.0}])
def test_max_current_and_torque_hold_the_motor_back(host: Host, limit: dict[str, float]) -> None:
    prepared(host)
    host.servo.write_limits(replace(host.servo.read_limits(), **limit))
    host.servo.enable()
    # 3 A make 9 N m at the joint; 12.025 N m are needed to break away.
    host.cycles(200, lambda t: 0.1 * t)
    sample = host.servo.sample()
    assert sample.current_A == pytest.approx(3.0, abs=0.1)
    assert sample.statusword & 0x0800
    assert abs(host.bench.machine.truth().angle_rad) < 1e-4
    host.servo.write_limits(replace(host.servo.read_limits(), current_A=20.0, torque_N_m=60.0))
    host.cycles(200, lambda _: 0.02)
    assert host.bench.machine.truth().angle_rad == pytest.approx(0.02, abs=1e-3)


def test_an_exact_sensor_counts_microradians_of_the_joint() -> None:
    exact = Machine(sensing=Sensing(motor_counts_per_turn=0))
    increments, turns = encoder_resolution(exact)
    assert increments / turns * 100.0 / math.tau == pytest.approx(1e6, rel=1e-7)
    literal = replace(exact, motor=Motor(gear_ratio=1.0))
    increments, turns = encoder_resolution(literal)
    assert increments / turns / math.tau == pytest.approx(1e6, rel=1e-8)
    assert increments < 1 << 32
    assert encoder_resolution(Machine()) == (4096, 1)


@pytest.fixture
def pushed() -> Host:
    return make_host(torque_offset=True)


def held(pushed: Host) -> int:
    """What the drive itself has in 60B2h."""
    return pushed.bench.drive.objects.integer(0x60B2)


def current(pushed: Host, cycles: int = 40) -> float:
    """Mean motor current over the last cycles, A."""
    values = []
    for _ in range(cycles):
        pushed.cycles(1)
        values.append(pushed.servo.sample().current_A)
    return sum(values) / len(values)


def test_a_resting_joint_takes_the_torque_as_current(pushed: Host) -> None:
    """The loops see no error, so that the current is the offset's: 6 N m over 3 N m/A."""
    enabled(pushed)
    before = current(pushed)
    pushed.servo.set_torque_offset(6.0)
    pushed.cycles(20)
    assert current(pushed) - before == pytest.approx(2.0, abs=0.02)
    assert pushed.bench.machine.truth().angle_rad == 0.0


def test_it_does_not_pass_the_limit_of_the_current(pushed: Host) -> None:
    prepared(pushed)
    pushed.servo.write_limits(replace(pushed.servo.read_limits(), current_A=3.0))
    pushed.servo.enable()
    pushed.servo.set_torque_offset(11.9)
    pushed.cycles(30)
    assert current(pushed) == pytest.approx(3.0, abs=0.02)


def test_the_drive_adds_nothing_to_a_ramp_of_its_own(pushed: Host) -> None:
    """A fault stops the drive by itself, with 60B2h still as it was."""
    enabled(pushed)
    pushed.servo.set_torque_offset(8.0)
    pushed.cycles(20)
    pushed.bench.drive.fail(FOLLOWING_ERROR)
    pushed.wait(0.01)
    assert held(pushed) == 178
    pushed.wait(0.05)
    assert pushed.servo.state() is ServoState.FAULT
    assert pushed.bench.machine.truth().current_A == 0.0
    assert pushed.bench.machine.truth().angle_rad == 0.0
