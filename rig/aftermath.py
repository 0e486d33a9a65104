"""What is done and said once a run has ended, by ``rig run`` and ``rig resume`` alike."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import click

from rig.cli import BAD_VERDICT, DEVICE_FAILED, DONE, STOPPED
from rig.go_on import go_on_words
from rig.label_check import comparable, off_label
from rig.places import write_asked
from rig.reference import Reference
from rig.run import RunFolder, load_run
from rig.run_record import RunRecord
from rig.run_report import write_run_report
from rig.sequencer import Ending, Outcome
from rig.tables import table
from rig.timing import summary

STATUS: Mapping[Ending, int] = {
    Ending.DONE: DONE,
    Ending.TRIPPED: BAD_VERDICT,
    Ending.STOPPED: STOPPED,
    Ending.FAILED: DEVICE_FAILED,
}


def conclude(folder: RunFolder, outcome: Outcome, reference: Reference | None, json_file: Path | None) -> int:
    """Check the labels, tell the operator, write the page of the run, and return the exit status.

    What the operator must know is told before the page is drawn, which may take its time and may fail.

    Raises:
        InputError: ``json_file`` cannot be written.
    """
    record = folder.record
    wrong = _check_labels(folder, reference) if outcome.ending is Ending.DONE else 0
    if wrong:
        with suppress(OSError):  # The warnings are told all the same, and the run has ended.
            folder.save()
    _tell(folder, outcome)
    write_page(folder.path, record)
    write_asked(json_file, dataclasses.asdict(record))
    return BAD_VERDICT if wrong else STATUS[outcome.ending]


def _check_labels(folder: RunFolder, reference: Reference | None) -> int:
    """Note the stages whose mass is not their label; returns how many."""
    record = folder.record
    if reference is None and not _worth_reading(record):
        return 0
    dataset = load_run(folder.path)
    if not comparable(dataset, reference):
        return 0
    found = off_label(dataset, reference)
    for weighing in found:
        folder.weighed(weighing)
        record.warnings.append(weighing.message)
    return len(found)


def _worth_reading(record: RunRecord) -> bool:
    masses = [stage.weight_kg for stage in record.stages]
    return len(set(masses)) >= 2 and sum(mass > 0 for mass in masses) >= 2


def _tell(folder: RunFolder, outcome: Outcome) -> None:
    record = folder.record
    rows = [[s.name, s.stage, f"{s.weight_kg:g}", s.state] for s in record.stages]
    click.echo(table(["stage", "load", "weight kg", "state"], rows, right=[2]))
    part = record.parts[-1]
    click.echo(f"{part.cycles} cycles; recorded in {folder.recording}")
    click.echo(summary(part.timing))
    for warning in record.warnings:
        click.echo(f"warning: {warning}", err=True)
    click.echo(f"{outcome.ending.value}: {outcome.message}", err=outcome.ending is not Ending.DONE)
    if words := go_on_words(record, folder.path):
        click.echo(words, err=True)


def write_page(folder: Path, record: RunRecord) -> None:
    """Write the page of a run and say where it is; where it cannot be written, say that. Never raises."""
    try:
        click.echo(f"page: {write_run_report(folder, record)}")
    except OSError as error:
        click.echo(f"{folder}: the page of the run cannot be written: {error.strerror}", err=True)
    except KeyboardInterrupt:
        again = f"rig recover {shlex.quote(str(folder))}"
        click.echo(f"{folder}: the page of the run is not finished; `{again}` writes it", err=True)
