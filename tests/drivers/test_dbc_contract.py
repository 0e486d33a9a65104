from __future__ import annotations

import pytest

from .contract import Rig, ServoContract
from .dbc_host import make_dbc_host


class TestDbcServo(ServoContract):
    @pytest.fixture(
        params=[(1_000_000, 0.001, False), (500_000, 0.002, False), (1_000_000, 0.001, True)],
        ids=["1 Mbit/s", "500 kbit/s", "through python-can"],
    )
    def rig(self, request: pytest.FixtureRequest) -> Rig:
        bitrate, cycle_s, python_can = request.param
        host = make_dbc_host(bitrate=bitrate, cycle_s=cycle_s, python_can=python_can)
        return host
