"""The CiA 402 servo against a channel that notes everything."""

import math
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import pytest

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.motion import TORQUE_OFFSET, CyclicPosition
from drivers.clock import NS, SimulatedClock
from drivers.errors import ConfigurationError, LinkError, ObjectAccessError, StateError
from drivers.interfaces import ServoSample, ServoState
from drivers.mock.power_state import FAULT_RESET, TRANSITIONS, State, command
from drivers.objects import PdoLayout
from drivers.servo_limits import OBJECTS
from drivers.units import ServoScales

from .host import SCALES
from .servo_steps import Case, StepsContract

UNITY = ServoScales(
    counts_per_turn=math.tau, gear_ratio=1.0, rated_current_A=15.0, rated_torque_N_m=1000.0
)
"""One count is one radian, one per mille of the torque one N m."""
CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY = (0x6040, 0), (0x6041, 0), (0x6060, 0), (0x6061, 0)
LIMITS_AND_SETTINGS = (*OBJECTS, (0x60C2, 1), (0x60C2, 2), (0x6007, 0))
READ_NS = 1_000_000
CYCLE_S = 0.004
CYCLE_NS = 4_000_000


def noted(name: str) -> Any:
    """Return a method that only notes its call."""
    return lambda self, *values: self.log.append((name, *values))


class Drive:
    """A drive, its channel and the link to it; a read takes a millisecond, an exchange none."""

    has_watchdog = latches = True
    label = "drive 1"
    watch, unwatch, forget_faults = map(noted, ("watch", "unwatch", "forget faults"))
    require_mappable = limit_wait = staticmethod(lambda *_: None)
    unguarded = staticmethod(lambda _watched: ())
    kept_alive = staticmethod(nullcontext)

    def __init__(self) -> None:
        self.clock = SimulatedClock(5 * NS)
        self.log: list[tuple[Any, ...]] = []
        self.state = State.SWITCH_ON_DISABLED
        self.follows = True
        self.fresh = True
        self.cycle = 0
        self.word = 0
        self.objects = {
            (0x6075, 0): 15000,
            (0x6076, 0): 450,
            (0x6064, 0): 1234,
            (0x603F, 0): 0x8611,
            TORQUE_OFFSET: 0,
        }
        self.objects |= dict.fromkeys(LIMITS_AND_SETTINGS, 0)
        self.objects |= {MODE: 0, MODE_DISPLAY: 0, (0x608F, 1): 4096, (0x608F, 2): 1}
        self.inputs: dict[int, tuple[int, ...]] = {}
        self.loses: dict[int, Callable[[], None]] = {}
        self.refuses: dict[tuple[int, int], Exception] = {}
        self.lacks: set[tuple[int, int]] = {(0x6502, 0), (0x60A9, 0)}
        self.sync_us = 0

    def _become(self, word: int) -> None:
        if self.follows:
            if self.state is State.FAULT and word & FAULT_RESET and not self.word & FAULT_RESET:
                self.state = State.SWITCH_ON_DISABLED
            else:
                self.state = TRANSITIONS.get((self.state, command(word)), self.state)
        self.word = word

    @property
    def statusword(self) -> int:
        return 0x1600 | self.state.value

    def read(self, index: int, subindex: int = 0) -> int:
        self.clock.sleep_until_ns(self.clock.now_ns() + READ_NS)
        if (index, subindex) in self.refuses:
            raise self.refuses[index, subindex]
        if (index, subindex) == STATUSWORD:
            return self.statusword
        if (index, subindex) not in self.objects:
            raise ObjectAccessError(index, subindex, 0x06020000, "no such object")
        return self.objects[index, subindex]

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        return (index, subindex) not in self.lacks

    def fit_together(self, addresses: Any) -> bool:
        return len(addresses) <= 3

    def read_text(self, index: int, subindex: int = 0) -> str:
        return f"{index:04X}"

    def write(self, index: int, subindex: int, value: int) -> None:
        self.log.append(("write", (index, subindex), value))
        if (index, subindex) in self.refuses:
            raise self.refuses[index, subindex]
        self.objects[index, subindex] = value
        if (index, subindex) == CONTROLWORD:
            self._become(value)
        if (index, subindex) == MODE:
            self.objects[MODE_DISPLAY] = value

    def insist(self, index: int, subindex: int, value: int) -> None:
        self.log.append(("insist", (index, subindex), value))
        if "insist" in self.refuses:
            raise self.refuses["insist"]  # type: ignore[index]
        self._become(value)

    def announce(self, index: int, subindex: int, value: int) -> None:
        self.log.append(("announce", (index, subindex), value))

    def map_process_data(
        self, outputs: Any, inputs: Any, cycle_s: float, watched: bool = False
    ) -> None:
        self.log.append(("map", outputs, inputs, cycle_s))

    def accessed(self, outputs: Any, inputs: Any, watched: bool) -> Any:
        return (address for layout in (*outputs, *inputs) for address in layout.objects)

    def stage(self, number: int, *values: int) -> None:
        self.log.append(("stage", number, values))
        self.staged = values

    def latest(self, number: int) -> tuple[int, ...]:
        return self.inputs[number]

    def exchange(self) -> None:
        self.cycle += 1
        self.log.append(("exchange", self.clock.now_ns()))
        self._become(self.staged[0])
        self.inputs[1] = (self.statusword, 1300 + self.cycle, 7)
        self.loses.pop(self.cycle, lambda: None)()

    def take(self, what: str | None = None) -> list[tuple[Any, ...]]:
        """Return what was logged since the last call, of one kind or all."""
        log, self.log = self.log, []
        return [entry for entry in log if what is None or entry[0] == what]


