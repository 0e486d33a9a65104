"""``rig off``: makes a bench safe, whoever uses it."""

from __future__ import annotations

import time
from contextlib import closing, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

import click

from rig.cli import options as shared
from rig.cli.entry import DEVICE_FAILED, DONE
from rig.common.places import require_file, write_asked
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.control.off import Off, given_up, make_off
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.devices import bench_line

ENDS_S: Final = 0.7
"""Time for the present attempt after the second Ctrl-C, s."""
GOES_ON: Final = (
    "the drive is NOT proved off yet: `rig off` goes on taking the power off; a second Ctrl-C ends "
    "`rig off` without this proof"
)
_LOOK_S: Final = 0.05


@click.command("off")
@click.argument("bench")
@shared.record_file("Also write the result to this file.")
def command(bench: str, json_file: Path | None) -> int:
    """Make BENCH safe, whoever uses it and whatever has died: brake, take the power off, and prove
    by state, current and motion that the drive is off.

    A program that uses the bench is asked to stop. If it does not leave the bench within 5 s, or is
    suspended, it is killed; `rig recover` repairs its recording. A guardian that is still trying to
    stop the drive hands it over.

    After one Ctrl-C the command goes on, because the drive is not proved off; a second Ctrl-C ends
    it within 1 s, with status 4 unless the drive is proved off by then.

    The exit status is 0 if the drive is proved off, and 4 if it is not; the message then says what
    to do by hand. On a simulated bench there is nothing to switch off. `rig off` is not an
    emergency stop.

    \b
    Example:
      rig off practical
    """
    require_file(json_file, "--json")
    document = load_bench(bench)
    with closing(Screen()) as screen, StopButton() as stop:
        screen.say(bench_line(document), err=False)
        done = _interruptible(document, screen, stop)
        screen.say(done.message, err=not done.proved)
    write_asked(json_file, done.record())
    return DONE if done.proved else DEVICE_FAILED


def _interruptible(document: Document[Bench], screen: Screen, stop: StopButton) -> Off:
    """Make the bench safe in a thread of its own, so that an attempt on a dead line delays neither
    the answer to a Ctrl-C nor the end after a second one.
    """
    said: SimpleQueue[str] = SimpleQueue()
    found: list[Off] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            found.append(make_off(document, said.put, give_up=lambda: stop.presses > 1))
        except BaseException as error:  # noqa: BLE001 - raised again in the main thread
            failed.append(error)

    worker = Thread(target=work, daemon=True)
    began_s = time.monotonic()
    worker.start()
    answered, ended_s = False, None
    while worker.is_alive() and (ended_s is None or time.monotonic() - ended_s < ENDS_S):
        with suppress(Empty):
            screen.say(said.get(timeout=_LOOK_S))
        if stop.pressed and not answered:
            screen.say(GOES_ON)
            answered = True
        if stop.presses > 1 and ended_s is None:
            ended_s = time.monotonic()
    while not said.empty():
        screen.say(said.get())
    for error in failed:
        raise error
    return found[0] if found else given_up(document, time.monotonic() - began_s)
