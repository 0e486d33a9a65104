from __future__ import annotations

import math

import pytest

from drivers.canopen.sensors import Cia406Encoder
from drivers.errors import ConfigurationError
from drivers.units import EncoderScales

from .host import Host, enabled, prepared

TURN = 262144


@pytest.fixture
def node(host: Host):
    return host.encoder._channel


def test_follows_the_joint_below_zero(host: Host) -> None:
    enabled(host)
    host.cycles(400, lambda t: -0.05 * math.sin(math.pi / 0.8 * t))
    sample = host.encoder.sample()
    assert sample.fresh
    assert sample.angle_rad == pytest.approx(-0.05, abs=2e-3)


def test_coarser_units_per_turn(host: Host, node) -> None:
    node.write(0x6001, 0, 3600)
    encoder = Cia406Encoder(node, EncoderScales(3600, sign=-1, offset_rad=0.5))
    host.servo.prepare(host.cycle_s)
    encoder.prepare(host.cycle_s)
    host.servo.enable()
    host.cycles(400, lambda t: 0.05 * math.sin(math.pi / 0.8 * t))
    assert encoder.sample().angle_rad == pytest.approx(0.45, abs=3e-3)


def test_resolution_must_be_that_of_the_bench_file(host: Host, node) -> None:
    with pytest.raises(
        ConfigurationError, match="262144 counts per turn, but the bench file states 8192"
    ):
        Cia406Encoder(node, EncoderScales(8192)).prepare(host.cycle_s)


def test_an_alarm_stops_preparation(host: Host) -> None:
    host.bench.encoder.objects.values[0x6503 << 8] = 1
    with pytest.raises(ConfigurationError, match="alarms 0001h"):
        prepared(host)
