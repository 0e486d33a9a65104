"""The steps after ``rig run`` and ``rig resume``: label check, page, seal, status."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from identification.recording import Dataset
from rig.cli.crash import note_drive
from rig.cli.entry import BAD_VERDICT, CRASHED, DEVICE_FAILED, DONE, STOPPED
from rig.common.errors import StorageError
from rig.common.places import write_asked
from rig.common.tables import table
from rig.common.timing import summary
from rig.control.sequencer import Outcome
from rig.planning.reference import Reference
from rig.results.run.go_on import go_on_words
from rig.results.run.report import write_run_report
from rig.runs.run import RunFolder, load_run
from rig.runs.run_file import SEAL_FILE, seal_run
from rig.runs.run_record import Ending, RunRecord
from rig.terminal.output import complain, reader_gone
from rig.terminal.screen import Screen
from rig.weighing.load_change import changed_loads
from rig.weighing.weight_check import comparable, off_label

STATUS: Mapping[Ending, int] = {
    Ending.DONE: DONE,
    Ending.TRIPPED: BAD_VERDICT,
    Ending.STOPPED: STOPPED,
    Ending.FAILED: DEVICE_FAILED,
    Ending.CRASHED: CRASHED,
}


def status_of(outcome: Outcome) -> int:
    """Return the exit status; 4 if the drive was not proved off, unless the program broke."""
    status = STATUS[outcome.ending]
    return status if outcome.safe.verified or status == CRASHED else DEVICE_FAILED


def conclude(
    folder: RunFolder,
    outcome: Outcome,
    reference: Reference | None,
    json_file: Path | None,
    screen: Screen,
) -> int:
    """Check the mass labels, inform the operator, write the run page, and return the exit status.

    The outcome has been shown and recorded before, so that no failure in this function can hide the
    outcome. Messages are shown before the page is drawn, because the drawing may be slow or fail.
    """
    record = folder.record
    gone = not folder.recording.exists()
    wrong = _check_labels(folder, reference) if outcome.ending is Ending.DONE and not gone else 0
    if wrong:
        # The run has ended, and the warnings are shown even if they cannot be stored.
        with suppress(StorageError):
            folder.save()
    _tell(folder, screen, gone)
    screen.drain()
    if not gone:
        for deed in (write_page, seal_folder):
            deed(folder.path, record, lambda words, good: screen.say(words, err=not good))
        screen.drain()
    write_asked(json_file, dataclasses.asdict(record))
    if outcome.error is not None:
        note_drive(outcome.error, outcome.safe.message)
        raise outcome.error
    status = BAD_VERDICT if wrong else status_of(outcome)
    if (
        status == DONE
        and screen.trouble is not None
        and not reader_gone(screen.trouble, terminal=screen.terminal)
    ):
        complain(f"storage error: the output cannot be written: {screen.trouble.strerror}")
        return DEVICE_FAILED
    return status


def _check_labels(folder: RunFolder, reference: Reference | None) -> int:
    """Record the stages with another load than planned or stated; return their number."""
    record = folder.record
    if not any(stage.stage == "loaded" for stage in record.stages) and reference is None:
        return 0
    dataset = load_run(folder.path)
    changed = changed_loads(dataset, [stage.name for stage in record.stages], reference)
    for stage in record.stages:
        if stage.name in changed:
            stage.load_change_kg = changed[stage.name][0].mass_kg
    kept = (r for r in dataset.recordings if r.name.partition("[")[0] not in changed)
    steady = Dataset(tuple(kept))
    found = [weighing for _, weighing in changed.values()]
    if comparable(steady, reference):
        found += off_label(steady, reference)
    for weighing in found:
        folder.weighed(weighing)
        record.warnings.append(weighing.message)
    return len(found)


def _tell(folder: RunFolder, screen: Screen, gone: bool) -> None:
    record = folder.record
    rows = [[s.name, s.stage, f"{s.weight_kg:g}", s.outcome] for s in record.stages]
    screen.say(table(["stage", "load", "weight kg", "state"], rows, right=[2]), err=False)
    part = record.parts[-1]
    clock = "in simulated time: " if record.simulated and not record.realtime else ""
    screen.say(
        f"{part.cycles} cycles; {'no longer in' if gone else 'recorded in'} {folder.recording}\n"
        f"{clock}{summary(part.timing)}",
        err=False,
    )
    for warning in record.warnings:
        if warning not in folder.told:
            screen.say(f"warning: {warning}")
    if not gone and (words := go_on_words(record, folder.path)):
        screen.say(words)


def seal_folder(folder: Path, record: RunRecord, say: Callable[[str, bool], None]) -> None:
    """Write the digests of the run's record and recordings, or print the reason why that is not
    possible.

    This function never raises an exception.
    """
    try:
        seal_run(folder, record)
    except (OSError, UnicodeError) as error:
        say(f"{folder}: {SEAL_FILE} cannot be written: {error}", False)
    except KeyboardInterrupt:
        say(f"{folder}: {SEAL_FILE} is not written; `sha256sum -c` has no digests", False)


def write_page(folder: Path, record: RunRecord, say: Callable[[str, bool], None]) -> None:
    """Write the run page and print its path, or the reason why it cannot be written.

    This function never raises an exception.
    """
    try:
        say(f"page: {write_run_report(folder, record)}", True)
    except OSError as error:
        say(f"{folder}: the page of the run cannot be written: {error.strerror}", False)
    except KeyboardInterrupt:
        again = f"rig recover {shlex.quote(str(folder))}"
        say(f"{folder}: the page of the run is not finished; `{again}` writes it", False)
