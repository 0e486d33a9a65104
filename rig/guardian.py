"""The guardian: a process that takes the power off a drive without a watchdog when the program that drives it dies.

It is started with the open port before the drive is enabled, and hears on its standard input, line by line in JSON, how
to reach the drive, where to write, and whether the drive is under power (``armed``). When the input ends while that is
so, it brakes the drive, takes the power off, reads 6041h back, and writes what it did beside the recording. The two
processes never speak at once: the guardian only does when the other one is gone.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from drivers.cia402_servo import Cia402Servo
from drivers.clock import NS, Clock, RealClock
from drivers.epos_serial_link import EposSerialLink
from drivers.interfaces import Servo
from drivers.serial_port import InheritedPort
from drivers.units import ServoScales
from rig.teardown import SafeState, make_safe

SCHEMA: Final = "loadrig.guardian/1"
REPORT_FILE: Final = "guardian.json"
READY: Final = b"ready\n"
_PATIENCE_S: Final = 60.0
_CYCLE_NS: Final = NS // 1000


@dataclass
class Ward:
    """What the guardian has been told so far.

    Attributes:
        drive: How to reach it: ``name``, ``node``, ``eds`` and ``scales``.
        folder: Where to write what was done; None for nowhere.
        armed: Whether the drive may be under power.
    """

    drive: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None
    armed: bool = False

    def hear(self, line: bytes) -> None:
        """Take one line; half a line, as a dying program may leave it, and unknown words change nothing."""
        try:
            told = json.loads(line)
        except ValueError:
            return
        if isinstance(told, dict):
            self.drive = told.get("drive", self.drive)
            self.folder = Path(told["folder"]) if "folder" in told else self.folder
            self.armed = bool(told.get("armed", self.armed))


@dataclass(frozen=True)
class Deed:
    """What the guardian did: how the drive was left, how often it was tried, and how long that took."""

    safe: SafeState
    attempts: int
    seconds: float


def stop(servo: Servo, clock: Clock, patience_s: float = _PATIENCE_S) -> Deed:
    """Brake, take the power off and read the state back, again and again until that is verified or patience ends."""
    began = clock.now_ns()
    attempts = 0
    while True:
        attempts += 1
        safe = make_safe(
            servo,
            lambda: clock.sleep_until_ns(clock.now_ns() + _CYCLE_NS),
            _CYCLE_NS,
            brake=True,
            hurry=lambda: False,
            watched=False,
        )
        spent_s = (clock.now_ns() - began) / NS
        if safe.verified or spent_s > patience_s:
            return Deed(safe, attempts, spent_s)


def watch(lines: Iterable[bytes], ward: Ward) -> bool:
    """Listen until the other program has closed the pipe or died; returns whether the drive must be stopped."""
    for line in lines:
        ward.hear(line)
    return ward.armed


def report(deed: Deed, ward: Ward) -> str:
    """Write what was done beside the recording, and return it in words; a full disk is no reason to be silent."""
    words = (
        f"guardian: the program that drove {ward.drive['name']} is gone; after {deed.seconds:.2f} s {deed.safe.message}"
    )
    if ward.folder is not None:
        record = {
            "schema": SCHEMA,
            "created": datetime.now(UTC).isoformat(timespec="milliseconds"),
            **dataclasses.asdict(deed),
            "message": words,
        }
        try:
            (ward.folder / REPORT_FILE).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            words += f"; {REPORT_FILE} cannot be written: {error.strerror}"
    return words


def drive_on(port: int, ward: Ward) -> tuple[Servo, Clock]:
    """Return the drive behind an open port, given as a file descriptor."""
    clock, told = RealClock(), ward.drive
    link = EposSerialLink(clock, lambda: InheritedPort(port), told["name"])
    node = link.add_node(told["node"], Path(told["eds"]))
    scales = dict(told["scales"])
    for name in ("voltage_object", "temperature_object"):
        scales[name] = tuple(scales[name])
    link.open()
    return Cia402Servo(node, link, ServoScales(**scales)), clock


def main() -> int:
    """Be the guardian of the port whose file descriptor is given."""
    ward = Ward()
    ward.hear(sys.stdin.buffer.readline())
    if not ward.drive:
        # The other program died before it could say anything; nothing was under power.
        return 0
    servo, clock = drive_on(int(sys.argv[1]), ward)
    sys.stdout.buffer.write(READY)
    sys.stdout.buffer.flush()
    if not watch(sys.stdin.buffer, ward):
        return 0
    deed = stop(servo, clock)
    sys.stderr.write(report(deed, ward) + "\n")
    return 0 if deed.safe.verified else 1


if __name__ == "__main__":
    sys.exit(main())
