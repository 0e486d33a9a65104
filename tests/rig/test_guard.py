"""The guarded side: feeding, a takeover, and a guardian that is gone."""

import dataclasses
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import NS
from drivers.errors import LinkError
from drivers.interfaces import ServoState
from drivers.mock.power_state import State
from drivers.units import ServoScales
from rig.wiring.guard import Guard
from rig.wiring.guardian import ALIVE, READY, TOOK_OVER

from ..drivers.serial_host import make_serial_host
from .drives import stopped_by_ramp

DE_ENERGISED = b"the drive is de-energised (read back: switch on disabled)\n"
NAME = "EPOS4 at /dev/some"
SCALES = ServoScales(4096, 100.0, 15.0, 0.45, sign=-1)


def _pipe() -> tuple[Any, Any]:
    reading, writing = os.pipe()
    return os.fdopen(reading, "rb", buffering=0), os.fdopen(writing, "wb", buffering=0)


class Guardian:
    """A guardian process as the guard sees it: two pipes."""

    def __init__(self) -> None:
        ours, self.stdin = _pipe()
        self.stdout, theirs = _pipe()
        self.hears, self.speaks = ours, theirs
        os.set_blocking(ours.fileno(), False)
        self.returncode: int | None = None
        self.started: list[tuple[list[str], dict[str, Any]]] = []
        self.waited: list[float] = []
        self.stubborn = self.killed = False
        self.speaks.write(READY)

    def heard(self) -> bytes:
        return self.hears.read() or b""

    def wait(self, timeout: float = 0.0) -> int:
        self.waited.append(timeout)
        if self.stubborn:
            raise subprocess.TimeoutExpired("guardian", timeout)
        return 0

    def kill(self) -> None:
        self.killed, self.stubborn = True, False


def fill(guardian: Guardian) -> None:
    # Small writes last, so that not even a sign of life fits.
    for size in (4096, 1):
        while True:
            try:
                os.write(guardian.stdin.fileno(), b"x" * size)
            except BlockingIOError:
                break


class Time:
    """A clock, and a wait for input on it.

    Attributes:
        waits: Every wait, s.
        meanwhile: Called at the start of each wait.
    """

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.waits: list[float] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self._select = select.select

    def select(self, reading: list[int], writing: list[int], odd: list[int], wait_s: float) -> Any:
        assert wait_s >= 0.0
        self.waits.append(wait_s)
        self.meanwhile()
        ready = self._select(reading, writing, odd, 0.0)
        if not ready[0]:
            self.now_ns += round(wait_s * 1e9)
        return ready

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    made = Time()
    monkeypatch.setattr("rig.wiring.guard.time.monotonic_ns", lambda: made.now_ns)
    monkeypatch.setattr("rig.wiring.guard.select.select", made.select)
    return made


@pytest.fixture
def guardian(monkeypatch: pytest.MonkeyPatch) -> Iterator[Guardian]:
    made = Guardian()

    def start(words: list[str], **options: Any) -> Guardian:
        made.started.append((words, options))
        return made

    monkeypatch.setattr("rig.wiring.guard.subprocess.Popen", start)
    yield made
    for pipe in (made.stdin, made.stdout, made.hears, made.speaks):
        pipe.close()


class Port:
    def __init__(self, *arguments: object, exclusive: bool) -> None:
        self.arguments = arguments
        self.exclusive = exclusive

    def fileno(self) -> int:
        return 33


