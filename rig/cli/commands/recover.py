"""``rig recover``: repairs a run whose writer died."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.aftermath import seal_folder, write_page
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.locks import hold_folder
from rig.common.places import require_file, write_asked
from rig.common.tables import table
from rig.results.run.go_on import go_on_words
from rig.results.run.report import REPORT_FILE
from rig.runs.recover import damaged_name, mend
from rig.wiring.devices import until_the_end


@click.command("recover")
@click.argument("run", type=click.Path(path_type=Path))
@shared.record_file("Also write the completed run.json to this file.")
def recover(run: Path, json_file: Path | None) -> int:
    """Write a clean recording of RUN from all readable records of the damaged recording, and
    complete run.json and the page of the run.

    The damaged file is kept next to the clean file. A complete run is not changed; only a missing
    page is written.

    \b
    Example:
      rig recover runs/20261120T101500Z-figure10
    """
    require_file(json_file, "--json")
    until_the_end(hold_folder(run, "rig recover"))
    try:
        recovery = mend(run)
    except OSError as error:
        raise InputError(f"{run}: cannot be written: {error.strerror}") from error
    if not recovery.damage:
        click.echo(f"recording complete: {recovery.samples} samples")
    for problem in recovery.damage:
        kept = damaged_name(problem.partition(":")[0])
        click.echo(f"{problem}; the damaged file is kept as {kept}")
    rows = [[s.name, s.stage, f"{s.weight_kg:g}", s.state] for s in recovery.record.stages]
    click.echo(table(["stage", "load", "weight kg", "state"], rows, right=[2]))
    if words := go_on_words(recovery.record, run):
        click.echo(words)
    if recovery.changed or not (run / REPORT_FILE).exists():
        write_page(run, recovery.record, lambda words, good: click.echo(words, err=not good))
    if recovery.changed:
        seal_folder(run, recovery.record, lambda words, good: click.echo(words, err=not good))
    write_asked(json_file, dataclasses.asdict(recovery.record))
    return DONE
