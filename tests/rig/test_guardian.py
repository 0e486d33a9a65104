"""The guardian of a drive without a watchdog: what it hears, what it does, what it writes."""

import dataclasses
import json
import os
import signal
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import rig.wiring.guardian as guardian
from drivers.clock import NS, SimulatedClock
from drivers.errors import ConfigurationError, DeviceError, LinkError
from drivers.interfaces import ServoState
from drivers.mock.faults import LineFaults
from drivers.mock.power_state import State
from drivers.units import ServoScales
from rig.wiring.guardian import REPORT_FILE, Cause, Deed, Ward, report, stop, watch
from rig.wiring.teardown import SafeState

from ..drivers.serial_host import SerialHost, make_serial_host
from .drives import FakeDrive

ARMED = b'{"armed": true, "folder": "/somewhere"}\n'
RELEASED = b'{"armed": false}\n'


class Witness:
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
        ([ARMED, b'{"left": true}\n'], Cause.LEFT),
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


def test_it_remembers_the_drive_the_folder_and_the_limit() -> None:
    ward = Ward()
    heard([b'{"drive": {"name": "the drive"}}\n', ARMED, b'{"limit_s": "0.5", "armed": 1}\n'], ward)
    assert ward.drive == {"name": "the drive"}
    assert ward.folder == Path("/somewhere")
    assert ward.limit_s == 0.5
    assert ward.armed is True
    heard([RELEASED], ward)
    assert (ward.drive, ward.folder, ward.limit_s) == (
        {"name": "the drive"},
        Path("/somewhere"),
        0.5,
    )
    assert ward.armed is False


def test_the_guard_stands_by_before_power_and_until_it_is_verified_off(host: SerialHost) -> None:
    host.epos.guard = witness = Witness()
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    assert witness.told == ["arm", "release"]
    armed_before_power: list[bool] = []
    host.bench.drive.entered.append(
        lambda state: armed_before_power.append(witness.told[-1] == "arm")
    )
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
    assert deed.seconds < 0.2
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED


def test_it_goes_on_trying_while_the_line_is_dead(host: SerialHost) -> None:
    LineFaults(moving(host).line, host.bench.clock).cut(8.0)
    deed = stop(host.servo, host.bench.clock)
    assert deed.safe.verified
    assert deed.attempts > 1
    assert 8.0 < deed.seconds < 16.0


