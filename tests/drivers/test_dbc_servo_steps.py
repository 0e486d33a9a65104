"""The DBC servo against a link that notes everything: which order goes out when, and what is waited
for how long.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import NS, SimulatedClock
from drivers.dbc.limits import DbcDrive
from drivers.dbc.servo import DbcServo
from drivers.errors import ConfigurationError, DriveFault, LinkError, StateError
from drivers.interfaces import Identity, ServoLimits, ServoSample, ServoState

from .servo_steps import Case, StepsContract

S = ServoState
OFF, STOP, RESET, READY, RUN = (
    {"Command": word} for word in (b"off", b"stop", b"reset", b"ready", b"run")
)
OBEY = {
    b"off": S.SWITCH_ON_DISABLED,
    b"stop": S.QUICK_STOP_ACTIVE,
    b"ready": S.READY,
    b"run": S.OPERATION_ENABLED,
}
STOP_FRAME = (0x010, b"\xa5")
HELD = ServoLimits(-0.5, 0.5, 2.0, 60.0, 20.0, 0.02, 2, 35.0)
DRIVE = DbcDrive(Identity("house servo", 1, 2, 3, 4), HELD, 100.0, 0.03, 0.25, 0.1)
FRAME_NS = 10_000_000
"""Time until a status frame comes."""
CYCLE_S = 0.004
CYCLE_NS = 4_000_000


class Slot:
    """The last good frame of a message; its values are those of the bench."""

    def __init__(self, name: str, identifier: int, period_s: float, data: dict[str, float]) -> None:
        self.message = SimpleNamespace(
            name=name, identifier=identifier, period_s=period_s, remote=False
        )
        self.data = data
        self.count = self.refused = 0
        self.time_ns = 77_000_000


class Wired(SimpleNamespace):
    """A map in which every limit is reported."""

    @property
    def reported(self) -> dict[str, Any]:
        return {name: limit.held for name, limit in self.limits.items()}


class Bench:
    """Channel, link and drive in one.

    Attributes:
        log: What was ordered, commanded, sent, aimed at, awaited, pumped and exchanged, with the
            time of each exchange.
        follows: Whether orders change the drive's state.
        loses: Exchange, counted from 1, to what happens in it.
        silent: Messages that do not come.
    """

    label = "house servo"

    def __init__(self, **signals: Any) -> None:
        self.clock = SimulatedClock(5 * NS)
        self.has_watchdog = True
        self.log: list[tuple[Any, ...]] = []
        self.follows = True
        self.fresh = True
        self.cycle = 0
        self.state: ServoState | None = S.SWITCH_ON_DISABLED
        self.image: bytes = b""
        self.holding = self.stopping = False
        self.loses: dict[int, Callable[[], None]] = {}
        self.silent: set[str] = set()
        self.refused = 0
        self.fails: Exception | None = None
        self.values = {
            "position": 25.0,
            "velocity": 50.0,
            "current": 1.5,
            "supply_voltage": 60.0,
            "temperature": 30.0,
        }
        self.values |= {"status": 9.0}
        self.slots = {
            "Status": Slot("Status", 0x190, 0.001, self.values),
            "Motion": Slot("Motion", 0x191, 0.2, self.values),
        }
        inputs = {name: self.quantity(name) for name in self.values if name != "status"} | signals
        self.wiring = Wired(
            received=self.slots,
            sent={"Command": SimpleNamespace(period_s=0.02)},
            inputs=inputs,
            limits={},
            settings={},
            status_message="Status",
            status=SimpleNamespace(raw=lambda data: data["status"]),
            target=SimpleNamespace(message="Command", bits=self._bits),
            disable=OFF,
            stop=STOP,
            reset=RESET,
            enable={S.SWITCH_ON_DISABLED: READY, S.READY: RUN, S.OPERATION_ENABLED: RUN},
            pages={},
            asked=False,
            torque_offset=None,
        )

    @staticmethod
    def quantity(name: str, message: str = "Motion", **signal: Any) -> Any:
        return SimpleNamespace(
            message=message,
            signal=SimpleNamespace(
                **({"real": False, "width": 8, "raw": lambda data: data[name]} | signal)
            ),
            read=lambda data: data[name],
            gain=0.5,
            bias=3.0,
            wraps_after=None,
        )

    @staticmethod
    def _bits(motor_rad: float) -> int:
        if abs(motor_rad) > 100.0:
            raise ValueError("Target is outside")
        return round(motor_rad * 10)

    def slot(self, name: str) -> Slot:
        return self.slots[name]

    def set_cycle(self, cycle_s: float, label: str = "channel") -> None:
        self.log.append(("cycle", cycle_s, label))

    def order(self, images: dict[str, bytes], *, hold: bool = False) -> None:
        self.image = images["Command"]
        self.log.append(("order", self.image, hold))

    def aim(self, bits: int) -> None:
        self.log.append(("aim", bits))

    def pin(self, limits: dict[str, float]) -> None:
        self.log.append(("pin", dict(limits)))

    def settings(self, images: Any) -> list[tuple[int, bytes]]:
        return [(0x120, b"limits")]

    def limits(self) -> dict[str, float]:
        return {name: self.values[name] for name in self.wiring.limits}

    def fault(self) -> DriveFault:
        return DriveFault(7, "the fault")

    def _obey(self) -> None:
        if self.fails is not None:
            raise self.fails
        if self.follows:
            if self.state is S.FAULT:
                self.state = S.SWITCH_ON_DISABLED if self.image == b"reset" else self.state
            elif self.image in OBEY:
                self.state = OBEY[self.image]

    def command(self, channel: object) -> None:
        assert channel is self
        self.log.append(("command", self.image))
        self._obey()

    def send(self, identifier: int, data: bytes) -> None:
        self.log.append(("send", identifier, data))

    def stop(self, channel: object) -> None:
        assert channel is self
        self.send(*STOP_FRAME)

    def request(self, slot: Slot) -> None:
        assert not slot.message.remote

    def exchange(self) -> None:
        self.cycle += 1
        self.log.append(("exchange", self.clock.now_ns()))
        self.loses.pop(self.cycle, lambda: None)()
        self._obey()

    def await_frame(self, channel: object, slot: Slot, timeout_s: float) -> bool:
        assert channel is self
        self.log.append(("await", slot.message.name, timeout_s))
        count = slot.count
        return self._hear(lambda: slot.count != count, timeout_s)

    def pump(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        assert not ready()
        self.log.append(("pump", timeout_s))
        return self._hear(ready, timeout_s)

    def _hear(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        began = self.clock.now_ns()
        for name, slot in self.slots.items():
            slot.refused += self.refused if name in self.silent else 0
            slot.count += name not in self.silent
        self.clock.sleep_until_ns(began + (FRAME_NS if ready() else round(timeout_s * NS)))
        return ready()

    def take(self, *kinds: str) -> list[tuple[Any, ...]]:
        """Return what was logged since the last call, of some kinds or all."""
        log, self.log = self.log, []
        return [entry for entry in log if not kinds or entry[0] in kinds]


def make(bench: Bench, drive: DbcDrive = DRIVE, **options: Any) -> DbcServo:
    whole: Any = bench
    return DbcServo(whole, whole, drive, **options)


def prepared(bench: Bench, **options: Any) -> DbcServo:
    bench.slots["Status"].count = 1
    servo = make(bench, **options)
    servo.prepare(CYCLE_S)
    return servo


def enabled(bench: Bench, **options: Any) -> DbcServo:
    servo = prepared(bench, **options)
    servo.enable()
    bench.take()
    return servo


def replaced(drive: DbcDrive = DRIVE, **changes: Any) -> DbcDrive:
    return DbcDrive(**(drive.__dict__ | changes))


class TestSteps(StepsContract):
    @pytest.fixture
    def case(self) -> Case:
        bench = Bench()

        def servo(prepare: bool = True, **options: Any) -> DbcServo:
            return prepared(bench, **options) if prepare else make(bench, **options)

        return Case(
            bench,
            servo,
            lambda state: setattr(bench, "state", state),
            lambda: bench.take("order", "command", "send", "aim", "exchange"),
            lambda entry: entry == ("command", b"off"),
            lambda: setattr(bench, "fails", LinkError("gone")),
        )


@pytest.mark.parametrize(
    ("link", "watchdog_s", "watched"), [(True, 0.1, True), (True, None, False), (False, 0.1, False)]
)
def test_a_link_is_watched_where_every_drive_on_it_watches(
    link: bool, watchdog_s: float | None, watched: bool
) -> None:
    bench = Bench()
    bench.has_watchdog = link
    make(bench, replaced(watchdog_s=watchdog_s))
    assert bench.has_watchdog is watched


def test_preparing() -> None:
    bench = Bench()
    servo = make(bench)
    servo.prepare(CYCLE_S)
    assert bench.take() == [
        ("await", "Status", 0.3),
        ("cycle", CYCLE_S, "house servo"),
        ("cycle", CYCLE_S, "channel"),
        ("order", b"off", False),
        *[("command", b"off"), ("pump", 0.02)] * 2,
        ("aim", 250),
    ]


def test_a_message_that_does_not_come_is_asked_for_again_and_again() -> None:
    bench = Bench()
    bench.silent = {"Motion"}
    bench.slots["Motion"].refused = 5
    began = bench.clock.now_ns()
    with pytest.raises(LinkError) as caught:
        make(bench).prepare(CYCLE_S)
    assert str(caught.value) == (
        "house servo sent no valid Motion (191h) in 0.5 s: check the supply and the "
        "bus of the drive"
    )
    assert bench.take("command", "pump")[-4:] == [("command", b"off"), ("pump", 0.02)] * 2
    # Two frames of the status, and two and a half periods of the other.
    assert bench.clock.now_ns() - began == 2 * FRAME_NS + NS // 2


def test_a_message_that_comes_damaged_is_told_apart() -> None:
    bench = Bench()
    bench.silent = {"Motion"}
    bench.refused = 2
    bench.slots["Motion"].refused = 5
    with pytest.raises(LinkError) as caught:
        make(bench).prepare(CYCLE_S)
    # 25 waits, two frames in each; those before do not count.
    assert str(caught.value) == (
        "house servo sent no valid Motion (191h) in 0.5 s: 50 had a wrong length, checksum or "
        "counter: check these in the map"
    )


def test_a_status_that_does_not_come_or_comes_damaged() -> None:
    bench = Bench()
    bench.silent = {"Status"}
    servo = make(bench)
    with pytest.raises(LinkError) as caught:
        servo.state()
    assert str(caught.value) == (
        "house servo sent no valid Status (190h) in 0.3 s: check the supply and the "
        "bus of the drive"
    )
    bench.slots["Status"].refused = 5
    bench.refused = 1
    with pytest.raises(LinkError, match=r"in 0\.3 s: 1 had a wrong length"):
        servo.state()


def test_a_status_that_the_map_does_not_name() -> None:
    bench = Bench()
    bench.state = None
    with pytest.raises(StateError) as caught:
        make(bench).state()
    assert str(caught.value) == (
        "house servo reports the status 9, which the map does not contain: add this value under "
        "servo.status.states"
    )


@pytest.mark.parametrize(
    ("cycle_s", "watchdog_s", "slowest"),
    [(0.004, 0.03, "20"), (0.032, 0.063, "32"), (0.004, 0.0399, "20")],
)
def test_commands_that_are_too_rare_for_the_watchdog_are_refused(
    cycle_s: float, watchdog_s: float, slowest: str
) -> None:
    bench = Bench()
    with pytest.raises(ConfigurationError) as caught:
        make(bench, replaced(watchdog_s=watchdog_s)).prepare(cycle_s)
    assert str(caught.value) == (
        f"a command is sent every {slowest} ms, but the drive stops after {watchdog_s * 1e3:g} ms "
        "without a command; the time between two commands must be at most half of this time: "
        "raise cycle_Hz"
    )
    assert bench.take() == [("await", "Status", 0.3)]


@pytest.mark.parametrize(("cycle_s", "watchdog_s"), [(0.004, 0.04), (0.032, 0.064), (60.0, None)])
def test_commands_that_are_frequent_enough(cycle_s: float, watchdog_s: float | None) -> None:
    make(Bench(), replaced(watchdog_s=watchdog_s)).prepare(cycle_s)


def test_enabling_step_by_step() -> None:
    bench = Bench()
    servo = prepared(bench)
    servo.set_target(0.5)
    bench.take()
    began = bench.clock.now_ns()
    servo.enable()
    at = began + FRAME_NS
    log = bench.take()
    # Off again in the first cycle, then one order a cycle, each with the present position.
    assert log == [
        ("await", "Status", 0.3),
        ("order", b"off", False),
        ("exchange", at + CYCLE_NS),
        ("order", b"ready", False),
        ("aim", 250),
        ("exchange", at + 2 * CYCLE_NS),
        ("order", b"run", False),
        ("aim", 250),
        ("exchange", at + 3 * CYCLE_NS),
        ("order", b"run", True),
    ]
    assert all(type(entry[1]) is int for entry in log if entry[0] == "exchange")


def test_an_answer_that_is_missing_or_says_nothing_moves_nothing_on() -> None:
    bench = Bench()
    servo = prepared(bench)
    bench.take()
    for exchange, fresh in ((1, False), (3, True), (5, False), (6, True), (7, False), (9, True)):
        bench.loses[exchange] = lambda fresh=fresh: setattr(bench, "fresh", fresh)  # type: ignore[misc]
    bench.loses[3] = lambda: [setattr(bench, "fresh", True), setattr(bench, "state", None)][0]
    bench.follows = False

    def follow() -> None:
        bench.follows = True
        bench.state = S.SWITCH_ON_DISABLED

    bench.loses[4] = follow
    servo.enable()
    log = bench.take("order", "exchange")
    orders = {}
    exchanges = 0
    for entry in log:
        exchanges += entry[0] == "exchange"
        if entry[0] == "order":
            orders[exchanges] = entry[1:]
    assert orders == {
        0: (b"off", False),
        4: (b"ready", False),
        6: (b"run", False),
        9: (b"run", True),
    }


def test_disabling() -> None:
    bench = Bench()
    servo = enabled(bench)
    servo.disable()
    assert bench.take() == [
        ("order", b"off", False),
        ("command", b"off"),
        ("send", *STOP_FRAME),
        ("await", "Status", 0.3),
    ]


@pytest.mark.parametrize("at_once", [True, False])
def test_stopping(at_once: bool) -> None:
    bench = Bench()
    servo = enabled(bench)
    servo.quick_stop(at_once=at_once)
    assert bench.take() == [
        ("order", b"stop", False),
        ("send", *STOP_FRAME),
        ("order", b"stop", False),
        ("command", b"stop"),
    ]


def test_the_order_to_stop_stays_where_the_bus_does_not_take_it() -> None:
    bench = Bench()
    servo = enabled(bench)

    def send(identifier: int, data: bytes) -> None:
        raise LinkError("gone")

    bench.send = send  # type: ignore[method-assign]
    for at_once in (True, False):
        with pytest.raises(LinkError):
            servo.quick_stop(at_once=at_once)
    assert servo.prepared  # the exchanges repeat the order
    assert bench.image == b"stop"


def test_resetting_a_fault() -> None:
    bench = Bench()
    servo = prepared(bench)
    bench.take()
    bench.state = S.FAULT
    servo.reset_fault()
    assert bench.take("command", "await") == [
        ("await", "Status", 0.3),
        *(("command", b"off"), ("command", b"reset"), ("command", b"off")),
        ("await", "Status", 0.3),
    ]
    servo.reset_fault()
    assert bench.take("command") == [("command", b"off")]


def test_a_sample_in_si_units() -> None:
    bench = Bench()
    bench.state = S.READY
    bench.fresh = False
    sample = make(bench).sample()
    assert math.isnan(sample.voltage_V)
    assert sample._replace(voltage_V=0.0) == ServoSample(
        device_time_s=pytest.approx(0.077),
        motor_angle_rad=pytest.approx(50.0),
        velocity_rad_s=pytest.approx(0.5),
        current_A=1.5,
        voltage_V=0.0,
        supply_voltage_V=60.0,
        temperature_C=30.0,
        following_error_rad=0.0,
        statusword=0x21,
        fresh=False,
    )


@pytest.mark.parametrize(
    ("state", "word"), [(None, 0x00), (S.FAULT, 0x08), (S.OPERATION_ENABLED, 0x27)]
)
def test_the_statusword_is_that_of_a_cia_402_drive(state: ServoState | None, word: int) -> None:
    bench = Bench()
    bench.state = state
    assert make(bench).sample().statusword == word


def test_a_torque_becomes_a_current() -> None:
    bench = Bench(torque=Bench.quantity("torque"), voltage=Bench.quantity("voltage"))
    bench.values |= {"torque": 0.06, "voltage": 4.0}
    assert make(bench).sample().current_A == 1.5
    del bench.wiring.inputs["current"]
    sample = make(bench).sample()
    assert sample.current_A == pytest.approx(2.0)
    assert sample.voltage_V == 4.0


@pytest.mark.parametrize(
    ("real", "raws", "times"),
    [
        (False, [250.0, 255.0, 2.0, 130.0], [128.0, 130.5, 132.0, 196.0]),
        (True, [250.0, 255.0, 2.0], [128.0, 130.5, 4.0]),
    ],
)
def test_the_drives_own_clock_is_followed_over_its_range(
    real: bool, raws: list[float], times: list[float]
) -> None:
    bench = Bench(time=Bench.quantity("time", real=real))
    for servo in (make(bench), prepared(bench)) if not real else (make(bench),):
        found = []
        for raw in raws:
            bench.values["time"] = raw
            found.append(servo.sample().device_time_s)
        assert found == times


def test_prepared_again_the_drives_clock_starts_afresh() -> None:
    bench = Bench(time=Bench.quantity("time"))
    bench.values["time"] = 255.0
    servo = prepared(bench)
    servo.sample()
    bench.values["time"] = 1.0
    assert servo.sample().device_time_s == 131.5
    servo.prepare(CYCLE_S)
    assert servo.sample().device_time_s == 3.5
    # Whole ticks, also where the signal is read as a float.
    bench.values["time"] = 2.75
    assert servo.sample().device_time_s == 4.0


def following(servo: DbcServo) -> float:
    """Return the following error at the motor, rad."""
    return servo.sample().following_error_rad * 100.0


@pytest.mark.parametrize("cycle", [0, 3])
def test_the_following_error_is_against_the_target_that_the_drive_has_reached_for(
    cycle: int,
) -> None:
    bench = Bench()
    servo = make(bench)
    bench.state = S.OPERATION_ENABLED
    bench.follows = False
    bench.cycle = cycle
    # Nothing staged yet, nothing asked for.
    assert following(servo) == pytest.approx(-25.0)
    servo.set_target(0.75)
    assert following(servo) == pytest.approx(-25.0)
    bench.exchange()
    assert following(servo) == pytest.approx(-25.0)
    servo.set_target(0.85)
    assert following(servo) == pytest.approx(25.0)
    # Staged twice before an exchange, the first is forgotten.
    servo.set_target(0.95)
    assert following(servo) == pytest.approx(25.0)
    bench.exchange()
    assert following(servo) == pytest.approx(25.0)
    bench.exchange()
    assert following(servo) == pytest.approx(45.0)
    bench.state = S.QUICK_STOP_ACTIVE
    assert following(servo) == 0.0
