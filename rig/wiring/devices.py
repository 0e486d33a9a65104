"""The devices of a run: link, servo, encoder and optional others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import click

from drivers.canopen.cia402_servo import WATCH_S
from drivers.clock import Clock, Suspension
from drivers.interfaces import Encoder, Link, PressureTransmitter, Servo
from rig.common.locks import Lock
from rig.common.sample import Phase
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection
from rig.config.serial_bus import GUARDED, NO_WATCHDOG, SerialBus, sleep_words
from rig.planning.limits import Limits
from rig.terminal.screen import Screen
from rig.wiring.guard import Guard
from rig.wiring.guardian import SILENCE_S
from rig.wiring.off import OffProof


@dataclass(frozen=True)
class Nominal:
    """Constants of the bench file with which the first motion is compared; None if not stated."""

    torque_constant_N_m_A: float
    gear_ratio: float
    rated_current_A: float | None = None
    rated_torque_N_m: float | None = None
    encoder_sign: int = 1
    current_sign: int | None = 1
    back_emf_constant_V_s_rad: float | None = None


@dataclass(frozen=True)
class Devices:
    """The devices of a run."""

    link: Link
    servo: Servo
    encoder: Encoder
    # Function that puts a mass in kg on a simulated lever, or None if a person does.
    hang: Callable[[float], None] | None = None
    # Real clock that slows simulated time to real time; None to run on the link's clock alone.
    pacer: Clock | None = None
    # Called with stage name and phase at the start of every phase.
    observer: Callable[[str, Phase], None] | None = None
    # Process that stops a drive without a watchdog when this program dies, or None if there is
    # none.
    guard: Guard | None = None
    pressure: PressureTransmitter | None = None
    # Function that ignites a simulated gas generator, or None if a person does.
    ignite: Callable[[], None] | None = None
    lock: Lock | None = None
    # Constants of the bench file with which motions are compared, or None for no comparison.
    nominal: Nominal | None = None
    suspension: Suspension | None = None  # detects that this computer slept; None in simulated time
    awake: str = ""  # why this computer may sleep during the run; empty if it does not

    def off_proof(self, limits: Limits) -> OffProof:
        """Return an observer that proves that the drive of a bench with these limits is off."""
        clock = self.link.clock
        return OffProof(self.servo, clock, self.encoder, limits.speed, limits.current)

    def insist(self) -> None:
        """Leave a drive that was not proved off to its guardian, if there is one."""
        if self.guard is not None:
            self.guard.insist()

    def prepare(self, cycle_s: float) -> None:
        """Check every device against the bench file and map its data, or raise a DeviceError."""
        self.servo.prepare(cycle_s)
        self.encoder.prepare(cycle_s)
        if self.pressure is not None:
            self.pressure.prepare(cycle_s)


def bench_line(document: Document[Bench]) -> str:
    """Return the line that names a bench and its file, and says whether it is REAL or simulated."""
    kind = "simulated" if document.value.simulated else "REAL"
    return f"{kind} bench {document.value.name} ({document.path})"


@dataclass(frozen=True)
class Watcher:
    """What takes the power off when this program stops commanding: drive, guardian or nobody."""

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


def until_the_end(lock: Lock) -> Lock:
    """Release a lock when the current command ends, regularly or by an error."""
    click.get_current_context().with_resource(lock)
    say_taken_over(lock)
    return lock


def say_taken_over(lock: Lock | None, screen: Screen | None = None) -> None:
    """Inform the operator if the previous holder of a lock ended without releasing it."""
    if lock is None or lock.taken_over is None:
        return
    if screen is None:
        click.echo(lock.taken_over, err=True)
    else:
        screen.say(lock.taken_over)
