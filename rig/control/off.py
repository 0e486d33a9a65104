"""Makes a bench safe, whoever uses it and whatever has died: quick stop, power off, proof that the
drive is off.

A program that uses the bench is asked to stop by SIGTERM, which every command takes as its stop
button. A program that is frozen, or that does not leave the bench within :data:`RELEASE_S`, is
killed; its recording survives. A guardian is asked to hand the drive over, and is killed if it does
not within :data:`HANDOVER_S`. So this program is alone on the line, where two masters would destroy
each other's messages. What cannot be ended, such as a program of another user, does not prevent
the stop.
"""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from drivers.clock import NS, Clock, RealClock
from rig.common.errors import InputError, InUseError, StorageError
from rig.common.locks import Holder, Lock, hold_bench, lock_files
from rig.common.provenance import sha256_file, utc_now, versions
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.planning.plan import bench_limits
from rig.wiring.connect import NO_BUS, bare_bench, bus_resources
from rig.wiring.guardian import HAND_OVER, MODULE, stop
from rig.wiring.off import OffProof
from rig.wiring.teardown import SafeState

SCHEMA: Final = "loadrig.off/1"
RELEASE_S: Final = 5.0  # time in which a program that was asked to stop must leave the bench, s
HANDOVER_S: Final = 2.0
"""Time, s, in which a guardian must leave the bench: the end of an attempt on a dead line."""
KILLED_S: Final = 1.0
"""Time, s, in which a killed program is gone, and its guardian has taken the power off."""
HOLD_S: Final = 2.0
"""Time, s, in which the lock of the bench must be free after all its users have left."""
PATIENCE_S: Final = 10.0  # time, s, for attempts to reach a drive that does not answer
_LOOK_NS: Final = NS // 50
_PROC: Final = Path("/proc")


class Processes:
    """The processes of this computer, as far as this user may see and end them."""

    def using(self, files: Iterable[Path]) -> list[int]:
        """Return the other processes that have one of the files open; none without ``/proc``."""
        names = {os.path.realpath(file) for file in files}
        found = []
        with suppress(OSError):
            numbers = [int(name) for name in os.listdir(_PROC) if name.isdigit()]
            for number in sorted(set(numbers) - {os.getpid()}):
                with suppress(OSError):
                    folder = _PROC / str(number) / "fd"
                    if any(_target(folder / name) in names for name in os.listdir(folder)):
                        found.append(number)
        return found

    def command(self, number: int) -> str:
        """Return the command line of a process; empty if the process is gone."""
        with suppress(OSError):
            words = (_PROC / str(number) / "cmdline").read_bytes().split(b"\0")
            return b" ".join(words).decode(errors="replace").strip()
        return ""

    def frozen(self, number: int) -> bool:
        """Whether a process is suspended."""
        with suppress(OSError, IndexError):
            # The name of the program, in parentheses, may contain any character.
            status = (_PROC / str(number) / "stat").read_text(encoding="utf-8", errors="replace")
            return status.rpartition(")")[2].split()[0] in "Tt"
        return False

    def send(self, number: int, what: signal.Signals) -> None:
        """Send a signal; a process that is gone, or belongs to another user, does not get it."""
        with suppress(OSError):
            os.kill(number, what)


def _target(link: Path) -> str:
    with suppress(OSError):
        return os.readlink(link)
    return ""


@dataclass(frozen=True)
class User:
    """A process that used the bench."""

    pid: int
    command: str  # name of the command that it runs, else its command line
    ended: str  # how it left the bench: `stopped`, `handed over`, `killed` or `stays`


@dataclass(frozen=True)
class Off:
    """What came of :func:`make_off`; ``safe`` is None for a simulation."""

    bench: str
    file: Path
    simulated: bool
    safe: SafeState | None
    users: tuple[User, ...]
    attempts: int
    seconds: float

    @property
    def proved(self) -> bool:
        """Whether nothing is left under power: proved on a real bench, true of a simulation."""
        return self.safe is None or self.safe.verified

    @property
    def message(self) -> str:
        """One sentence for the operator; if the power may be on, it says what to do by hand."""
        if self.safe is None:
            return (
                f"{self.bench} is a simulation: there is nothing to switch off; a simulated run "
                "is stopped by Ctrl-C or SIGTERM"
            )
        return f"{self.bench}: {self.safe.message}"

    def record(self) -> dict[str, Any]:
        """Return the record for a result file."""
        return {
            "schema": SCHEMA,
            "created": utc_now().isoformat(timespec="seconds"),
            "versions": versions(),
            "inputs": [{"file": str(self.file), "sha256": sha256_file(self.file)}],
            "bench": self.bench,
            "real": not self.simulated,
            "proved": self.proved,
            "safe": None if self.safe is None else self.safe.record(),
            "users": [
                {"pid": user.pid, "command": user.command, "ended": user.ended}
                for user in self.users
            ],
            "attempts": self.attempts,
            "message": self.message,
            "seconds": self.seconds,
        }