def make(drive: Drive, scales: ServoScales = SCALES, **options: Any) -> Cia402Servo:
    whole: Any = drive
    offset = options.pop("torque_offset", False)
    options.setdefault("motion", CyclicPosition(offset))
    return Cia402Servo(whole, whole, scales, **options)


def prepared(drive: Drive, scales: ServoScales = SCALES, **options: Any) -> Cia402Servo:
    if scales is UNITY:
        drive.objects |= {(0x6076, 0): 1_000_000, (0x608F, 1): 6283, (0x608F, 2): 1000}
    servo = make(drive, scales, **options)
    servo.prepare(CYCLE_S)
    return servo


def enabled(drive: Drive, scales: ServoScales = SCALES, **options: Any) -> Cia402Servo:
    servo = prepared(drive, scales, **options)
    servo.enable()
    drive.take()
    return servo


@pytest.fixture
def drive() -> Drive:
    return Drive()


class TestSteps(StepsContract):
    @pytest.fixture
    def case(self, drive: Drive) -> Case:
        def servo(prepare: bool = True, **options: Any) -> Cia402Servo:
            return prepared(drive, **options) if prepare else make(drive, **options)

        def deafen() -> None:
            drive.refuses["insist"] = LinkError("gone")  # type: ignore[index]

        return Case(
            drive,
            servo,
            lambda state: setattr(drive, "state", State[state.name]),
            drive.take,
            lambda entry: entry == ("insist", CONTROLWORD, 0),
            deafen,
            more=1,
        )


@pytest.mark.parametrize("offset", [False, True])
def test_preparing(drive: Drive, offset: bool) -> None:
    drive.objects[0x60B2, 0] = 0
    servo = prepared(drive, watch_s=0.25, torque_offset=offset)
    outputs = ((0x6040, 0), (0x607A, 0), *([(0x60B2, 0)] if offset else []))
    assert drive.take() == [
        ("write", (0x60C2, 1), 4),
        ("write", (0x60C2, 2), -3),
        ("write", (0x6007, 0), 1),
        (
            "map",
            [PdoLayout(1, outputs)],
            [
                PdoLayout(1, ((0x6041, 0), (0x6064, 0), (0x6078, 0)), mean=(0x6078, 0)),
                PdoLayout(2, ((0x606C, 0), (0x1013, 0))),
                PdoLayout(3, ((0x2100, 0),)),
                PdoLayout(4, ((0x6079, 0), (0x2101, 0), (0x6077, 0)), 10),
            ],
            CYCLE_S,
        ),
        ("watch", 0.25),
        ("unwatch",),
        ("stage", 1, (0, 1234, *([0] if offset else []))),
    ]
    servo.enable()
    assert ("watch", 0.25) in drive.take()


def test_prepared_again_it_starts_from_nothing(drive: Drive) -> None:
    servo = enabled(drive, torque_offset=True)
    servo.set_torque_offset(9.0)
    drive.inputs |= {2: (0, 0xFFFFFFFF), 3: (0,), 4: (0, 0)}
    assert servo.sample().device_time_s == pytest.approx(4294.967295)
    drive.state = State.SWITCH_ON_DISABLED
    servo.prepare(CYCLE_S)
    assert drive.take("stage")[-1] == ("stage", 1, (0, 1234, 0))
    for time_us, seconds in (
        (5, 5e-6),
        (2**31, 2147.483648),
        (2**32 - 1, 4294.967295),
        (7, 4294.967303),
    ):
        drive.inputs[2] = (0, time_us)
        assert servo.sample().device_time_s == pytest.approx(seconds, abs=1e-9)


