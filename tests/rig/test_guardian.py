"""The guardian of a drive without a watchdog: what it hears, what it does, what it writes. Real kills: tests/long."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.errors import LinkError
from drivers.interfaces import ServoState
from drivers.mock.line_faults import LineFaults
from drivers.mock.power_state import State
from drivers.units import ServoScales
from rig.guard import Guard
from rig.guardian import REPORT_FILE, Cause, Deed, Ward, report, stop, watch
from rig.teardown import SafeState

from ..drivers.serial_host import SerialHost, make_serial_host

ARMED = b'{"armed": true, "folder": "/somewhere"}\n'
RELEASED = b'{"armed": false}\n'


class Witness:
    """A guard that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.fed = 0

    def arm(self, limit_s: float) -> None:
        self.told.append("arm")

    def feed(self) -> None:
        if self.told[-1:] == ["arm"]:
            self.fed += 1

    def release(self) -> None:
        self.told.append("release")


class Absent(Witness):
    """A guard that cannot be had."""

    def arm(self, limit_s: float) -> None:
        raise LinkError("the guardian did not start")


@pytest.fixture
def host() -> Iterator[SerialHost]:
    made = make_serial_host()
    yield made
    made.link.close()


def heard(lines: list[bytes], ward: Ward, silent: bool = False) -> Cause:
    """Let the guardian hear these lines, and then the end of the input, or nothing any more."""
    reading, writing = os.pipe()
    for line in lines:
        os.write(writing, line)
    waits: list[float | None] = []

    def wait(descriptor: int, seconds: float | None) -> bool:
        waits.append(seconds)
        return len(waits) <= bool(lines) or not silent

    try:
        if not silent:
            os.close(writing)
        return watch(reading, ward, wait)
    finally:
        os.close(reading)
        if silent:
            os.close(writing)


@pytest.mark.parametrize(
    ("lines", "cause"),
    [
        ([], Cause.RELEASED),
        ([ARMED], Cause.GONE),
        ([ARMED, RELEASED], Cause.RELEASED),
        ([ARMED, RELEASED, ARMED], Cause.GONE),
        ([ARMED, b'{"armed": fal'], Cause.GONE),
        ([ARMED, b"\xff\xfe\n", b"[1]\n", b'{"other": 1}\n'], Cause.GONE),
        ([b'{"armed": true'], Cause.RELEASED),
        ([ARMED[:9], ARMED[9:]], Cause.GONE),
    ],
)
def test_it_acts_where_the_pipe_ends_with_the_drive_armed(lines: list[bytes], cause: Cause) -> None:
    assert heard(lines, Ward()) is cause


def test_it_acts_where_nobody_feeds_it_while_the_drive_is_armed() -> None:
    assert heard([ARMED], Ward(), silent=True) is Cause.SILENT


def test_it_waits_for_ever_while_the_drive_is_off_and_for_the_limit_while_it_is_armed() -> None:
    waits: list[float | None] = []
    reading, writing = os.pipe()
    lines = [b'{"armed": true, "limit_s": 0.3}\n', b"\n", RELEASED]

    def wait(descriptor: int, seconds: float | None) -> bool:
        waits.append(seconds)
        if lines:
            os.write(writing, lines.pop(0))
        elif len(waits) == 4:
            os.close(writing)
        return True

    assert watch(reading, Ward(), wait) is Cause.RELEASED
    os.close(reading)
    assert waits == [None, 0.3, 0.3, None]


def test_it_remembers_the_drive_and_the_folder() -> None:
    ward = Ward()
    heard([b'{"drive": {"name": "the drive"}}\n', ARMED, RELEASED], ward)
    assert ward.drive == {"name": "the drive"}
    assert ward.folder == Path("/somewhere")


def test_the_guard_stands_by_before_power_and_until_it_is_verified_off(host: SerialHost) -> None:
    host.epos.guard = witness = Witness()
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    assert witness.told == ["arm", "release"]
    armed_before_power: list[bool] = []
    host.bench.drive.entered.append(lambda state: armed_before_power.append(witness.told[-1] == "arm"))
    host.servo.enable()
    assert all(armed_before_power)
    fed = witness.fed
    host.cycles(10)
    assert witness.fed >= fed + 10
    host.servo.quick_stop()
    assert witness.told[-1] == "arm"
    host.servo.disable()
    assert witness.told[-1] == "release"


def test_without_its_guardian_a_drive_is_not_enabled(host: SerialHost) -> None:
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.epos.guard = Absent()
    with pytest.raises(LinkError, match="did not start"):
        host.servo.enable()
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED


def moving(host: SerialHost) -> SerialHost:
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.servo.enable()
    host.cycles(100, lambda time: 0.3 * time)
    return host


def test_it_brakes_and_verifies(host: SerialHost) -> None:
    moving(host)
    entered: list[State] = []
    host.bench.drive.entered.append(entered.append)
    deed = stop(host.servo, host.bench.clock)
    assert entered == [State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED]
    assert (deed.safe.verified, deed.attempts) == (True, 1)
    assert deed.seconds < 0.1
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED


def test_it_goes_on_trying_while_the_line_is_dead(host: SerialHost) -> None:
    LineFaults(moving(host).line, host.bench.clock).cut(8.0)
    deed = stop(host.servo, host.bench.clock)
    assert deed.safe.verified
    assert deed.attempts > 1
    assert 8.0 < deed.seconds < 16.0


def test_its_patience_ends_and_it_says_so(host: SerialHost, tmp_path: Path) -> None:
    LineFaults(moving(host).line, host.bench.clock).cut(None)
    deed = stop(host.servo, host.bench.clock, patience_s=5.0)
    assert not deed.safe.verified
    words = report(deed, Ward({"name": "the drive"}, tmp_path), Cause.GONE)
    assert "could NOT be verified" in words
    assert "it has no watch of its own and may go on HOLDING UNDER POWER" in words
    record = json.loads((tmp_path / REPORT_FILE).read_text())
    assert record["safe"]["verified"] is False
    assert record["message"] == words


def test_a_folder_that_is_gone_does_not_silence_it(tmp_path: Path) -> None:
    deed = Deed(SafeState(True, "switch on disabled"), 1, 0.05)
    words = report(deed, Ward({"name": "the drive"}, tmp_path / "gone"), Cause.GONE)
    assert "the program that drove the drive is gone; after 0.05 s the drive is de-energised" in words
    assert "guardian.json cannot be written: No such file" in words


def test_a_port_that_is_not_open_cannot_be_guarded(tmp_path: Path) -> None:
    guard = Guard("/dev/none", 1_000_000, 1, tmp_path / "drive.eds", ServoScales(4096, 100.0, 15.0, 0.45))
    with pytest.raises(LinkError, match="EPOS4 at /dev/none is not open"):
        guard.arm(0.2)
    guard.release()
    guard.close()
