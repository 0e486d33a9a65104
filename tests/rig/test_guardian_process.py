"""The guardian's main program, between two pipes: what it says and when, which lock it notes, how
it ends.
"""

from __future__ import annotations

import dataclasses
import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import rig.wiring.guardian as guardian
from drivers.clock import SimulatedClock
from drivers.errors import LinkError
from drivers.units import ServoScales

from .drives import FakeDrive

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
OFF = "the drive is de-energised (read back: switch on disabled), 0.00 A, joint at rest"


class Servo(FakeDrive):
    """A drive that can be reached after so many attempts."""

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
        """Let the other program die."""
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
        def say(self, words: str) -> None:
            did.append(("screen", words))

        def share(self) -> None:
            pass

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
        f"guardian: the program that drove EPOS4 at /dev/some {why}; after 0.05 s {OFF}"
    )


def test_a_failure_is_said_at_once_and_every_minute(process: Process, tmp_path: Path) -> None:
    process.servo.failures = 620
    process.told({"drive": DRIVE}, {"armed": True, "folder": str(tmp_path)})
    assert process.ends() == 0
    *failed, last = [str(words[0]) for what, *words in process.did if what == "screen"]
    assert len(failed) == 3
    assert all("HOLDING UNDER POWER: switch the main supply off now" in words for words in failed)
    assert all("`rig off` takes over" in words for words in failed)
    assert last.endswith(OFF)
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
            f"after 0.05 s {OFF}",
        ),
        ("says", SPEAKING, OFF.encode() + b"\n"),
        ("pump",),
    ]


def test_after_a_takeover_it_stands_by_for_the_next_power(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
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