@pytest.mark.parametrize(
    ("cycle_s", "whole_ms"),
    [
        *((0.001, 1), (0.001 + 0.9e-9, 1), (0.001 - 0.9e-9, 1), (0.01, 10), (1.0, 1000)),
        *((0.0, None), (0.0015, None), (0.001 + 1.2e-9, None), (0.001 - 1.2e-9, None)),
    ],
)
def test_a_cycle_is_of_whole_milliseconds(drive, cycle_s, whole_ms):
    with pytest.raises(ConfigurationError, match="60C2h") if whole_ms is None else nullcontext():
        make(drive).prepare(cycle_s)
    assert drive.take()[:1] == ([("write", (0x60C2, 1), whole_ms)] if whole_ms else [])


@pytest.mark.parametrize(
    "error", [ConfigurationError("not in the EDS"), ObjectAccessError(0x60B2, 0, 0x06020000, "no")]
)
def test_a_drive_without_the_torque_offset_is_refused(drive: Drive, error: Exception) -> None:
    drive.refuses[TORQUE_OFFSET] = error
    prepared(drive)
    with pytest.raises(ConfigurationError, match="60B2h") as caught:
        prepared(drive, torque_offset=True)
    assert caught.value.__cause__ is error
    drive.refuses[TORQUE_OFFSET] = LinkError("bus-off")
    with pytest.raises(LinkError, match="bus-off"):
        prepared(drive, torque_offset=True)


@pytest.mark.parametrize("offset", [False, True])
def test_enabling_step_by_step(drive: Drive, offset: bool) -> None:
    servo = prepared(drive, torque_offset=offset)
    servo.set_target(0.5)
    drive.take()
    began = drive.clock.now_ns()
    servo.enable()
    none = [0] if offset else []
    at = began + 2 * READ_NS
    assert all(type(entry[1]) is int for entry in drive.log if entry[0] == "exchange")
    # The state and the position were read; then one exchange a cycle: one for the mode, one for
    # each transition.
    assert drive.take() == [
        ("watch", 0.1),
        ("stage", 1, (0x00, 1234, *none)),
        ("write", MODE, 8),
        ("exchange", at + CYCLE_NS),
        ("exchange", at + 2 * CYCLE_NS + READ_NS),
        ("stage", 1, (0x06, 1302, *none)),
        ("exchange", at + 3 * CYCLE_NS + READ_NS),
        ("stage", 1, (0x07, 1303, *none)),
        ("exchange", at + 4 * CYCLE_NS + READ_NS),
        ("stage", 1, (0x0F, 1304, *none)),
        ("exchange", at + 5 * CYCLE_NS + READ_NS),
    ]
    assert drive.state is State.OPERATION_ENABLED


def test_enabling_begins_without_a_torque_offset(drive: Drive) -> None:
    servo = enabled(drive, torque_offset=True)
    servo.set_torque_offset(9.0)
    drive.state = State.SWITCH_ON_DISABLED
    drive.take()
    servo.enable()
    staged = [entry[2] for entry in drive.take("stage")]
    # The drive had left power by itself, with the word of operation still in the exchange.
    assert staged[0] == (0x00, 1234, 0)
    assert {offset for _, _, offset in staged} == {0}


def test_an_answer_that_is_missing_moves_nothing_on(drive: Drive) -> None:
    servo = prepared(drive)
    for exchange, fresh in ((2, False), (4, True), (6, False), (7, True), (8, False), (10, True)):
        drive.loses[exchange] = lambda fresh=fresh: setattr(drive, "fresh", fresh)  # type: ignore[misc]
    servo.enable()
    assert [entry[2] for entry in drive.take("stage")[2:]] == [
        (0x06, 1304),
        (0x07, 1305),
        (0x0F, 1307),
    ]
    assert drive.cycle == 10


def test_a_drive_whose_mode_does_not_come_is_switched_on_and_not_enabled(drive: Drive) -> None:
    servo = prepared(drive)
    drive.take()
    drive.loses = {
        exchange: lambda: drive.objects.update({MODE_DISPLAY: 3}) for exchange in range(1, 1000)
    }
    with pytest.raises(StateError, match="6061h still reads 3, 1 s after mode 8"):
        servo.enable()
    words = {entry[2][0] for entry in drive.take("stage")}
    assert 0x07 in words
    assert 0x0F not in words
    assert drive.state is State.SWITCH_ON_DISABLED


