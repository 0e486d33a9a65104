"""Rejects a run whose weights nobody would confirm; opens the bench so that STOP interrupts it."""

from __future__ import annotations

import dataclasses
import select
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from drivers.clock import NS, Clock, RealClock
from rig.common.errors import InputError, InUseError
from rig.common.locks import lock_files
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.planning.plan import Plan
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.connect import Attach, connect, resources
from rig.wiring.devices import Devices

T = TypeVar("T")
_INHIBIT: Final = ("systemd-inhibit", "--what=sleep:idle:handle-lid-switch", "--who=rig")
_LOOK_NS: Final = NS // 2  # time between two attempts to use a bench that another program uses
_INHIBIT_S: Final = 2.0  # time, s, in which the system must have accepted the request to stay awake


def require_attendance(plan: Plan, bench: Document[Bench], yes: bool, terminal: bool) -> None:
    """Reject (InputError) a run that hangs weights on a real bench if nobody would confirm them."""
    value = bench.value
    heavy = [stage.name for stage in plan.stages if stage.weight_kg]
    if value.simulated or not heavy or value.weights_hung_by == "hoist" or (terminal and not yes):
        return
    reason = (
        "--yes would answer the weight prompts" if yes else "there is no terminal for the prompts"
    )
    raise InputError(
        f"{bench.path}: {reason}, but stages {', '.join(heavy)} have weights, which a person hangs "
        "on this bench: run at a terminal without --yes; only if a hoist hangs the weights and "
        "reports their mass, set `weights_hung_by: hoist`"
    )


def when_free(
    attempt: Callable[[], T],
    wait_s: float,
    say: Callable[[str], None],
    clock: Clock,
    files: Iterable[Path] = (),
) -> T:
    """Return the result of an attempt to use a bench; repeat the attempt for ``wait_s`` while
    another program uses the bench. Of several programs that wait, any may be the next.

    A program that waits has the lock ``files`` of the bench open, without a lock, so that `rig off`
    ends it with the others; otherwise it would energise a bench that was just made safe.

    Raises:
        InUseError: The bench is still in use.
    """
    deadline_ns = clock.now_ns() + round(wait_s * NS)
    with ExitStack() as seen:
        waits = False
        while True:
            try:
                return attempt()
            except InUseError as error:
                now_ns = clock.now_ns()
                if now_ns >= deadline_ns:
                    raise
                if not waits:
                    waits = True
                    say(f"waiting up to {wait_s:g} s: {error}")
                    for file in files:
                        with suppress(OSError):
                            seen.enter_context(open(file, "rb"))
            clock.sleep_until_ns(min(now_ns + _LOOK_NS, deadline_ns))


@contextmanager
def connected(
    stop: StopButton,
    document: Document[Bench],
    seed: int,
    realtime: bool,
    attach: Attach | None = None,
    torque_offset: bool = False,
    purpose: str = "rig",
    wait_s: float = 0.0,
    say: Callable[[str], None] = lambda words: None,
) -> Iterator[Devices]:
    """Open a bench with :func:`rig.wiring.connect.connect`, so that a stop signal interrupts it.

    The computer of a real bench is kept awake, where this is possible. ``wait_s``: see
    :func:`when_free`.
    """
    opened = partial(connect, document, seed, realtime, attach, torque_offset, purpose)
    files = lock_files(resources(document.value))
    with ExitStack() as stack:

        def attempt() -> Devices:
            stop.check()  # answers the console, and takes its STOP
            return stack.enter_context(opened())

        try:
            with stop.interruptible():
                devices = when_free(attempt, wait_s, say, RealClock(), files)
                if not document.value.simulated:
                    why = stack.enter_context(kept_awake(purpose))
                    devices = dataclasses.replace(devices, awake=why)
        except OperatorStopError as error:
            raise KeyboardInterrupt from error  # as a stop signal
        yield devices


@contextmanager
def kept_awake(purpose: str) -> Iterator[str]:
    """Ask the system not to sleep; yields the reason if this is impossible, empty if it stays
    awake.

    The request ends with this program, however it ends, because the input of the process that holds
    it ends.
    """
    held = (sys.executable, "-c", "print(flush=True); import sys; sys.stdin.read()")
    with ExitStack() as stack:
        try:
            process = stack.enter_context(
                subprocess.Popen(
                    [*_INHIBIT, f"--why={purpose} drives a bench", *held],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
        except OSError:
            yield f"{_INHIBIT[0]} is not installed"
            return
        assert process.stdout is not None
        stack.callback(process.kill)
        ready = select.select([process.stdout], [], [], _INHIBIT_S)[0]
        yield "" if ready and process.stdout.readline() else f"{_INHIBIT[0]} is refused"
