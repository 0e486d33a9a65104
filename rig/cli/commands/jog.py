"""``rig jog``: moves a bench by hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.aftermath import status_of
from rig.cli.crash import note_drive
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.places import require_file, write_asked
from rig.common.provenance import utc_now
from rig.config.bench import Bench, load_bench
from rig.control.attendance import connected
from rig.control.jog import Jog, held_only_here, move, plan_jog
from rig.control.remote import RunProgress, stoppable
from rig.control.sequencer import Outcome
from rig.planning.plan import bench_limits
from rig.runs.run_record import Ending
from rig.terminal.prompt import InputEndedError, Prompt, at_terminal
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.devices import Devices, say_taken_over, unprotected
from rig.wiring.preflight import require_startable
from rig.wiring.teardown import observed

SCHEMA = "loadrig.jog/1"


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
    "--speed",
    type=shared.Number(),
    default=5.0,
    show_default=True,
    help="Greatest speed on the way, deg/s.",
)
@click.option("--realtime", is_flag=True, help="Run the simulated bench in real time.")
@shared.simulated_seed
@shared.reset_fault()
@shared.record_file("Also write the outcome to this file.")
def command(
    bench: str,
    angles: tuple[float, ...],
    speed: float,
    realtime: bool,
    seed: int,
    reset_fault: bool,
    json_file: Path | None,
) -> int:
    """Move BENCH to joint angles, slowly and at low limits; the drive is de-energised before and
    after each move.

    Without --to, the program asks for one angle after another, with the drive off in between; an
    empty answer ends the command. Nothing is recorded. Ctrl-C brakes and takes the power off; a
    second Ctrl-C during braking takes the power off without waiting.

    \b
    Example:
      rig jog practical --to 10 --to 0 --speed 5
    """
    require_file(json_file, "--json")
    document = load_bench(bench)
    plan_jog(document.value, angles, speed)
    require_startable(document, utc_now().date(), lambda words: click.echo(words, err=True))
    screen = Screen()
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
                jog = plan_jog(document.value, batch, speed)
            except InputError as error:
                screen.say(str(error))
                continue
            if not agreed and (words := held_only_here(jog, document.value, devices)) is not None:
                screen.say(words)
                agreed = _agreed(prompt, stop, screen, document.value.simulated)
                if not agreed:
                    outcome = _unmoved(devices, document.value)
                    break
            outcome = _move(document.value, jog, devices, stop, screen, reset_fault)
            if outcome.ending is not Ending.DONE:
                break
    write_asked(json_file, _record(bench, outcome))
    if outcome is not None and outcome.error is not None:
        note_drive(outcome.error, outcome.safe.message)
        raise outcome.error
    return DONE if outcome is None else status_of(outcome)


def _asked(prompt: Prompt, stop: StopButton, screen: Screen) -> Iterator[tuple[float, ...]]:
    """Yield the angles typed at the terminal until an empty answer or the end of the input.

    Raises:
        KeyboardInterrupt: The operator stopped the command at the prompt; the drive is off.
    """
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
    """Ask whether to move although only this program checks the limits; return True only for the
    answer yes.

    On a real bench only a person at a terminal can agree.

    Raises:
        KeyboardInterrupt: The operator stopped the command at the prompt; the drive is off.
    """
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


def _unmoved(devices: Devices, bench: Bench) -> Outcome:
    """Return the outcome of a jog that was not confirmed; nothing was commanded."""
    safe = observed(devices.off_proof(bench_limits(bench)).prove())
    return Outcome(Ending.STOPPED, "not confirmed; nothing was moved", safe)


def _move(
    bench: Bench, jog: Jog, devices: Devices, stop: StopButton, screen: Screen, reset_fault: bool
) -> Outcome:
    span = math.radians(bench.limits.angle_max_deg - bench.limits.angle_min_deg)
    return move(
        jog,
        bench,
        devices,
        stop,
        RunProgress(bench.cycle_s, len(jog.angles) * span / jog.speed, screen),
        lambda words, good: screen.say(words, err=not good),
        reset_fault,
    )


def _record(bench: str, outcome: Outcome | None) -> dict[str, object]:
    return {
        "schema": SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "bench": bench,
        "state": "done" if outcome is None else outcome.ending.value,
        "message": "no angle was given" if outcome is None else outcome.message,
        "de_energised": None if outcome is None else outcome.safe.verified,
        "drive": None if outcome is None else outcome.safe.record(),
    }