def test_a_mode_that_is_taken_over_when_the_drive_is_switched_on(drive: Drive) -> None:
    servo = prepared(drive)

    def follow() -> None:
        drive.objects[MODE_DISPLAY] = 8 if drive.state is State.SWITCHED_ON else 0

    drive.loses = dict.fromkeys(range(1, 1000), follow)
    servo.enable()
    assert drive.state is State.OPERATION_ENABLED


@pytest.mark.parametrize(("offered", "good"), [(0x80, True), (0x3FF, True), (0x7F, False)])
def test_a_drive_without_the_mode_stays_as_it_is(drive: Drive, offered: int, good: bool) -> None:
    drive.lacks.clear()
    drive.objects[0x6502, 0] = offered
    servo = prepared(drive)
    drive.take()
    if good:
        servo.enable()
        return
    with pytest.raises(StateError, match=r"does not support mode 8.*6502h reads 0000007Fh"):
        servo.enable()
    assert drive.take("exchange") == []
    assert drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("offset", [False, True])
def test_disabling(drive: Drive, offset: bool) -> None:
    servo = enabled(drive, torque_offset=offset)
    servo.set_target(0.0)
    if offset:
        servo.set_torque_offset(9.0)
    drive.take()
    servo.disable()
    none = [0] if offset else []
    assert drive.take() == [
        ("stage", 1, (0, 0, *none)),
        ("insist", CONTROLWORD, 0),
        ("unwatch",),
        *([("write", TORQUE_OFFSET, 0)] if offset else []),
    ]


def test_a_drive_that_obeys_late_has_obeyed(drive: Drive) -> None:
    servo = enabled(drive)
    drive.follows = False
    drive.clock.call_at(
        drive.clock.now_ns() + 999_500_000, lambda: setattr(drive, "state", State.READY)
    )
    servo.disable()
    assert drive.take()[-1] == ("unwatch",)


def test_a_quick_stop_goes_with_the_exchanges_and_at_once_by_sdo(drive: Drive) -> None:
    servo = enabled(drive)
    drive.follows = False
    assert servo.prepared
    servo.quick_stop(at_once=False)
    assert drive.take() == [("stage", 1, (2, 1304)), ("announce", CONTROLWORD, 2)]
    servo.quick_stop()
    assert drive.take() == [("stage", 1, (2, 1304)), ("insist", CONTROLWORD, 2)]


def test_a_preparation_that_failed_leaves_no_exchanges_for_the_quick_stop(drive: Drive) -> None:
    servo = enabled(drive)
    drive.state = State.SWITCH_ON_DISABLED

    def refuse(*_: object, **__: object) -> None:
        raise LinkError("gone")

    drive.map_process_data = refuse  # type: ignore[method-assign]
    with pytest.raises(LinkError):
        servo.prepare(CYCLE_S)
    drive.take()
    assert not servo.prepared
    servo.quick_stop(at_once=False)
    assert drive.take("stage") == []


@pytest.mark.parametrize("in_fault", [True, False])
def test_resetting_a_fault(drive: Drive, in_fault: bool) -> None:
    servo = prepared(drive)
    drive.take()
    drive.state = State.FAULT if in_fault else State.SWITCH_ON_DISABLED
    servo.reset_fault()
    edge = [("write", CONTROLWORD, 0x80), ("write", CONTROLWORD, 0)] if in_fault else []
    # Not every drive sends "error reset".
    ended = ("forget faults",)
    assert drive.take() == [("stage", 1, (0, 1234)), ("insist", CONTROLWORD, 0), *edge, ended]
    assert drive.state is State.SWITCH_ON_DISABLED


def test_a_reset_ends_in_no_other_state(drive: Drive) -> None:
    servo = prepared(drive)
    drive.state = State.FAULT
    drive.follows = False
    drive.clock.call_at(
        drive.clock.now_ns() + 500_000_000, lambda: setattr(drive, "state", State.READY)
    )
    with pytest.raises(StateError, match="reports the state 'ready to switch on'"):
        servo.reset_fault()


@pytest.mark.parametrize("side", [0, 1, -1])
def test_targets_and_offsets_that_fit_are_staged(side: int) -> None:
    counts, units = ((side * ((1 << bits) - (side > 0))) for bits in (31, 15))
    drive = Drive()
    servo = enabled(drive, UNITY, torque_offset=True)
    servo.set_torque_offset(units + 0.4)
    assert drive.take() == [("stage", 1, (0x0F, 1304, units))]
    servo.set_target(float(counts))
    assert drive.take() == [("stage", 1, (0x0F, counts, units))]


