"""Rejects a run whose weights no person would confirm, opens the bench so that a stop signal
interrupts the opening, and carries a run out with operator, screen and control socket.
"""

from __future__ import annotations

import dataclasses
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Final

from rig.common.errors import InputError
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.control.operator import operator_for
from rig.control.remote import RunProgress, observed, reachable
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.planning.plan import Plan
from rig.runs.run import RunFolder
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import Attach, connect
from rig.wiring.devices import Devices, say_taken_over

_INHIBIT: Final = ("systemd-inhibit", "--what=sleep:idle:handle-lid-switch", "--who=rig")
_INHIBIT_S: Final = 2.0
"""Time, s, in which the system must have accepted the request to stay awake."""


def require_attendance(plan: Plan, bench: Document[Bench], yes: bool, terminal: bool) -> None:
    """Reject a run that hangs weights on a real bench if no person would confirm their mass.

    Args:
        plan: The planned run.
        bench: The bench of the run.
        yes: Whether the program answers prompts with the planned mass (``--yes``).
        terminal: Whether a person can be asked.

    Raises:
        InputError: The run hangs weights on a real bench, and no person would be asked.
    """
    value = bench.value
    heavy = [stage.name for stage in plan.stages if stage.weight_kg]
    if value.simulated or not heavy or value.weights_hung_by == "hoist" or (terminal and not yes):
        return
    reason = (
        "--yes would answer the weight prompts" if yes else "there is no terminal for the prompts"
    )
    raise InputError(
        f"{bench.path}: {reason}, but stages {', '.join(heavy)} have weights, which a person hangs "
        f"on this bench: "
        "run at a terminal without --yes; only if a hoist hangs the weights and reports their "
        "mass, set `weights_hung_by: hoist`"
    )


@contextmanager
def connected(
    stop: StopButton,
    document: Document[Bench],
    seed: int,
    realtime: bool,
    attach: Attach | None = None,
    torque_offset: bool = False,
    purpose: str = "rig",
) -> Iterator[Devices]:
    """Open a bench with :func:`rig.wiring.connect.connect`; a stop signal interrupts the opening,
    because no drive is energised yet. The computer of a real bench is kept awake, where this is
    possible.

    Raises:
        KeyboardInterrupt: The operator stopped the opening.
    """
    with ExitStack() as stack:
        with stop.interruptible():
            devices = stack.enter_context(
                connect(document, seed, realtime, attach, torque_offset, purpose)
            )
            if not document.value.simulated:
                why = stack.enter_context(kept_awake(purpose))
                devices = dataclasses.replace(devices, awake=why)
        yield devices


@contextmanager
def kept_awake(purpose: str) -> Iterator[str]:
    """Ask the system not to sleep, neither when it is idle nor when its lid is closed.

    Yields the reason if this is impossible; empty if the system stays awake. The request ends with
    this program, however it ends, because the input of the process that holds it ends.
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


def carry_out(
    inputs: Inputs,
    plan: Plan,
    path: Path,
    purpose: str,
    *,
    yes: bool,
    in_console: bool,
    left_s: float,
    patience_s: float | None,
    conclude: Callable[[RunFolder, Outcome, Screen], int],
    begin: Callable[[], object] = lambda: None,
    attach: Attach | None = None,
    run: Callable[..., tuple[RunFolder, Outcome]] = execute,
) -> int:
    """Connect, run into a folder, and report the outcome; return the exit status.

    Args:
        inputs: The inputs of the run.
        plan: The plan computed from the inputs.
        path: The run folder.
        purpose: The command, for the message to other users of the bench.
        yes: Whether the program answers the prompts with the plan.
        in_console: Whether the prompts can only be answered in ``rig console``.
        left_s: Expected time in motion, s.
        patience_s: Longest wait for an answer, s, or None for no time-out.
        conclude: Reports the outcome, and returns the exit status.
        begin: Called when the bench is connected.
        attach: See :func:`rig.wiring.connect.connect`.
        run: Runs as :func:`rig.control.session.execute` does.

    Raises:
        KeyboardInterrupt: The operator stopped the opening of the bench.
    """
    bench, screen = inputs.bench, Screen()
    screen.silence()
    with (
        closing(screen),
        StopButton(screen.say) as stop,
        reachable(stop, screen, inputs, plan, path, in_console) as control,
    ):
        offset = inputs.feedforward is not None
        with connected(
            stop, bench, inputs.seed, inputs.realtime, attach, offset, purpose
        ) as devices:
            say_taken_over(devices.lock, screen)
            begin()
            tolerance = bench.value.weight_tolerance
            operator = operator_for(yes, screen, patience_s, tolerance, control, in_console)
            progress = RunProgress(plan.cycle_s, left_s, screen)
            devices = observed(devices, control, progress)
            folder, outcome = run(inputs, plan, devices, path, operator, stop, progress)
        return conclude(folder, outcome, screen)