def make_off(
    document: Document[Bench],
    say: Callable[[str], None] = lambda words: None,
    clock: Clock | None = None,
    processes: Processes | None = None,
    patience_s: float = PATIENCE_S,
    give_up: Callable[[], bool] = lambda: False,
) -> Off:
    """Make a bench safe: end the programs that use it, stop the drive, and prove that it is off.

    The function raises no error because of a device: a drive that cannot be reached is a result. It
    takes up to the sum of the times of this module, and may be called from any thread.

    Args:
        document: The bench.
        say: Called with a text on each step that takes time.
        clock: Clock of this computer.
        processes: The processes of this computer.
        patience_s: Time for attempts to reach a drive that does not answer, s.
        give_up: Whether to end after the present attempt, without waiting for the end of a ramp.

    Raises:
        InputError: The bench has no bus, or its drive has no EDS or DBC file.
    """
    clock, bench = clock or RealClock(), document.value
    began_ns = clock.now_ns()
    if bench.bus is None:
        raise InputError(document.problem(("bus",), NO_BUS))
    if bench.simulated:
        return Off(bench.name, document.path, True, None, (), 0, 0.0)
    bare = bare_bench(document)
    link, servo, encoder = bare.link, bare.servo, bare.encoder
    limits = bench_limits(bench)
    others = _Others(bench, say, clock, processes or Processes())
    with others.ended() as users:
        say(f"{bench.name}: quick stop, power off, proof that the drive is off")
        try:
            deed = stop(
                servo,
                link.clock,
                bare.open,
                watched=link.has_watchdog,
                patience_s=patience_s,
                off=OffProof(servo, link.clock, encoder, limits.speed, limits.current),
                failed=lambda deed: (
                    say(f"{bench.name}: {deed.safe.message}; trying for {patience_s:g} s")
                    if deed.attempts == 1
                    else None
                ),
                give_up=give_up,
            )
        finally:
            bare.close()
    seconds = (clock.now_ns() - began_ns) / NS
    safe = deed.safe if encoder else dataclasses.replace(deed.safe, joint_read=False)
    return Off(bench.name, document.path, False, safe, users, deed.attempts, seconds)


def given_up(document: Document[Bench], seconds: float) -> Off:
    """Return the result of a :func:`make_off` that the operator ended before its result."""
    doubt = "the operator ended `rig off` before the drive was proved off"
    safe = SafeState(False, "unknown", doubt=doubt)
    return Off(document.value.name, document.path, False, safe, (), 0, seconds)


class _Others:
    def __init__(
        self, bench: Bench, say: Callable[[str], None], clock: Clock, processes: Processes
    ) -> None:
        self._bench, self._say, self._clock, self._processes = bench, say, clock, processes
        self._parts = bus_resources(bench)
        self._files = lock_files(self._parts)

    @contextmanager
    def ended(self) -> Iterator[tuple[User, ...]]:
        users = tuple(self._end_all())
        with self._lock(HOLD_S if all(user.ended != "stays" for user in users) else 0.0):
            yield users

    def _lock(self, patience_s: float) -> Lock:
        """Hold the bench, which a killed program or another `rig off` may hold a moment longer."""
        deadline_ns = self._clock.now_ns() + round(patience_s * NS)
        while True:
            try:
                return hold_bench(self._bench.name, self._parts, "rig off")
            except (InUseError, StorageError) as error:
                now_ns = self._clock.now_ns()
                if now_ns >= deadline_ns or isinstance(error, StorageError):
                    self._say(
                        f"{error}; `rig off` acts all the same: two programs may be on the line"
                    )
                    return Lock()
            self._clock.sleep_until_ns(min(deadline_ns, now_ns + _LOOK_NS))

    def _end_all(self) -> Iterator[User]:
        """Programs first: a guardian acts when its program is gone, and leaves by itself."""
        seen = {number: self._processes.command(number) for number in self._using()}
        guardians = {number for number, command in seen.items() if MODULE in command.split()}
        for number in set(seen) - guardians:
            name = self._name(number) or seen[number]
            yield User(number, name, self._end(number, name, signal.SIGTERM, RELEASE_S, "stopped"))
        if set(seen) - guardians:
            self._gone({g for g in guardians if not self._processes.frozen(g)}, KILLED_S)
        for number in guardians & set(self._using()):
            name = "the guardian of a drive"
            yield User(number, name, self._end(number, name, HAND_OVER, HANDOVER_S, "handed over"))

    def _name(self, number: int) -> str:
        """Return the name under which a process has locked the bench; empty if there is none."""
        for file in self._files:
            with suppress(OSError):
                holder = Holder.parse(file.read_bytes())
                if holder is not None and holder.pid == number:
                    return holder.command
        return ""

    def _end(
        self, number: int, name: str, ask: signal.Signals, patience_s: float, ended: str
    ) -> str:
        who = f"{self._bench.name} is used by {name} (process {number})"
        if self._processes.frozen(number):
            self._say(f"{who}, which is suspended: it is killed")
        else:
            self._say(f"{who}, which is asked to leave the bench within {patience_s:g} s")
            self._processes.send(number, ask)
            if self._gone({number}, patience_s):
                return ended
            self._say(f"process {number} did not leave the bench: it is killed")
        self._processes.send(number, signal.SIGKILL)
        if self._gone({number}, KILLED_S):
            return "killed"
        self._say(f"process {number} cannot be ended")
        return "stays"

    def _gone(self, numbers: set[int], patience_s: float) -> bool:
        deadline_ns = self._clock.now_ns() + round(patience_s * NS)
        while numbers & set(self._using()):
            now_ns = self._clock.now_ns()
            if now_ns >= deadline_ns:
                return False
            self._clock.sleep_until_ns(min(deadline_ns, now_ns + _LOOK_NS))
        return True

    def _using(self) -> list[int]:
        return self._processes.using(self._files)
