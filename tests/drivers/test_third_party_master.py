"""The simulated drives of each make, driven by the master of the library ``canopen``."""

import logging
from collections.abc import Iterator
from pathlib import Path

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from drivers.mock.bench import DRIVE_NODE, SimulatedBench, simulated_bench
from drivers.mock.canopen.node import Nmt
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.power_state import POWERED, State
from drivers.mock.traits import MAKES, described_drive

from .host import make_eds, read_eds

CYCLE_NS = 1_000_000


class Stepped(canopen.Network):
    """The library's network on the simulated bus: time passes with each frame it sends."""

    def __init__(self, bench: SimulatedBench) -> None:
        super().__init__()
        self._bench = bench

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert not remote
        bus, clock = self._bench.bus, self._bench.clock
        bus.transmit(can_id, bytes(data))
        clock.sleep_until_ns(clock.now_ns() + CYCLE_NS)
        for time_ns, identifier, found, _ in bus.collect(0.0):
            if identifier != can_id:
                self.notify(identifier, bytearray(found), time_ns / 1e9)


OFTEN = ("EPOS4", "Faulhaber", "Copley")


@pytest.fixture(
    params=[m if m in OFTEN else pytest.param(m, marks=pytest.mark.proof) for m in MAKES]
)
def pair(
    request: pytest.FixtureRequest, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> Iterator[tuple[BaseNode402, SimulatedBench]]:
    """The library's node, and the bench whose drive it is."""
    caplog.set_level(logging.ERROR, logger="canopen")
    eds = make_eds(tmp_path, request.param)
    bench = simulated_bench(Machine(), 1, traits=described_drive(read_eds(eds, DRIVE_NODE)))
    node = BaseNode402(DRIVE_NODE, str(eds))
    node.TIMEOUT_RESET_FAULT = 0.02
    Stepped(bench).add_node(node)
    node.nmt.state = "OPERATIONAL"
    assert bench.drive.state is Nmt.OPERATIONAL
    yield node, bench
    bench.bus.shutdown()


def positions(node: BaseNode402) -> bool:
    """Whether the drive takes positions in every cycle; the others take set-points."""
    return bool(node.is_op_mode_supported("CYCLIC SYNCHRONOUS POSITION"))


def enable(node: BaseNode402) -> None:
    mode = "CYCLIC SYNCHRONOUS POSITION" if positions(node) else "PROFILED POSITION"
    node.op_mode = mode
    assert node.op_mode == mode
    node.sdo[0x607A].raw = node.sdo[0x6064].raw
    node.state = "OPERATION ENABLED"


def move(node: BaseNode402, counts: int) -> None:
    """Move by counts, ten per SYNC or in one profile."""
    start = node.sdo[0x6064].raw
    if not positions(node):
        node.sdo[0x607A].raw = start + counts
        node.controlword = 0x3F
        assert node.statusword & 0x1000
        node.controlword = 0x0F
        for _ in range(counts // 10):
            node.network.sync.transmit()
        return
    for step in range(10, counts + 1, 10):
        node.sdo[0x607A].raw = start + step
        node.network.sync.transmit()


def test_it_enables_moves_and_disables(pair: tuple[BaseNode402, SimulatedBench]) -> None:
    node, bench = pair
    enable(node)
    assert bench.drive.power_state is State.OPERATION_ENABLED
    before = node.sdo[0x6064].raw
    move(node, 2000)
    assert node.sdo[0x6064].raw - before == pytest.approx(2000, abs=200)
    node.state = "SWITCH ON DISABLED"
    assert bench.drive.power_state not in POWERED


def test_its_quick_stop_brakes_and_takes_the_power_off(pair):
    node, bench = pair
    enable(node)
    move(node, 1000)
    node.controlword = 0x02
    for _ in range(200):
        node.network.sync.transmit()
    # Which option 605Ah holds is the make's; none goes on moving, and one of both states follows.
    assert node.state in ("SWITCH ON DISABLED", "QUICK STOP ACTIVE")
    assert abs(bench.machine.truth().velocity_rad_s) < 1e-3
    node.state = "SWITCH ON DISABLED"
    assert bench.drive.power_state not in POWERED


def test_it_resets_a_fault(pair: tuple[BaseNode402, SimulatedBench]) -> None:
    node, bench = pair
    enable(node)
    bench.drive.fail(0x7320)
    for _ in range(100):
        node.network.sync.transmit()
    assert node.state == "FAULT"
    assert bench.drive.power_state not in POWERED
    node.reset_from_fault()
    # The library enables again with it; this program's own reset never does.
    assert node.state == "OPERATION ENABLED"
    node.state = "SWITCH ON DISABLED"
    assert bench.drive.power_state not in POWERED
