"""``rig check``, ``rig off`` and ``rig jog``: read a bench, make it safe, move it by hand."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

import click

from rig.cli import options as shared
from rig.cli.aftermath import status_of
from rig.cli.crash import note_drive
from rig.cli.entry import BAD_VERDICT, DEVICE_FAILED, DONE
from rig.common.errors import Cause, InputError
from rig.common.places import write_asked
from rig.common.provenance import utc_now
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.control.attendance import connected
from rig.control.check import describe, examine, require_connectable
from rig.control.jog import held_only_here, move, plan_jog
from rig.control.off import Off, given_up, make_off
from rig.control.remote import RunProgress, stoppable
from rig.control.sequencer import Outcome
from rig.planning.plan import bench_limits
from rig.runs.run_record import Ending
from rig.terminal.prompt import InputEndedError, Prompt, at_terminal
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.connect import connect
from rig.wiring.devices import bench_line, say_taken_over, unprotected, watcher
from rig.wiring.preflight import require_startable
from rig.wiring.teardown import observed

JOG_SCHEMA = "loadrig.jog/1"


ENDS_S: Final = 0.7  # time for the present attempt after the second Ctrl-C, s
GOES_ON: Final = (
    "the drive is NOT proved off yet: `rig off` goes on taking the power off; a second Ctrl-C ends "
    "`rig off` without this proof"
)
_LOOK_S: Final = 0.05


@click.command("check")
@click.argument("bench")
@shared.simulated_seed
@shared.record_file("Also write the findings to this file.")
def check(bench: str, seed: int, json_file: Path | None) -> int:
    """Connect to BENCH, and read identities, live values, state and limits.

    Nothing moves, nothing is energised, and no value is written to a device.

    The exit status is 1 if `rig run` would refuse to start on this bench; the reasons are printed:
    a limit looser than the drive's own limit, units that differ between file and device, a
    calibration that is overdue and must not be, implausible constants, a drive that is energised or
    in fault, or a reading beyond its limit. If the drive reports off, but current flows or the
    joint moves, the exit status is 4. If the connection to the bench fails, it is 2 or 4.

    \b
    Example:
      rig check practical
    """
    document = load_bench(bench)
    click.echo(bench_line(document))
    found = require_connectable(document)
    with connect(document, seed, realtime=False, purpose="rig check") as devices:
        say_taken_over(devices.lock)
        findings, readings = examine(document, devices, seed, found)
        watching = watcher(devices)
    click.echo(describe(findings, readings, watching))
    write_asked(json_file, findings)
    if Cause.OFF.value in findings["causes"]:
        return DEVICE_FAILED
    return DONE if findings["good"] else BAD_VERDICT


@click.command("off")
@click.argument("bench")
@shared.record_file("Also write the result to this file.")
def off(bench: str, json_file: Path | None) -> int:
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
    document = load_bench(bench)
    with closing(Screen()) as screen, StopButton() as stop:
        screen.say(bench_line(document), err=False)
        done = _interruptible(document, screen, stop)
        screen.say(done.message, err=not done.proved)
    write_asked(json_file, done.record())
    return DONE if done.proved else DEVICE_FAILED


def _interruptible(document: Document[Bench], screen: Screen, stop: StopButton) -> Off:
    """Make the bench safe in a thread, so that a dead line does not delay the answer to Ctrl-C."""
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


@click.command("jog")
@click.argument("bench")
@click.option(
    "--to",
    "angles",
    type=shared.Number(),
    multiple=True,
    help="Joint angle, deg; may be given several times.",
)
@click.option(
    "--speed", type=shared.Number(), default=5.0, help="Greatest speed on the way, deg/s."
)
@shared.realtime
@shared.simulated_seed
@shared.reset_fault()
@shared.record_file("Also write the outcome to this file.")
def jog(
    bench: str,
    angles: tuple[float, ...],
    speed: float,
    realtime: bool,
    seed: int,
    reset_fault: bool,
    json_file: Path | None,
) -> int:
    """Move BENCH to joint angles, slowly and at low limits; the drive is off before the
    first and after the last move.

    Without --to, the program asks for one angle after another, with the drive off in between; an
    empty answer ends the command. Nothing is recorded. Ctrl-C brakes and takes the power off; a
    second Ctrl-C during braking takes the power off without waiting.

    \b
    Example:
      rig jog practical --to 10 --to 0 --speed 5
    """
    document = load_bench(bench)
    plan_jog(document.value, angles, speed)
    require_startable(document, utc_now().date(), lambda words: click.echo(words, err=True))
    screen, value = Screen(), document.value
    screen.silence()
    outcome = None
    agreed = False
    with (
        closing(screen),
        StopButton(screen.say) as stop,
        stoppable(stop, screen, document.value, "jog") as control,
        connected(stop, document, seed, realtime, purpose="rig jog") as devices,
    ):
        say_taken_over(devices.lock, screen)
        for warning in unprotected(devices):
            screen.say(warning)
        prompt = Prompt(screen, control=control)
        batches = [angles] if angles else _asked(prompt, stop, screen)
        for batch in batches:
            try:
                planned = plan_jog(value, batch, speed)
            except InputError as error:
                screen.say(str(error))
                continue
            words = None if agreed else held_only_here(planned, value, devices)
            if words is not None:
                screen.say(words)
                agreed = _agreed(prompt, stop, screen, value.simulated)
                if not agreed:
                    safe = observed(devices.off_proof(bench_limits(value)).prove())
                    outcome = Outcome(Ending.STOPPED, "not confirmed; nothing was moved", safe)
                    break
            span = math.radians(value.limits.angle_max_deg - value.limits.angle_min_deg)
            longest_s = len(planned.angles) * span / planned.speed
            outcome = move(
                planned,
                value,
                devices,
                stop,
                RunProgress(value.cycle_s, longest_s, screen),
                lambda words, good: screen.say(words, err=not good),
                reset_fault,
            )
            if outcome.ending is not Ending.DONE:
                break
    write_asked(json_file, _record(bench, outcome))
    if outcome is not None and outcome.error is not None:
        note_drive(outcome.error, outcome.safe.message)
        raise outcome.error
    return DONE if outcome is None else status_of(outcome)


def _asked(prompt: Prompt, stop: StopButton, screen: Screen) -> Iterator[tuple[float, ...]]:
    """Yield the angles typed at the terminal until an empty answer or the end of the input."""
    while True:
        try:
            with stop.interruptible():
                typed = prompt.ask("Joint angle, deg (empty to end): ")
        except InputEndedError:
            return
        except OperatorStopError as error:
            raise KeyboardInterrupt from error
        if not typed:
            return
        try:
            yield (float(typed.replace(",", ".")),)
        except ValueError:
            screen.say(f"{typed!r} is not an angle in degrees")


def _agreed(prompt: Prompt, stop: StopButton, screen: Screen, simulated: bool) -> bool:
    """Ask whether to move although only this program checks the limits."""
    if not (simulated or at_terminal()):
        screen.say("there is no terminal to ask at: run at a terminal")
        return False
    try:
        with stop.interruptible():
            answer = prompt.ask("Move under the limits of this program alone? yes or no [no]: ")
    except InputEndedError as error:
        screen.say(f"{error}: not confirmed")
        return False
    except OperatorStopError as error:
        raise KeyboardInterrupt from error
    return answer.lower() in ("y", "yes")


def _record(bench: str, outcome: Outcome | None) -> dict[str, object]:
    return {
        "schema": JOG_SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "bench": bench,
        "state": "done" if outcome is None else outcome.ending.value,
        "message": "no angle was given" if outcome is None else outcome.message,
        "de_energised": None if outcome is None else outcome.safe.verified,
        "drive": None if outcome is None else outcome.safe.record(),
    }
