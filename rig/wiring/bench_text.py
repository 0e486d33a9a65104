"""Makes the text that identifies a bench to the operator: name, real or simulated, and the watchdog
or guardian of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen.cia402_servo import WATCH_S
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection
from rig.config.serial_bus import GUARDED, NO_WATCHDOG, SerialBus, sleep_words
from rig.wiring.devices import Devices
from rig.wiring.guardian import SILENCE_S


def bench_line(document: Document[Bench]) -> str:
    """Return the line that names a bench and its file, and says whether it is REAL or simulated."""
    kind = "simulated" if document.value.simulated else "REAL"
    return f"{kind} bench {document.value.name} ({document.path})"


@dataclass(frozen=True)
class Watcher:
    """Device or process that takes the power off when this program stops commanding the drive.

    Attributes:
        kind: ``drive``, ``guardian`` or ``nobody``.
        after_s: Time, s, that drive or guardian waits for this program, or None for ``nobody``.
    """

    kind: str
    after_s: float | None = None

    @property
    def words(self) -> str:
        """Description for the operator."""
        if self.kind == "drive" and self.after_s is not None:
            wait = f"{self.after_s * 1e3:g} ms"
            return f"the drive itself: it stops when it hears nothing of this program for {wait}"
        if self.kind == "guardian" and self.after_s is not None:
            wait = f"{self.after_s * 1e3:g} ms"
            return (
                f"a guardian: a process that stops the drive when this program dies or hangs "
                f"for {wait}"
            )
        return "NOBODY: the drive goes on holding its last target when this program dies"

    @property
    def warnings(self) -> list[str]:
        """What nothing protects, for the operator before a run."""
        return {"nobody": [NO_WATCHDOG], "guardian": [GUARDED]}.get(self.kind, [])


def watcher_of(bench: Bench) -> Watcher:
    """Return the watchdog or guardian that the bench file implies."""
    if isinstance(bench.bus, SerialBus):
        return Watcher("nobody") if bench.simulated else Watcher("guardian", SILENCE_S)
    if isinstance(bench.servo, DbcServoSection):
        watchdog_ms = bench.servo.watchdog_ms
        return Watcher("nobody") if watchdog_ms is None else Watcher("drive", watchdog_ms * 1e-3)
    return Watcher("drive", WATCH_S) if bench.watched else Watcher("nobody")


def watcher(devices: Devices) -> Watcher:
    """Return the watchdog or guardian of a connected bench."""
    if devices.link.has_watchdog and devices.servo.watch_s is not None:
        return Watcher("drive", devices.servo.watch_s)
    return Watcher("nobody") if devices.guard is None else Watcher("guardian", SILENCE_S)


def unprotected(devices: Devices) -> list[str]:
    """Return what nothing protects on a connected bench, for the operator before a run."""
    told = [] if devices.link.has_watchdog else watcher(devices).warnings
    return [*told, sleep_words(devices.awake)] if told and devices.awake else told
