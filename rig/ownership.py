"""Locks in commands: kept until the command ends, and what was taken over is said."""

from __future__ import annotations

import click

from rig.locks import Lock


def until_the_end(lock: Lock) -> Lock:
    """Release a lock when the command that is being carried out has ended, however it ends."""
    click.get_current_context().with_resource(lock)
    say_taken_over(lock)
    return lock


def say_taken_over(lock: Lock | None) -> None:
    """Tell the operator where the last program that held a lock ended without releasing it."""
    if lock is not None and lock.taken_over is not None:
        click.echo(lock.taken_over, err=True)
