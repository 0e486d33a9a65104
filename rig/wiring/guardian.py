"""The guardian: a process that de-energises a drive without a watchdog if its program dies or
hangs.

The guardian is started with the open port before the drive is enabled. JSON lines on its standard
input state how to reach the drive, where to write its report, and whether the drive is under power
(``armed``). While armed, every line, even an empty one, is a sign of life of the control loop, and
the guardian answers it with :data:`ALIVE`. The guardian acts in three cases:

- the input ends while the guardian is armed: the other program is gone;
- the same after the line ``left``: the other program could not take the power off;
- no line arrives for ``limit_s``: the other program hangs, or was suspended.

First the guardian writes ``took over`` to the standard output, so that the other program does not
use the port if it continues. Then the guardian brakes the drive, takes the power off, proves it
off by state, current and motion, writes its report next to the recording, and writes a line with
the result to the standard output. A full output never blocks the guardian.

If this fails, the guardian tries again without a limit, and opens the port again if the adapter was
unplugged. It ends when the drive is verified off, or when ``rig off`` takes the drive over by
:data:`HAND_OVER`.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Final

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.clock import NS, Clock, RealClock
from drivers.epos.link import EposSerialLink
from drivers.errors import DeviceError
from drivers.interfaces import Servo
from drivers.serial_port import BytePort, InheritedPort, PySerialPort
from drivers.units import ServoScales
from rig.common.locks import inherited
from rig.terminal.screen import Screen
from rig.wiring.off import OffProof
from rig.wiring.teardown import SafeState, make_safe

SCHEMA: Final = "loadrig.guardian/1"
REPORT_FILE: Final = "guardian.json"
READY: Final = b"ready\n"
ALIVE: Final = b"alive\n"
TOOK_OVER: Final = b"took over\n"
SILENCE_S: Final = 0.2  # default time without a sign of life after which the guardian acts, s
HAND_OVER: Final = getattr(signal, "SIGUSR1", signal.SIGTERM)
"""Signal by which `rig off` asks the guardian to leave the drive to it."""
MODULE: Final = "rig.wiring.guardian"
_PAUSE_NS: Final = NS // 5
"""Pause between two attempts to stop the drive, ns: on a lost port an attempt fails at once."""
_CYCLE_NS: Final = NS // 1000
_CHUNK: Final = 4096
_REMIND_S: Final = 60.0  # time between two messages of a guardian that goes on trying, s
_TRYING: Final = (
    "; the guardian goes on trying until the drive is off, and opens the port again when the "
    "adapter is back; `rig off` takes over from it"
)
_SHOW_S: Final = 1.0


class Cause(Enum):
    """Reason why the guardian acts or does not act."""

    RELEASED = "released"
    GONE = "gone"
    LEFT = "left"
    SILENT = "silent"
    HANDED_OVER = "handed over"


@dataclass
class Ward:
    """Data that the guardian has received from the other program."""

    # Data to reach the drive: `name`, `port`, `baud`, `node`, `eds` and `scales`.
    drive: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None  # folder for the report, or None for no report
    armed: bool = False  # whether the drive may be under power
    limit_s: float = SILENCE_S  # longest silence of the other program while armed, s
    left: bool = False  # whether the other program ended without having taken the power off
    handed_over: bool = False  # whether `rig off` has asked for the drive
    _rest: bytes = b""

    def hear(self, data: bytes) -> None:
        """Process received bytes. An incomplete line, which a dying program may leave, has no
        effect; unknown keys have no effect either.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> None:
        try:
            told = json.loads(line)
        except ValueError:
            return
        if isinstance(told, dict):
            self.drive = told.get("drive", self.drive)
            self.folder = Path(told["folder"]) if "folder" in told else self.folder
            self.limit_s = float(told.get("limit_s", self.limit_s))
            self.armed = bool(told.get("armed", self.armed))
            self.left = bool(told.get("left", self.left))


@dataclass(frozen=True)
class Deed:
    """Result of the guardian: final state of the drive, number of attempts and time taken."""

    safe: SafeState
    attempts: int
    seconds: float


def stop(
    servo: Servo,
    clock: Clock,
    reach: Callable[[], object] = lambda: None,
    *,
    watched: bool = False,
    patience_s: float = math.inf,
    failed: Callable[[Deed], None] = lambda deed: None,
    give_up: Callable[[], bool] = lambda: False,
    off: OffProof | None = None,
) -> Deed:
    """Brake, take the power off and prove that the drive is off; repeat until this is proved, the
    time is over, or the drive is handed over.

    Args:
        servo: The drive.
        clock: Clock of its link.
        reach: Opens the link of the drive if it is not open, before each attempt.
        watched: Whether the drive takes the power off by itself when it is not commanded.
        patience_s: Time for all attempts, s.
        failed: Called after every failed attempt but the last.
        give_up: Whether to end after the present attempt.
        off: Observer of the drive for all attempts; None for a new one in each, so that a drive is
            found off that was defective and then lost its main supply.
    """
    began = clock.now_ns()
    attempts = 0
    while True:
        attempts += 1
        try:
            reach()
        except DeviceError as error:
            safe = SafeState(False, "unknown", (str(error),), watched)
        else:
            safe = make_safe(
                servo,
                lambda: clock.sleep_until_ns(clock.now_ns() + _CYCLE_NS),
                clock,
                _CYCLE_NS,
                brake=True,
                hurry=give_up,
                watched=watched,
                off=off,
            )
        deed = Deed(safe, attempts, (clock.now_ns() - began) / NS)
        if safe.verified or deed.seconds > patience_s or give_up():
            return deed
        failed(deed)
        clock.sleep_until_ns(clock.now_ns() + _PAUSE_NS)


