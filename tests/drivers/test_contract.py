from __future__ import annotations

from pathlib import Path

import pytest

from drivers.canopen.sdo import Axis

from .contract import Rig, ServoContract
from .host import drive_eds, make_host


class TestSimulatedCanopen(ServoContract):
    @pytest.fixture(
        params=[(1_000_000, 0.001, False), (500_000, 0.002, False), (1_000_000, 0.001, True)],
        ids=["1 Mbit/s", "500 kbit/s", "through python-can"],
    )
    def rig(self, request: pytest.FixtureRequest) -> Rig:
        bitrate, cycle_s, python_can = request.param
        host = make_host(bitrate=bitrate, cycle_s=cycle_s, python_can=python_can)
        return host


class TestOtherErrorControl(ServoContract):
    """Drives that monitor their master by life guarding, or not at all, and drives that leave the
    NMT state OPERATIONAL when they lose their master.
    """

    @pytest.fixture(
        params=[
            ((0x1016,), {}, False),
            ((0x1016,), {}, True),
            ((0x1016, 0x1017), {}, False),
            ((0x1016, 0x100C, 0x100D), {}, False),
            ((), {(0x1029, 1): 0}, False),
            ((0x1029,), {}, False),
            ((), {(0x1029, 1): 2}, False),
            ((0x1016,), {(0x1029, 1): 2}, False),
        ],
        ids=[
            "life guarding",
            "life guarding through python-can",
            "no heartbeat at all",
            "no watchdog",
            "then PRE-OPERATIONAL",
            "no 1029h",
            "then STOPPED",
            "life guarding, then STOPPED",
        ],
    )
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
        lacks, defaults, python_can = request.param
        eds = drive_eds(tmp_path, lacks, defaults)
        host = make_host(eds=eds, python_can=python_can)
        return host


class TestAxes(ServoContract):
    """One axis of a drive with several axes in one node."""

    @pytest.fixture(
        params=[Axis(object_offset=0x800), Axis(object_offset=0x1800), Axis(sub_index=1),
                Axis(sub_index=2)],
        ids=["6800h", "7800h", "first subindex", "second subindex"],
    )  # fmt: skip
    def rig(self, request: pytest.FixtureRequest, tmp_path: Path) -> Rig:
        axis: Axis = request.param
        host = make_host(eds=drive_eds(tmp_path, axis=axis), axis=axis)
        return host
