"""`rig` with a witness, for harnesses: `python -m tests.long.witness ARGUMENTS` is the command,
told on from within.

Each phase of a run, as it begins, goes as a line of JSON to the file descriptor in ``WITNESS``. In
the phase named in ``WITNESS_GATE`` the run then waits, for a moment at most, for a byte on the
descriptor behind it, so that a harness can do its deed at the very beginning of a phase that takes
milliseconds.
"""

import dataclasses
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any

GATE_S = 0.1
HELD_S = 30.0
SLEPT_S = 5.0


def tell(**what: Any) -> None:
    """Write a line to the harness, if there is one."""
    if number := os.environ.get("WITNESS"):
        os.write(int(number), json.dumps({"ns": time.monotonic_ns(), **what}).encode() + b"\n")


def wait_at_gate(place: str, seconds: float) -> None:
    """Wait for the harness, where it asked for that."""
    wanted, _, number = os.environ.get("WITNESS_GATE", "").rpartition("@")
    if number and place == wanted and select.select([int(number)], [], [], seconds)[0]:
        os.read(int(number), 1)


def observed() -> None:
    """Have every run and resumption of this process told on."""
    session: Any = import_module("rig.control.session")
    plain = session.Sequencer

    def observe(stage: str, phase: Any) -> None:
        tell(stage=stage, phase=phase.value)
        wait_at_gate(f"{stage}/{phase.value}", GATE_S)

    def sequencer(plan: Any, devices: Any, *more: Any, **named: Any) -> Any:
        return plain(plan, dataclasses.replace(devices, observer=observe), *more, **named)

    session.Sequencer = sequencer
    sleeping()


def sleeping() -> None:
    """Let the computer of this process seem to have slept for :data:`SLEPT_S` at SIGUSR2: the clock
    since boot jumps, the monotonic clock does not.
    """
    clock: Any = import_module("drivers.clock")
    plain, slept = clock._boot_ns, []
    signal.signal(signal.SIGUSR2, lambda *_: slept.append(round(SLEPT_S * 1e9)))
    clock.Suspension.__init__.__defaults__ = (lambda: plain() + sum(slept), time.monotonic_ns)


def held(module: str, name: str, place: str) -> None:
    """Tell when a context manager of a command has been entered, and wait at the gate inside."""
    command: Any = import_module(module)
    plain: Callable[..., Any] = getattr(command, name)

    @contextmanager
    def entered(*words: Any, **named: Any) -> Iterator[Any]:
        with plain(*words, **named) as inside:
            tell(phase=place)
            wait_at_gate(place, HELD_S)
            yield inside

    setattr(command, name, entered)


def held_call(module: str, name: str, place: str) -> None:
    """Tell when a function is called, and wait at the gate before it."""
    command: Any = import_module(module)
    plain: Callable[..., Any] = getattr(command, name)

    def called(*words: Any, **named: Any) -> Any:
        tell(phase=place)
        wait_at_gate(place, HELD_S)
        return plain(*words, **named)

    setattr(command, name, called)


WATCHED: Mapping[str, Callable[[], None]] = {
    "run": observed,
    "resume": observed,
    "jog": lambda: held("rig.cli.commands.bench", "connected", "connected"),
    "check": lambda: held("rig.cli.commands.bench", "connect", "connected"),
    "recover": lambda: held_call("rig.runs.recover", "read_log", "reading"),
}
"""Command to what of it is told."""


def main() -> None:
    """Be `rig`."""
    from rig.cli import entry as cli

    WATCHED.get(sys.argv[1], lambda: None)()
    if "WITNESS_READY" in os.environ:
        for name in WATCHED:
            import_module(f"rig.cli.commands.{cli.COMMANDS[name][0]}")
        tell(phase="ready")
        wait_at_gate("ready", HELD_S)
    cli.main()


if __name__ == "__main__":
    main()