def watch(
    descriptor: int,
    ward: Ward,
    wait: Callable[[int, float | None], bool],
    answer: Callable[[], None] = lambda: None,
) -> Cause:
    """Wait until the drive must be stopped, or until the pipe is closed while the drive is off.

    Args:
        descriptor: The pipe.
        ward: Receives the input.
        wait: Waits for input on a descriptor for a number of seconds, or without a time limit if
            None; returns whether there is input, or the drive was asked for.
        answer: Called after every input while armed.
    """
    while True:
        ready = wait(descriptor, ward.limit_s if ward.armed else None)
        if ward.handed_over:
            return Cause.HANDED_OVER
        if not ready:
            return Cause.SILENT
        data = os.read(descriptor, _CHUNK)
        if not data:
            if not ward.armed:
                return Cause.RELEASED
            return Cause.LEFT if ward.left else Cause.GONE
        ward.hear(data)
        if ward.armed:
            answer()


def _wait(wake: int, descriptor: int, seconds: float | None) -> bool:
    return bool(select.select([descriptor, wake], [], [], seconds)[0])


def words_of(deed: Deed, ward: Ward, cause: Cause) -> str:
    """Return a sentence on why the guardian acted, and on the final state of the drive."""
    why = {Cause.GONE: "is gone", Cause.LEFT: "could not take its power off"}.get(
        cause, f"gave no sign of life for {ward.limit_s:g} s"
    )
    return (
        f"guardian: the program that drove {ward.drive['name']} {why}; after "
        f"{deed.seconds:.2f} s {deed.safe.message}"
    )


def report(deed: Deed, ward: Ward, cause: Cause) -> str:
    """Write the report next to the recording, if this is possible, and return it as text."""
    words = words_of(deed, ward, cause)
    if ward.folder is not None:
        record = {
            "schema": SCHEMA,
            "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "cause": cause.value,
            "safe": deed.safe.record(),
            "attempts": deed.attempts,
            "seconds": deed.seconds,
            "message": words,
        }
        try:
            (ward.folder / REPORT_FILE).write_text(
                json.dumps(record, indent=1) + "\n", encoding="utf-8"
            )
        except OSError as error:
            words += f"; {REPORT_FILE} cannot be written: {error.strerror}"
    return words


def drive_on(port: int, ward: Ward) -> tuple[Servo, Clock]:
    """Return the drive behind an open port; a port that is gone is opened again by its name."""
    clock, told = RealClock(), ward.drive
    inherited_port = [InheritedPort(port)]

    def connect() -> BytePort:
        if inherited_port:
            return inherited_port.pop()
        # The other program may still hold its lock of the port.
        return PySerialPort(told["port"], told["baud"], exclusive=False)

    link = EposSerialLink(clock, connect, told["name"])
    node = link.add_node(told["node"], Path(told["eds"]))
    scales = dict(told["scales"])
    for name, value in scales.items():
        if isinstance(value, list):
            scales[name] = tuple(tuple(v) if isinstance(v, list) else v for v in value)
    link.open()
    return Cia402Servo(node, link, ServoScales(**scales)), clock


def act(servo: Servo, clock: Clock, ward: Ward, cause: Cause, screen: Screen) -> Deed:
    """Stop the drive, and print and store the report, also once a minute while this fails."""
    told_s = -math.inf

    def failed(deed: Deed) -> None:
        nonlocal told_s
        if deed.seconds - told_s >= _REMIND_S:
            told_s = deed.seconds
            screen.say(report(deed, ward, cause) + _TRYING)
        screen.pump()

    deed = stop(servo, clock, failed=failed, give_up=lambda: ward.handed_over)
    words = report(deed, ward, cause)
    if ward.handed_over and not deed.safe.verified:
        words = f"guardian of {ward.drive['name']}: `rig off` has taken over"
    screen.say(words)
    return deed


def main() -> int:
    """Run the guardian; arguments are the descriptors of the port and of the bench's lock."""
    for name in ("SIGHUP", "SIGINT", "SIGTERM", "SIGTSTP", "SIGTTOU"):
        # The guardian ignores stop signals; only the end of its input ends the process.
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    ward, screen = Ward(), Screen()
    screen.share()
    woken, wake = os.pipe()

    def hand_over(number: int, frame: FrameType | None) -> None:
        ward.handed_over = True
        os.write(wake, b"\n")

    signal.signal(HAND_OVER, hand_over)
    listening, speaking = sys.stdin.fileno(), sys.stdout.fileno()
    while not ward.drive:
        data = os.read(listening, _CHUNK)
        if not data:
            # The other program died before its first line, and the drive was not under power.
            return 0
        ward.hear(data)
    port, *lock = map(int, sys.argv[1:])
    servo, clock = drive_on(port, ward)
    bench = inherited(lock)
    _speak(speaking, READY)
    while True:
        cause = watch(listening, ward, partial(_wait, woken), partial(_speak, speaking, ALIVE))
        if cause in (Cause.RELEASED, Cause.HANDED_OVER):
            return 0
        if cause is Cause.SILENT:
            _speak(speaking, TOOK_OVER)
        else:
            bench.note("the guardian of a program that died")
        deed = act(servo, clock, ward, cause, screen)
        if cause is not Cause.SILENT or ward.handed_over:
            if deed.safe.verified:
                bench.release()
            screen.drain(_SHOW_S)
            return 0 if deed.safe.verified or ward.handed_over else 1
        ward.armed = False
        _speak(speaking, deed.safe.message.encode() + b"\n")
        screen.pump()


def _speak(descriptor: int, words: bytes) -> None:
    """Write to the other program; the pipe is nearly empty, so that this call does not block."""
    # If the other program is gone, the end of the input shows this.
    with suppress(OSError):
        os.write(descriptor, words)


if __name__ == "__main__":
    sys.exit(main())
