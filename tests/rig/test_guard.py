"""The guarded side: feeding, a takeover that keeps this program off the line, and a guardian that is gone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import LinkError
from drivers.units import ServoScales
from rig.guard import Guard
from rig.guardian import READY, TOOK_OVER


def _pipe() -> tuple[Any, Any]:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    return os.fdopen(reading, "rb", buffering=0), os.fdopen(writing, "wb", buffering=0)


class Guardian:
    """A guardian process as the guard sees it: two pipes."""

    def __init__(self) -> None:
        ours, self.stdin = _pipe()
        self.stdout, theirs = _pipe()
        self.hears, self.speaks = ours, theirs
        os.set_blocking(ours.fileno(), False)
        self.returncode: int | None = None
        self.speaks.write(READY)

    def heard(self) -> bytes:
        return self.hears.read() or b""

    def wait(self, timeout: float) -> int:
        return 0


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    clock = [1_000_000_000]
    monkeypatch.setattr("rig.guard.time.monotonic_ns", lambda: clock[0])
    return clock


@pytest.fixture
def guardian(monkeypatch: pytest.MonkeyPatch) -> Iterator[Guardian]:
    made = Guardian()
    monkeypatch.setattr("rig.guard.subprocess.Popen", lambda *arguments, **options: made)
    yield made
    for pipe in (made.stdin, made.stdout, made.hears, made.speaks):
        pipe.close()


@pytest.fixture
def guard(guardian: Guardian, now: list[int], tmp_path: Path) -> Guard:
    made = Guard("/dev/some", 1_000_000, 1, tmp_path / "drive.eds", ServoScales(4096, 100.0, 15.0, 0.45))

    class Port:
        def fileno(self) -> int:
            return 3

    port: Any = Port()
    made._port = port
    return made


def test_it_feeds_while_armed_and_not_more_often_than_needed(guard: Guard, guardian: Guardian, now: list[int]) -> None:
    guard.feed()
    guard.arm(0.2)
    assert b'"armed": true, "limit_s": 0.2' in guardian.heard()
    for _ in range(100):
        now[0] += 1_000_000
        guard.feed()
    assert guardian.heard() == b"\n" * 5
    guard.release()
    assert b'"armed": false' in guardian.heard()
    now[0] += 10**9
    guard.feed()
    assert guardian.heard() == b""


def test_after_a_takeover_the_run_ends_and_the_drive_can_be_read_back(
    guard: Guard, guardian: Guardian, now: list[int]
) -> None:
    guard.arm(0.2)
    guardian.heard()
    now[0] += 2_000_000_000
    guardian.speaks.write(TOOK_OVER + b"the drive is de-energised (read back: switch on disabled)\n")
    with pytest.raises(
        LinkError, match=r"did not run for 2\.00 s, and the guardian stopped: the drive is de-energised"
    ):
        guard.feed()
    guard.feed()
    guard.release()
    assert guardian.heard() == b""


def test_as_long_as_the_guardian_has_the_drive_the_line_is_not_used(
    guard: Guard, guardian: Guardian, now: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.guard._TAKEOVER_S", 0.0)
    guard.arm(0.2)
    now[0] += 2_000_000_000
    guardian.speaks.write(TOOK_OVER)
    for _ in range(3):
        with pytest.raises(LinkError, match="is still trying to take the power off: switch the main supply off"):
            guard.feed()
    guardian.speaks.write(b"the drive is de-energised\n")
    guard.feed()


def test_a_guardian_that_is_gone_ends_the_run(guard: Guard, guardian: Guardian, now: list[int]) -> None:
    guard.arm(0.2)
    guardian.speaks.close()
    now[0] += 100_000_000
    with pytest.raises(LinkError, match="the guardian of EPOS4 at /dev/some is gone"):
        guard.feed()


def test_a_guardian_that_does_not_listen_ends_the_run(guard: Guard, guardian: Guardian, now: list[int]) -> None:
    guard.arm(0.2)
    while True:
        try:
            os.write(guardian.stdin.fileno(), b"x" * 4096)
        except BlockingIOError:
            break
    now[0] += 100_000_000
    with pytest.raises(LinkError, match="does not listen"):
        guard.feed()


def test_a_guardian_that_does_not_start_keeps_the_drive_off(
    guard: Guard, guardian: Guardian, monkeypatch: pytest.MonkeyPatch
) -> None:
    guardian.stdout.read(len(READY))
    monkeypatch.setattr("rig.guard._START_S", 0.0)
    with pytest.raises(LinkError, match="the drive is not enabled without it"):
        guard.arm(0.2)
