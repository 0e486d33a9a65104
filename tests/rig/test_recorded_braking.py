"""The recording contains the ramp of the drive also after another device was lost."""

import dataclasses
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from drivers.clock import NS
from drivers.errors import DriveFault, LinkError
from drivers.interfaces import RawFrame
from drivers.mock.bench import ENCODER_NODE
from drivers.mock.faults import WireFaults
from rig.common.sample import Sample
from rig.control.cycle import Cycle
from rig.terminal.stop_button import StopButton
from rig.wiring.devices import Devices
from tests.drivers.dbc_host import enabled as enabled_dbc
from tests.drivers.dbc_host import make_dbc_host
from tests.drivers.host import enabled, make_host
from tests.drivers.serial_host import make_serial_host
from tests.drivers.test_servo import LIMITS as DRIVE_LIMITS

from .drives import stopped_by_ramp
from .test_cycle import LIMITS

Make = Callable[[], tuple[Any, Callable[[Any], None]]]


def silent_encoder(host: Any) -> None:
    faults = WireFaults(host.bench.bus, host.bench.clock)
    faults.lose(lambda identifier, sent: not sent and identifier & 0x7F == ENCODER_NODE, 1 << 30)


def on_can() -> tuple[Any, Callable[[Any], None]]:
    host = make_host()
    host.servo.write_limits(dataclasses.replace(DRIVE_LIMITS, quick_stop_option=2))
    return enabled(host), silent_encoder


def with_own_frames() -> tuple[Any, Callable[[Any], None]]:
    host = make_dbc_host()
    enabled_dbc(host)
    return host, silent_encoder


def on_serial() -> tuple[Any, Callable[[Any], None]]:
    host = make_serial_host()
    host.servo.write_limits(dataclasses.replace(DRIVE_LIMITS, quick_stop_option=2))
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.servo.enable()

    def unplug(host: Any) -> None:
        def gone(_data: bytes) -> None:
            raise OSError(5, "gone")

        host.encoder_line.write = gone

    return host, unplug


class Recorder:
    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def sample(self, time_ns: int, sample: Sample, frames: list[RawFrame]) -> None:
        self.samples.append(sample)


def stopped(host: Any) -> list[Sample]:
    """Brake, and return the samples of the braking; the drive was verified off."""
    recorder, cycle_ns = Recorder(), round(host.cycle_s * NS)
    devices = Devices(host.link, host.servo, host.encoder, lambda mass: None)
    cycle = Cycle(LIMITS, cycle_ns, devices, recorder, StopButton(), lambda *_: None)
    watched = host.link.has_watchdog
    safe = stopped_by_ramp(
        host.servo, cycle.watch, host.link.clock, cycle_ns, watched=watched, insistent=not watched
    )
    host.link.close()
    assert safe.verified
    assert not safe.problems
    assert len(recorder.samples) == cycle.count > 10
    speeds = [abs(sample.velocity) for sample in recorder.samples]
    assert speeds[0] > 10 * speeds[-1]
    assert len({sample.motor_angle for sample in recorder.samples}) > 10
    return recorder.samples


@pytest.mark.parametrize("make", [on_can, with_own_frames, on_serial])
def test_after_the_encoder_is_lost_each_cycle_of_the_ramp_is_recorded(make: Make) -> None:
    host, lose = make()
    host.cycles(round(0.3 / host.cycle_s), lambda t: t * t)
    lose(host)
    with pytest.raises(LinkError):
        host.cycles(400, lambda t: 0.09 + 0.6 * t)
    assert not any(sample.fresh for sample in stopped(host))


@pytest.mark.parametrize(
    ("make", "code"), [(on_can, 0x2310), (with_own_frames, 0x23), (on_serial, 0x2310)]
)
def test_the_reaction_of_the_drive_to_a_fault_is_recorded_to_its_end(make: Make, code: int) -> None:
    host, _ = make()
    host.cycles(round(0.6 / host.cycle_s), lambda t: t * t)
    off_rad_s: list[float] = []
    machine = host.bench.machine
    switch = machine.power

    def power(on: bool) -> None:
        off_rad_s.append(machine.truth().velocity_rad_s)
        switch(on)

    machine.power = power
    host.bench.drive.fail(code)
    with suppress(DriveFault):
        host.cycles(1)
    # The first cycle follows at once, before a drive sends its next frames by its own clock.
    assert all(sample.fresh for sample in stopped(host)[1:])
    assert abs(off_rad_s[0]) < 0.05
