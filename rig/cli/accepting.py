"""Judges a run against its acceptance limits: for ``rig runs accept``, and at the end of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.entry import BAD_VERDICT, DONE

if TYPE_CHECKING:
    from rig.config.acceptance import Limit
    from rig.results.acceptance.accept import Acceptance


def accept_run(
    folder: Path, limits: Sequence[Limit], source: str, junit_file: Path | None
) -> Acceptance:
    """Judge a run, print the outcome, and write the JUnit file if one is requested.

    Raises:
        InputError: The folder is no run, or a file cannot be written.
    """
    from rig.results.acceptance.accept import accept, acceptance_document, write_bytes
    from rig.results.terminal import text
    from rig.terminal.bar import ShareBar

    with ShareBar() as bar:
        found = accept(folder, limits, source, bar)
    if junit_file is not None:
        write_bytes(junit_file, found.junit)
    click.echo(text(acceptance_document(found)))
    return found


def accept_at_the_end(folder: Path, file: Path | None, junit_file: Path | None) -> int:
    """Judge a run that has just been completed; return the exit status.

    Nothing is judged where neither a file nor the sequence states limits.

    Raises:
        InputError: A file cannot be written.
    """
    from rig.results.acceptance.limits import limits_for, recorded_limits

    if file is None and not recorded_limits(folder):
        return DONE
    limits, source = limits_for(folder, file)
    click.echo(f"acceptance: {len(limits)} limits; this may take a minute")
    try:
        found = accept_run(folder, limits, source, junit_file)
    except KeyboardInterrupt:
        click.echo(f"not judged; judge the run with `rig runs accept {folder}`", err=True)
        raise
    return DONE if found.accepted else BAD_VERDICT
