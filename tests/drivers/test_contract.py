from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.canopen.sdo import Axis

from .contract import Rig, ServoContract
from .dbc_host import make_dbc_host
from .host import drive_eds, make_host
from .serial_host import in_memory, serial_over_pty, slcan_over_pty, socketcand_on_loopback


class TestCanBuses(ServoContract):
    @pytest.fixture(
        params=[
            (make_host, 1_000_000, 0.001, False),
            (make_host, 500_000, 0.002, True),
            (make_dbc_host, 1_000_000, 0.001, True),
            (make_dbc_host, 500_000, 0.002, False),
        ],
        ids=["CANopen", "CANopen, slow, python-can", "DBC, python-can", "DBC, slow"],
    )
    def rig(self, request: pytest.FixtureRequest) -> Rig:
        make, bitrate, cycle_s, python_can = request.param
        return make(bitrate=bitrate, cycle_s=cycle_s, python_can=python_can)


class TestOtherErrorControl(ServoContract):
    """Drives that monitor their master by life guarding, or not at all."""

    @pytest.fixture(
        params=[
            ((0x1016,), {}, True),
            ((0x1016, 0x1017), {}, False),
            ((0x1016, 0x100C, 0x100D), {}, False),
            ((), {(0x1029, 1): 0}, False),
            ((0x1016,), {(0x1029, 1): 2}, False),
        ],
        ids=[
            "life guarding through python-can",
            "no heartbeat at all",
            "no watchdog",
            "then PRE-OPERATIONAL",
            "life guarding, then STOPPED",
        ],
    )
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
        lacks, defaults, python_can = request.param
        return make_host(eds=drive_eds(tmp_path, lacks, defaults), python_can=python_can)


class TestAxes(ServoContract):
    """One axis of a drive with several axes in one node."""

    @pytest.fixture(
        params=[Axis(object_offset=0x1800), Axis(sub_index=2)], ids=["7800h", "second subindex"]
    )
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
        axis: Axis = request.param
        return make_host(eds=drive_eds(tmp_path, axis=axis), axis=axis)


class TestTransports(ServoContract):
    @pytest.fixture(params=[in_memory, serial_over_pty, slcan_over_pty, socketcand_on_loopback])
    def rig(self, request: pytest.FixtureRequest) -> Iterator[Rig]:
        with request.param() as rig:
            yield rig