@pytest.fixture
def guard(guardian: Guardian, time: Time, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Guard:
    monkeypatch.setattr("rig.wiring.guard.PySerialPort", Port)
    made = Guard("/dev/some", 1_000_000, 5, tmp_path / "drive.eds", SCALES)
    made.open_port()
    return made


def test_the_guardian_gets_the_port_and_the_lock_in_a_session_of_its_own(guard, guardian):
    guard.keep([7, 9])
    guard.arm(0.2)
    [(words, options)] = guardian.started
    assert words == [sys.executable, "-m", "rig.wiring.guardian", "33", "7", "9"]
    assert options == {
        "stdin": subprocess.PIPE,
        "stdout": subprocess.PIPE,
        "pass_fds": (33, 7, 9),
        "start_new_session": True,
        "bufsize": 0,
    }
    # The loop must never wait for the guardian to read.
    assert not os.get_blocking(guardian.stdin.fileno())


def test_it_tells_the_drive_first_and_then_to_stand_by(guard, guardian, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    guard.record_in(Path("run"))
    guard.arm(0.25)
    drive, armed, rest = guardian.heard().split(b"\n")
    assert json.loads(drive) == {
        "drive": {
            "name": NAME,
            "port": "/dev/some",
            "baud": 1_000_000,
            "node": 5,
            "eds": str(tmp_path / "drive.eds"),
            "scales": json.loads(json.dumps(dataclasses.asdict(SCALES))),
        }
    }
    assert json.loads(armed) == {"armed": True, "limit_s": 0.25, "folder": str(tmp_path / "run")}
    assert rest == b""


def test_it_feeds_while_armed_and_not_more_often_than_needed(guard, guardian, time):
    guard.feed()
    guard.arm(0.2)
    guardian.heard()
    time.waits.clear()
    for _ in range(100):
        time.now_ns += 1_000_000
        guard.feed()
    assert guardian.heard() == b"\n" * 5
    assert time.waits == [0.0] * 5
    guard.release()
    assert guardian.heard() == b'{"armed": false}\n'
    guard.release()
    time.wait(1.0)
    guard.feed()
    assert guardian.heard() == b""


def test_after_a_takeover_the_run_ends_and_the_drive_can_be_read_back(guard, guardian, time):
    guard.arm(0.2)
    guardian.heard()
    time.wait(2.0)
    guardian.speaks.write(b"odd " + TOOK_OVER + DE_ENERGISED + b"more")
    with pytest.raises(LinkError) as caught:
        guard.feed()
    assert str(caught.value) == (
        "the control loop did not run for 2.00 s, so that the guardian stopped the drive: "
        "the drive is de-energised (read back: switch on disabled)"
    )
    guard.feed()
    guard.release()
    assert guardian.heard() == b""
    # Armed again, what is said belongs to the new time.
    guard.arm(0.2)
    time.wait(1.0)
    guard.feed()


def test_a_report_is_waited_for_three_seconds(guard: Guard, guardian: Guardian, time: Time) -> None:
    guard.arm(0.2)
    time.wait(1.0)
    time.waits.clear()
    guardian.speaks.write(TOOK_OVER + b"the drive")
    with pytest.raises(LinkError) as caught:
        guard.feed()
    assert str(caught.value) == (
        f"the guardian of {NAME} has taken over and is still trying to take the power off: switch "
        f"the main supply off"
    )
    assert time.waits == [0.0, 3.0]
    time.waits.clear()
    for _ in range(3):
        with pytest.raises(LinkError, match="is still trying to take the power off"):
            guard.feed()
    assert time.waits == [0.0] * 3
    guardian.speaks.write(b" is off \xff\n")
    guard.feed()
    guard.feed()
    assert time.waits == [0.0] * 4


def test_a_report_that_comes_in_parts_is_put_together_within_the_same_time(guard, guardian, time):
    guard.arm(0.2)
    time.wait(1.0)
    time.waits.clear()
    parts = [TOOK_OVER, b"the drive ", b"is \xff off", b"\nx"]

    def speak() -> None:
        if parts:
            guardian.speaks.write(parts.pop(0))
            time.wait(0.5)

    time.meanwhile = speak
    with pytest.raises(LinkError, match="the guardian stopped the drive: the drive is \ufffd off"):
        guard.feed()
    assert time.waits == [0.0, 3.0, 2.5, 2.0]


def test_a_guardian_that_is_gone_ends_the_run(guard: Guard, guardian: Guardian, time: Time) -> None:
    guard.arm(0.2)
    guardian.speaks.close()
    time.wait(0.1)
    with pytest.raises(LinkError) as caught:
        guard.feed()
    assert str(caught.value) == f"the guardian of {NAME} has ended; stop and run again"
    # Nobody else uses the port: the drive can be stopped without the guardian.
    time.wait(0.1)
    guard.feed()
    guard.release()
    guardian.hears.close()
    with pytest.raises(LinkError, match="has ended"):
        guard.arm(0.2)


def test_a_guardian_that_ends_during_its_takeover_leaves_the_port_to_the_program(
    guard: Guard, guardian: Guardian, time: Time
) -> None:
    guard.arm(0.2)
    time.wait(1.0)
    guardian.speaks.write(TOOK_OVER)
    with pytest.raises(LinkError, match="is still trying to take the power off"):
        guard.feed()
    guardian.speaks.close()
    with pytest.raises(LinkError, match="has ended"):
        guard.feed()
    time.wait(1.0)
    guard.feed()


@pytest.mark.parametrize("suspended", [False, True])
def test_without_its_guardian_the_program_takes_the_power_off(
    guard: Guard, guardian: Guardian, monkeypatch: pytest.MonkeyPatch, suspended: bool
) -> None:
    host = make_serial_host()
    clock = host.bench.clock
    monkeypatch.setattr("rig.wiring.guard.time.monotonic_ns", clock.now_ns)
    host.epos.guard = guard
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.servo.enable()
    host.cycles(50, lambda time: 0.3 * time)
    if suspended:
        fill(guardian)
    else:
        guardian.hears.close()
        guardian.speaks.close()
    with pytest.raises(LinkError, match="accepts no messages" if suspended else "has ended"):
        host.cycles(50)

    entered: list[State] = []
    host.bench.drive.entered.append(entered.append)
    braking: list[int] = []

    def watch() -> ServoState | None:
        braking.append(clock.now_ns())
        host.cycles(1)
        return host.servo.sent_state()

    cycle_ns = round(host.cycle_s * NS)
    safe = stopped_by_ramp(host.servo, watch, clock, cycle_ns, watched=False, insistent=True)
    host.link.close()
    assert entered == [State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED]
    assert safe.verified
    # The ramp was not cut short: the wait for the standstill ran control cycles.
    assert len(braking) > 2
    if not suspended:
        assert safe.problems == ()


def missed(guard: Guard, guardian: Guardian, time: Time) -> None:
    """Arm a guard whose guardian does not read; the guard reports this."""
    guard.arm(0.2)
    fill(guardian)
    time.wait(0.1)
    with pytest.raises(LinkError) as caught:
        guard.feed()
    assert str(caught.value) == f"the guardian of {NAME} accepts no messages; stop and run again"


def test_a_guardian_that_listens_again_hears_signs_of_life_and_may_take_over(guard, guardian, time):
    missed(guard, guardian, time)
    time.wait(0.1)
    guard.feed()  # It is reported once.
    # It cannot be told that the drive is off, and must not use the port unnoticed later.
    with pytest.raises(LinkError, match="accepts no messages"):
        guard.release()
    while guardian.heard():
        pass
    time.wait(0.1)
    guard.feed()
    assert guardian.heard() == b"\n"
    guardian.speaks.write(TOOK_OVER + DE_ENERGISED)
    time.wait(0.1)
    with pytest.raises(LinkError, match="the guardian stopped the drive"):
        guard.feed()
    # Armed again, it is missed again.
    missed(guard, guardian, time)


def answered(guard: Guard, guardian: Guardian, time: Time, seconds: float) -> None:
    for _ in range(round(seconds * 50)):
        time.wait(0.02)
        guard.feed()
        if guardian.heard():
            guardian.speaks.write(ALIVE)


def unanswered(guard: Guard, time: Time) -> None:
    for _ in range(50):
        time.wait(0.02)
        guard.feed()


def test_a_guardian_that_hangs_ends_the_run_after_a_fifth_of_a_second(guard, guardian, time):
    guard.arm(0.2)
    answered(guard, guardian, time, 1.0)
    before_ns = time.now_ns
    with pytest.raises(LinkError) as caught:
        unanswered(guard, time)
    assert 0.2e9 < time.now_ns - before_ns <= 0.26e9
    assert str(caught.value).startswith(
        f"the guardian of {NAME} did not answer for 0.22 s (limit 0.2 s), so that nothing would "
    )
    # It is reported once: the program takes the power off itself, and goes on feeding meanwhile.
    guardian.heard()
    unanswered(guard, time)
    assert guardian.heard() == b"\n" * 50
    # A guardian that answers again is missed again.
    answered(guard, guardian, time, 0.5)
    with pytest.raises(LinkError, match="did not answer"):
        unanswered(guard, time)


def test_a_pause_of_the_program_is_no_silence_of_the_guardian(guard, guardian, time):
    guard.arm(10.0)
    answered(guard, guardian, time, 0.2)
    guard.feed()
    guardian.speaks.write(ALIVE + ALIVE)
    time.wait(5.0)
    guard.feed()
    answered(guard, guardian, time, 1.0)


def test_a_guardian_that_hangs_does_not_keep_the_bench(guard, guardian, time):
    guard.arm(0.2)
    guard.release()
    guardian.stubborn = True
    guard.close()
    assert guardian.killed


def test_what_is_left_to_the_guardian_is_told(guard: Guard, guardian: Guardian) -> None:
    guard.arm(0.2)
    guardian.heard()
    guard.close()
    assert guardian.heard() == b'{"left": true}\n'


def test_a_drive_that_was_not_proved_off_is_left_to_the_guardian(guard, guardian):
    """Although its state was off, so that the guardian stood down."""
    guard.insist()
    guard.close()
    assert guardian.started == []
    guard.arm(0.2)
    guard.release()
    guardian.heard()
    guard.insist()
    guard.close()
    assert guardian.heard() == b'{"left": true}\n'


def test_a_guardian_that_cannot_be_started_keeps_the_drive_off(guard, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", full)
    with pytest.raises(LinkError, match="cannot be started"):
        guard.arm(0.2)


def test_a_guardian_that_does_not_start_keeps_the_drive_off(guard, guardian, time):
    guardian.stdout.read(len(READY))
    with pytest.raises(LinkError) as caught:
        guard.arm(0.2)
    assert str(caught.value) == (
        f"the guardian of {NAME} did not start within 20 s; the drive is not enabled "
        "without the guardian"
    )
    assert time.waits == [20.0]
    assert guardian.heard().count(b"\n") == 1
    # What was started is let go all the same.
    guard.close()
    assert guardian.waited == [2.0]


def test_closing_lets_the_guardian_go(guard: Guard, guardian: Guardian) -> None:
    guard.close()
    assert guardian.waited == []
    guard.arm(0.2)
    guard.close()
    assert guardian.stdin.closed
    assert guardian.stdout.closed
    assert guardian.waited == [2.0]
    assert guardian.returncode is None
    guard.close()
    assert guardian.waited == [2.0]


def test_a_guardian_that_still_tries_is_left_alone(guard: Guard, guardian: Guardian) -> None:
    guard.arm(0.2)
    guardian.stubborn = True
    guard.close()
    # As if it had ended, so that nobody warns of a child that is still running.
    assert guardian.returncode == 0