def test_without_power_no_offset_is_staged(drive: Drive) -> None:
    servo = prepared(drive, torque_offset=True)
    servo.set_torque_offset(9.0)
    assert drive.take()[-1] == ("stage", 1, (0, 1234, 0))
    servo.enable()
    servo.quick_stop()
    servo.set_torque_offset(9.0)
    assert drive.take()[-1] == ("stage", 1, (2, 1304, 0))


def test_a_sample_in_si_units(drive: Drive) -> None:
    scales = ServoScales(
        4096,
        100.0,
        15.0,
        0.45,
        sign=-1,
        offset_rad=0.25,
        velocity_unit_rad_s=0.5,
        voltage_object=(0x2100, 0),
        voltage_unit_V=0.02,
        temperature_object=(0x2101, 0),
        current_sign=-1,
    )
    servo = make(drive, scales)
    drive.inputs = {1: (0x1640, 2048, 40), 2: (30, 2_500_000), 3: (150,), 4: (59_900, 251, 60)}
    assert servo.sent_state() is None
    servo.prepare(CYCLE_S)
    assert servo.sent_state() is ServoState.SWITCH_ON_DISABLED
    drive.fresh = False
    assert servo.sent_state() is None
    sample = servo.sample()
    assert sample == ServoSample(
        device_time_s=2.5,
        motor_angle_rad=pytest.approx(-math.pi + 25.0),
        velocity_rad_s=pytest.approx(-0.15),
        current_A=pytest.approx(0.6),
        voltage_V=pytest.approx(-3.0),
        supply_voltage_V=pytest.approx(59.9),
        temperature_C=pytest.approx(25.1),
        following_error_rad=0.0,
        statusword=0x1640,
        fresh=False,
        motor_torque_N_m=pytest.approx(0.027),
    )


def at(servo: Cia402Servo, drive: Drive, status: int, position: int) -> float:
    """Return the following error in counts that a sample shows."""
    drive.inputs |= {1: (status, position, 0), 2: (0, 0), 3: (0,), 4: (0, 0)}
    return servo.sample().following_error_rad / SCALES.joint_rad_per_count


def test_the_following_error_is_against_the_target_that_the_drive_has_reached_for(drive):
    servo = enabled(drive)
    unit = SCALES.joint_rad_per_count
    servo.set_target(2000 * unit)
    # Staged, and not yet sent.
    assert at(servo, drive, 0x1627, 1300) == pytest.approx(4.0)
    drive.exchange()
    # Sent with this exchange: the drive starts for it at the next SYNC.
    assert at(servo, drive, 0x1627, 1300) == pytest.approx(4.0)
    servo.set_target(2100 * unit)
    assert at(servo, drive, 0x1627, 1900) == pytest.approx(100.0)
    # Staged twice before an exchange, the first is forgotten.
    servo.set_target(2200 * unit)
    assert at(servo, drive, 0x1627, 1900) == pytest.approx(100.0)
    drive.exchange()
    assert at(servo, drive, 0x1627, 1900) == pytest.approx(100.0)
    drive.exchange()
    # Nothing staged since: the last target stands.
    assert at(servo, drive, 0x1627, 1900) == pytest.approx(300.0)
    assert at(servo, drive, 0x1627, 2300) == pytest.approx(-100.0)


@pytest.mark.parametrize("status", [0x1607, 0x1623, 0x1667, 0x162F])
def test_out_of_operation_there_is_no_following_error(drive: Drive, status: int) -> None:
    servo = enabled(drive)
    assert at(servo, drive, status, 0) == 0.0
    assert at(servo, drive, 0xFF37, 0) == pytest.approx(1303.0)


@pytest.mark.parametrize("cycle", [0, 3])
def test_the_first_target_is_held_against_nothing(drive: Drive, cycle: int) -> None:
    servo = make(drive, torque_offset=True)
    drive.cycle = cycle
    assert at(servo, drive, 0x1627, 10) == pytest.approx(-10.0)
    servo.set_target(5 * SCALES.joint_rad_per_count)
    assert drive.take() == [("stage", 1, (0, 5, 0))]
    for later, error in ((0, -10.0), (1, -10.0), (2, -5.0)):
        drive.cycle = cycle + later
        assert at(servo, drive, 0x1627, 10) == pytest.approx(error)
