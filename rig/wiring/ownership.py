"""Releases locks when a command ends, and reports locks taken over from a dead program."""

from __future__ import annotations

import click

from rig.common.locks import Lock
from rig.terminal.screen import Screen


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
