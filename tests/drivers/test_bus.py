import can
import pytest

from drivers.can.port import MAX_COLLECTED, PythonCanPort
from drivers.clock import SimulatedClock
from drivers.mock.wires.bus import SimulatedBus

from .host import frame


@pytest.fixture
def bus():
    made = SimulatedBus(SimulatedClock())
    yield made
    made.shutdown()


@pytest.mark.parametrize("bitrate", [125_000, 500_000, 1_000_000])
def test_a_frame_takes_its_time_on_the_wire(bitrate: int) -> None:
    clock = SimulatedClock()
    bus = SimulatedBus(clock, bitrate)
    heard: list[int] = []
    bus.attach().listen(0x123, lambda _data: heard.append(clock.now_ns()))
    bus.send(frame(0x123, bytes(8)))
    assert bus.recv(1.0) is None
    assert heard == [135 * 1_000_000_000 // bitrate]
    bus.shutdown()


def test_answers_to_one_frame_compete_in_one_arbitration(bus: SimulatedBus) -> None:
    for identifier in (0x182, 0x181):
        port = bus.attach()
        port.listen(
            0x80, lambda _data, port=port, identifier=identifier: port.send(identifier, b"")
        )
    bus.send(frame(0x80))
    assert [bus.recv(1.0).arbitration_id for _ in range(2)] == [0x181, 0x182]


def test_collecting_stops_at_its_time_out_in_the_middle_of_a_burst() -> None:
    clock = SimulatedClock()
    bus = SimulatedBus(clock)
    port = bus.attach()
    for identifier in (1, 2, 3):
        port.send(identifier, bytes(8))
    assert [frame.identifier for frame in bus.collect(300e-6)] == [1, 2]
    assert clock.now_ns() == 270_000
    assert [frame.identifier for frame in bus.collect(300e-6)] == [3]
    assert list(bus.collect(300e-6)) == []
    assert clock.now_ns() == 705_000
    bus.shutdown()


def test_what_falls_due_in_a_burst_happens_at_its_time() -> None:
    """A frame that an event between two frames sends takes part in arbitration."""
    clock = SimulatedClock()
    bus = SimulatedBus(clock)
    first, second = bus.attach(), bus.attach()
    for identifier in (0x10, 0x20, 0x30):
        first.send(identifier, b"")
    clock.call_at(60_000, lambda: second.send(0x18, b""))
    assert [frame.identifier for frame in bus.collect(1.0)] == [0x10]
    assert [frame.identifier for frame in bus.collect(1.0)] == [0x20, 0x18, 0x30]
    bus.shutdown()


def test_a_port_hands_over_all_that_has_come_in(bus: SimulatedBus) -> None:
    """What is left over would be taken for the answer to the next cycle."""
    port = bus.attach()
    for identifier in (1, 2, 3):
        port.send(identifier, b"")
    assert [frame.identifier for frame in PythonCanPort(bus, SimulatedClock()).collect(1.0)] == [
        1,
        2,
        3,
    ]


def test_a_flooded_bus_does_not_hold_the_loop() -> None:
    class Babbler:
        def recv(self, timeout: float | None = None) -> can.Message:
            return frame(0x7)

    port = PythonCanPort(Babbler(), SimulatedClock())  # type: ignore[arg-type]
    assert len(port.collect(0.1)) == MAX_COLLECTED
