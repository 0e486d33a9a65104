"""The simulated drive: its frames against ``cantools``, its states against its table."""

import cantools.database
import numpy as np
import pytest

from drivers.clock import NS, SimulatedClock
from drivers.dbc.codec import crc8_j1850
from drivers.mock.dbc_drive import (
    COMMAND,
    COMMAND_LOST,
    DRIVE_DBC,
    POWERED,
    STOP,
    STOP_CODE,
    TRANSITIONS,
    DbcDrive,
    Order,
    State,
)
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import loops
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

DBC = cantools.database.load_file(DRIVE_DBC)


class Wire:
    """A drive on a bus, commanded through ``cantools``."""

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.bus = SimulatedBus(self.clock)
        self.machine = SimulatedMachine(Machine(), np.random.default_rng(0))
        self.drive = DbcDrive(self.bus, self.clock, Sampler(self.machine))
        self.drive.boot()
        self.life = 0
        self.seen: dict[str, dict] = {}

    def command(self, order: Order, target: float = 0.0, **changes: int) -> None:
        self.life = (self.life + 1) % 16
        signals = {
            "Order": int(order),
            "Life": self.life,
            "TargetPosition": target,
            "Check": 0,
            **changes,
        }
        data = DBC.encode_message(COMMAND, signals, strict=False)
        if "Check" not in changes:
            data = data[:7] + bytes([crc8_j1850(data)])
        self.bus.transmit(COMMAND, data)
        self.wait(0.001)

    def wait(self, seconds: float) -> None:
        deadline = self.clock.now_ns() + round(seconds * NS)
        while (left := deadline - self.clock.now_ns()) > 0:
            for frame in self.bus.collect(left / NS):
                message = DBC.get_message_by_frame_id(frame.identifier)
                self.seen[message.name] = message.decode(frame.data, decode_choices=False)

    def to(self, state: State) -> None:
        orders = {
            State.OFF: (),
            State.READY: (Order.READY,),
            State.RUN: (Order.READY, Order.RUN),
            State.STOPPING: (Order.READY, Order.RUN, Order.STOP),
            State.BRAKING: (Order.READY, Order.RUN),
            State.FAULT: (),
        }[state]
        for order in orders:
            self.command(order)
        if state in (State.BRAKING, State.FAULT):
            self.drive.fail(7)
        assert self.drive.state is state


@pytest.fixture
def wire():
    made = Wire()
    yield made
    made.bus.shutdown()


@pytest.mark.parametrize("order", Order)
@pytest.mark.parametrize("state", State)
def test_every_order_in_every_state(wire: Wire, state: State, order: Order) -> None:
    wire.to(state)
    wire.command(order)
    wanted = TRANSITIONS.get((state, order), state)
    assert wire.drive.state is wanted
    assert wire.seen["DRV_Motion"]["State"] == wanted
    assert bool(wire.machine._s[loops.MODE] != loops.OFF) is (wanted in POWERED)


@pytest.mark.parametrize(
    "changes", [{"Check": 0}, {"Life": 0}, {"Order": 9}], ids=["checksum", "counter", "order"]
)
def test_a_bad_command_is_not_obeyed_and_does_not_feed_the_watchdog(wire, changes):
    wire.to(State.RUN)
    wire.command(Order.RUN, Life=0)
    answered = wire.drive._told_ns
    for _ in range(8):
        wire.command(Order.OFF, **changes)
        assert wire.drive.state is State.RUN
    assert wire.drive._told_ns == answered
    for _ in range(180):
        wire.command(Order.OFF, **changes)
    assert wire.drive.state is State.FAULT
    assert wire.drive.fault_code == COMMAND_LOST


def test_without_a_command_it_brakes_and_switches_off(wire: Wire) -> None:
    wire.to(State.RUN)
    for n in range(100):
        wire.command(Order.RUN, 0.05 * n)
    wire.wait(0.097)
    assert wire.drive.state is State.RUN
    wire.wait(0.005)
    assert wire.drive.state is State.BRAKING
    wire.wait(0.06)
    assert wire.drive.state is State.FAULT
    assert wire.seen["DRV_Status"]["FaultCode"] == COMMAND_LOST
    assert wire.machine.truth().current_A == 0.0


def test_the_stop_frame_stops_and_its_code_matters(wire: Wire) -> None:
    wire.to(State.RUN)
    wire.bus.transmit(STOP, b"\0")
    wire.wait(0.001)
    assert wire.drive.state is State.RUN
    wire.bus.transmit(STOP, bytes([STOP_CODE]))
    wire.wait(0.001)
    assert wire.drive.state is State.STOPPING
    for _ in range(60):
        wire.command(Order.RUN)
    assert wire.drive.state is State.OFF


def test_a_reset_needs_its_edge(wire: Wire) -> None:
    wire.command(Order.RESET)
    wire.drive.fail(7)
    wire.command(Order.RESET)
    assert wire.drive.state is State.FAULT
    wire.command(Order.OFF)
    wire.command(Order.RESET)
    assert wire.drive.state is State.OFF
    assert wire.seen["DRV_Status"]["FaultCode"] == 0
