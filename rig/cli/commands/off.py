"""``rig off``: makes a bench safe, whoever uses it."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.entry import DEVICE_FAILED, DONE
from rig.common.places import require_file, write_asked
from rig.config.bench import load_bench
from rig.control.off import make_off
from rig.terminal.screen import Screen
from rig.wiring.bench_text import bench_line


@click.command("off")
@click.argument("bench")
@shared.record_file("Also write the result to this file.")
def command(bench: str, json_file: Path | None) -> int:
    """Make BENCH safe, whoever uses it and whatever has died: brake, take the power off, and prove
    by state, current and motion that the drive is off.

    A program that uses the bench is asked to stop. If it does not leave the bench within 5 s, or is
    suspended, it is killed; `rig recover` repairs its recording. A guardian that is still trying to
    stop the drive hands it over.

    The exit status is 0 if the drive is proved off, and 4 if it is not; the message then says what
    to do by hand. On a simulated bench there is nothing to switch off. `rig off` is not an
    emergency stop.

    \b
    Example:
      rig off practical
    """
    require_file(json_file, "--json")
    document = load_bench(bench)
    with closing(Screen()) as screen:
        screen.say(bench_line(document), err=False)
        done = make_off(document, screen.say)
        screen.say(done.message, err=not done.proved)
    write_asked(json_file, done.record())
    return DONE if done.proved else DEVICE_FAILED