class Stuck(FakeDrive):
    """A drive that brakes for ever, or that cannot be reached; notes when it is told what, s."""

    def __init__(self, reachable: bool = True) -> None:
        self.clock = SimulatedClock()
        self.reachable = reachable
        self.told: list[tuple[str, float]] = []

    def do(self, verb: str) -> None:
        if verb == "glance":
            self.clock.sleep_until_ns(self.clock.now_ns() + NS // 1000)
            return
        self.told.append((verb, self.clock.now_ns() / NS))
        if not self.reachable:
            raise LinkError("gone")
        self.power = (
            ServoState.SWITCH_ON_DISABLED
            if ("disable", 1.0) in self.told
            else ServoState.QUICK_STOP_ACTIVE
        )


def test_a_drive_that_brakes_for_ever_is_waited_for_a_second() -> None:
    servo: Any = Stuck()
    failures: list[Deed] = []
    deed = stop(servo, servo.clock, failed=failures.append)
    assert [told for told in servo.told if told[0] != "state"] == [
        ("quick_stop", 0.0),
        ("disable", 1.0),
    ]
    assert (deed.safe.verified, deed.attempts) == (True, 1)
    assert 1.0 <= deed.seconds < 1.1
    assert not failures


def test_it_tries_five_times_a_second_as_long_as_it_takes() -> None:
    servo: Any = Stuck(reachable=False)
    failures: list[Deed] = []

    def failed(deed: Deed) -> None:
        failures.append(deed)
        if deed.seconds > 1000.0:
            servo.reachable = True
            servo.told.append(("disable", 1.0))

    deed = stop(servo, servo.clock, failed=failed)
    tries = [seconds for verb, seconds in servo.told if verb == "quick_stop"]
    assert tries[:3] == [0.0, 0.201, 0.402]
    assert (deed.safe.verified, deed.safe.watched) == (True, False)
    assert deed.attempts == len(failures) + 1 == len(tries) > 4900
    assert {failure.safe.state for failure in failures} == {"unknown"}


@pytest.mark.parametrize("kind", [LinkError, ConfigurationError])
def test_a_link_that_cannot_be_opened_is_opened_again_and_again(kind: type[DeviceError]) -> None:
    servo: Any = Stuck()
    failures = [kind("no such port")] * 3

    def reach() -> None:
        if failures:
            raise failures.pop()

    servo.told.append(("disable", 1.0))
    told: list[Deed] = []
    deed = stop(servo, servo.clock, reach, failed=told.append)
    assert (deed.safe.verified, deed.attempts) == (True, 4)
    assert [failure.safe.problems for failure in told] == [("no such port",)] * 3


def test_its_patience_ends_and_it_says_so(host: SerialHost, tmp_path: Path) -> None:
    LineFaults(moving(host).line, host.bench.clock).cut(None)
    deed = stop(host.servo, host.bench.clock, patience_s=5.0)
    assert not deed.safe.verified
    words = report(deed, Ward({"name": "the drive"}, tmp_path), Cause.GONE)
    assert "could NOT be verified" in words
    assert "it has no watchdog and may go on HOLDING UNDER POWER" in words
    assert json.loads((tmp_path / REPORT_FILE).read_text())["safe"]["verified"] is False


def test_a_drive_that_says_off_is_tried_until_no_current_flows(tmp_path: Path) -> None:
    servo: Any = FakeDrive()
    servo.current, clock = 3.98, SimulatedClock()
    deed = stop(servo, clock, patience_s=2.0)
    assert (deed.safe.verified, deed.attempts > 1) == (False, True)
    assert 2.0 < deed.seconds < 3.0
    assert "3.98 A" in report(deed, Ward({"name": "the drive"}, tmp_path), Cause.GONE)
    safe = json.loads((tmp_path / REPORT_FILE).read_text())["safe"]
    assert (safe["verified"], safe["current_A"]) == (False, pytest.approx(3.98))

    def failed(deed: Deed) -> None:
        servo.current = 0.0 if deed.attempts == 3 else servo.current

    deed = stop(servo, clock, patience_s=9.0, failed=failed)
    assert (deed.safe.verified, deed.attempts) == (True, 4)


OFF = Deed(SafeState(True, "switch on disabled", ("it",), watched=False), 3, 0.0512)


def test_the_report_holds_all_that_was_done(tmp_path: Path) -> None:
    words = report(OFF, Ward({"name": "the drive"}, tmp_path, limit_s=0.25), Cause.SILENT)
    text = (tmp_path / REPORT_FILE).read_text(encoding="utf-8")
    record = json.loads(text)
    assert text == json.dumps(record, indent=1) + "\n"
    created = record.pop("created")
    assert datetime.fromisoformat(created).utcoffset() == timedelta(0)
    assert created[-10] == "."
    assert record == {
        "schema": "loadrig.guardian/1",
        "cause": "silent",
        "safe": {
            "verified": True,
            "state": "switch on disabled",
            "problems": ["it"],
            "watched": False,
            "current_A": None,
            "motion_rad_s": None,
            "doubt": "",
            "joint_read": None,
        },
        "attempts": 3,
        "seconds": 0.0512,
        "message": words,
    }


SCALES = ServoScales(
    4096, 100.0, 15.0, 0.45, sign=-1, voltage_object=(0x2200, 1), temperature_object=(0x3201, 2)
)
DRIVE = {
    "name": "EPOS4 at /dev/some",
    "port": "/dev/some",
    "baud": 1_000_000,
    "node": 5,
    "eds": "/some/drive.eds",
    "scales": dataclasses.asdict(SCALES),
}
SPEAKING = 4711
"""The descriptor of its output; nothing is written there."""
ALL_OFF = "the drive is de-energised (read back: switch on disabled), 0.00 A, joint at rest"


class Servo(FakeDrive):
    def __init__(self, failures: int = 0) -> None:
        self.failures = failures
        self.stopped = 0
        self.asked: Callable[[], None] = lambda: None

    def do(self, verb: str) -> None:
        self.stopped += verb == "quick_stop"
        if verb == "quick_stop" and self.stopped == 7:
            self.asked()
        if verb == "state" and self.stopped <= self.failures:
            raise LinkError("no answer")


@dataclasses.dataclass
class Process:
    """A guardian, and all that it does to what is around it.

    Attributes:
        did: Words on its output, on the screen, in the lock, and attempts to stop the drive, in
            that order.
        waits: For input, s; answered by ``silences``, after which there always is some.
    """

    servo: Servo
    reading: int
    writing: int
    did: list[tuple[object, ...]]
    signals: list[tuple[int, object]]
    waits: list[float | None]
    silences: list[int]
    asked: Callable[[], None] = lambda: None

    def told(self, *lines: dict[str, Any]) -> None:
        for line in lines:
            os.write(self.writing, json.dumps(line).encode() + b"\n")

    def ends(self) -> int:
        os.close(self.writing)
        self.writing = -1
        return guardian.main()


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[Process]:
    reading, writing = os.pipe()
    made = Process(Servo(), reading, writing, [], [], [], [])
    did = made.did

    class Stream:
        def __init__(self, descriptor: int) -> None:
            self.descriptor = descriptor

        def fileno(self) -> int:
            return self.descriptor

    class Screen:
        shared = False

        def say(self, words: str) -> None:
            assert self.shared, "the other program may have left a line unfinished"
            did.append(("screen", words))

        def share(self) -> None:
            self.shared = True

        def drain(self, patience_s: float) -> None:
            did.append(("drain", patience_s))

        def pump(self) -> None:
            did.append(("pump",))

    class Lock:
        def __init__(self, descriptors: list[int]) -> None:
            self.descriptors = descriptors

        def note(self, command: str) -> None:
            did.append(("lock", self.descriptors, command))

        def release(self) -> None:
            did.append(("released",))

    def drive_on(port: int, ward: guardian.Ward) -> Any:
        did.append(("drive", port, ward.drive))
        return made.servo, SimulatedClock()

    def wait(wake: int, descriptor: int, seconds: float | None) -> bool:
        made.waits.append(seconds)
        made.asked()
        return len(made.waits) not in made.silences

    streams = SimpleNamespace(
        stdin=Stream(reading), stdout=Stream(SPEAKING), argv=["guardian", "33", "7", "9"]
    )
    monkeypatch.setattr(guardian, "sys", streams)
    monkeypatch.setattr(guardian, "Screen", Screen)
    monkeypatch.setattr(guardian, "inherited", Lock)
    monkeypatch.setattr(guardian, "drive_on", drive_on)
    monkeypatch.setattr(guardian, "_wait", wait)
    monkeypatch.setattr(
        guardian, "_speak", lambda descriptor, words: did.append(("says", descriptor, words))
    )
    monkeypatch.setattr(
        "rig.wiring.guardian.signal.signal",
        lambda number, handler: made.signals.append((number, handler)),
    )
    yield made
    os.close(reading)
    if made.writing >= 0:
        os.close(made.writing)


def test_the_end_of_its_input_alone_ends_it(process: Process) -> None:
    assert process.ends() == 0
    names = ("SIGHUP", "SIGINT", "SIGTERM", "SIGTSTP", "SIGTTOU")
    ignored = [(getattr(signal, name), signal.SIG_IGN) for name in names]
    assert process.signals[:-1] == ignored
    assert process.signals[-1][0] is signal.SIGUSR1
    # The other program died before it could say anything.
    assert process.did == []


STARTED = [("drive", 33, json.loads(json.dumps(DRIVE))), ("says", SPEAKING, b"ready\n")]


@pytest.mark.parametrize("left", [False, True])
def test_it_stops_the_drive_of_a_program_that_died(process: Process, left: bool) -> None:
    process.told({"drive": DRIVE}, {"armed": True}, *([{"left": True}] if left else []))
    assert process.ends() == 0
    assert process.servo.stopped == 1
    assert process.did[:2] == STARTED
    assert process.did[-4][:2] == ("lock", [7, 9])
    # A drive that is verified off leaves the bench to others.
    assert process.did[-2:] == [("released",), ("drain", 1.0)]
    why = "could not take its power off" if left else "is gone"
    assert process.did[-3][1] == (
        f"guardian: the program that drove EPOS4 at /dev/some {why}; after 0.05 s {ALL_OFF}"
    )


def test_a_failure_is_said_at_once_and_every_minute(process: Process, tmp_path: Path) -> None:
    process.servo.failures = 620
    process.told({"drive": DRIVE}, {"armed": True, "folder": str(tmp_path)})
    assert process.ends() == 0
    *failed, last = [str(words[0]) for what, *words in process.did if what == "screen"]
    assert len(failed) == 3
    assert all("HOLDING UNDER POWER: switch the main supply off now" in words for words in failed)
    assert all("`rig off` takes over" in words for words in failed)
    assert last.endswith(ALL_OFF)
    assert json.loads((tmp_path / guardian.REPORT_FILE).read_text())["safe"]["verified"] is True


@pytest.mark.parametrize("trying", [False, True])
def test_it_leaves_the_drive_to_who_asks_for_it(process: Process, trying: bool) -> None:
    def ask() -> None:
        [handler] = [does for number, does in process.signals if number == guardian.HAND_OVER]
        handler(0, None)  # type: ignore[operator]

    process.servo.failures = 10_000
    process.told({"drive": DRIVE}, {"armed": True})
    if trying:
        process.servo.asked = ask
        assert process.ends() == 0
        assert process.servo.stopped == 7
        assert ("released",) not in process.did
        assert process.did[-2][1] == "guardian of EPOS4 at /dev/some: `rig off` has taken over"
    else:
        process.silences = [1]
        process.asked = ask
        assert guardian.main() == 0
        assert process.servo.stopped == 0


def test_it_answers_while_armed(process: Process, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [
        json.dumps({"drive": DRIVE}).encode() + b"\n",
        b"\n",
        b'{"armed": true}\n',
        b"\n",
        b'{"armed": false}\n',
        b"",
    ]
    monkeypatch.setattr("rig.wiring.guardian.os.read", lambda descriptor, most: lines.pop(0))
    assert guardian.main() == 0
    assert process.did == [*STARTED, *[("says", SPEAKING, b"alive\n")] * 2]


def test_what_it_says_to_a_program_that_hangs(process: Process) -> None:
    process.silences = [1]
    process.told({"drive": DRIVE}, {"armed": True, "limit_s": 0.3})
    assert process.ends() == 0
    assert process.waits == [0.3, None]
    assert process.did == [
        *STARTED,
        ("says", SPEAKING, b"took over\n"),
        (
            "screen",
            "guardian: the program that drove EPOS4 at /dev/some gave no sign of life for 0.3 s; "
            f"after 0.05 s {ALL_OFF}",
        ),
        ("says", SPEAKING, ALL_OFF.encode() + b"\n"),
        ("pump",),
    ]


def test_after_a_takeover_it_stands_by_for_the_next_power(process, monkeypatch):
    process.silences = [1]
    lines = [
        json.dumps({"drive": DRIVE, "armed": True}).encode() + b"\n",
        b'\n{"armed": true}\n',
        b"",
    ]
    monkeypatch.setattr("rig.wiring.guardian.os.read", lambda descriptor, most: lines.pop(0))
    assert guardian.main() == 0
    assert process.waits == [0.2, None, 0.2]
    assert process.servo.stopped == 2
    assert ("lock", [7, 9], "the guardian of a program that died") in process.did


def test_it_waits_for_input_or_for_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def select(*arguments: Any) -> Any:
        asked.append(arguments)
        return ([arguments[0][0]] if len(asked) == 1 else [], [], [])

    monkeypatch.setattr("rig.wiring.guardian.select.select", select)
    assert guardian._wait(7, 5, 0.25) is True
    assert guardian._wait(7, 5, None) is False
    assert asked == [([5, 7], [], [], 0.25), ([5, 7], [], [], None)]
