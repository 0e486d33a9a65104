"""Performs the steps after a run has ended: label check, page, acceptance, status."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from identification.recording import Dataset
from rig.cli.crash import note_drive
from rig.cli.entry import BAD_VERDICT, CRASHED, DEVICE_FAILED, DONE, STOPPED
from rig.common.errors import InputError, StorageError
from rig.common.places import write_asked
from rig.common.tables import table
from rig.common.timing import summary
from rig.common.yaml_tree import DocumentError, parse
from rig.config.acceptance import Limit, limits_of
from rig.config.configuration import located_text, validated
from rig.config.sequence import AcceptanceFile, load_acceptance
from rig.config.sequence import Sequence as SequenceFile
from rig.control.sequencer import Outcome
from rig.planning.reference import Reference
from rig.results.run.go_on import go_on_words
from rig.results.run.report import write_run_report
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.recorded_inputs import GivenFile, recorded_acceptance
from rig.runs.run import RunFolder, load_run
from rig.runs.run_file import SEAL_FILE, read_record, seal_run
from rig.runs.run_record import RECORDING_FILE, SEQUENCE_ATTACHMENT, Ending, RunRecord
from rig.terminal.output import complain, reader_gone
from rig.terminal.screen import Screen
from rig.weighing.load_change import changed_loads
from rig.weighing.weight_check import comparable, off_label

if TYPE_CHECKING:
    from rig.results.acceptance.certificate import Acceptance

STATUS: Mapping[Ending, int] = {
    Ending.DONE: DONE,
    Ending.TRIPPED: BAD_VERDICT,
    Ending.STOPPED: STOPPED,
    Ending.FAILED: DEVICE_FAILED,
    Ending.CRASHED: CRASHED,
}


def status_of(outcome: Outcome) -> int:
    """Return the exit status of a run or jog; 4 if the drive was not proved off, unless the program
    itself broke down.
    """
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

    Raises:
        InputError: ``json_file`` cannot be written.
        BaseException: An unexpected exception during the run.
    """
    record = folder.record
    gone = not folder.recording.exists()
    wrong = _check_labels(folder, reference) if outcome.ending is Ending.DONE and not gone else 0
    if wrong:
        with suppress(
            StorageError
        ):  # The run has ended, and the warnings are shown even if they cannot be stored.
            folder.save()
    _tell(folder, screen, gone)
    screen.drain()
    if not gone:
        write_page(folder.path, record, lambda words, good: screen.say(words, err=not good))
        seal_folder(folder.path, record, lambda words, good: screen.say(words, err=not good))
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
    steady = Dataset(
        tuple(r for r in dataset.recordings if r.name.partition("[")[0] not in changed)
    )
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
        say(f"{folder}: {SEAL_FILE} is not written; `rig runs verify` has no digests", False)


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


def accept_run(
    folder: Path, limits: Sequence[Limit], source: str, junit_file: Path | None
) -> Acceptance:
    """Judge a run, print the outcome, and write the JUnit file if one is requested.

    Raises:
        InputError: The folder is not a run folder, or a file cannot be written.
    """
    from rig.results.acceptance.certificate import accept, acceptance_document, write_bytes
    from rig.results.document import text
    from rig.terminal.output import ShareBar

    with ShareBar() as bar:
        found = accept(folder, limits, source, bar)
    if junit_file is not None:
        write_bytes(junit_file, found.junit)
    click.echo(text(acceptance_document(found)))
    return found


def given_acceptance(file: Path | None) -> GivenFile | None:
    """Read the file of limits of a run before the joint moves; return None if none is given.

    Raises:
        InputError: The file is missing or not valid.
    """
    if file is None:
        return None
    load_acceptance(file)
    return GivenFile.of(file)


def limits_before(file: Path | None, sequence: SequenceFile) -> tuple[tuple[Limit, ...], str]:
    """Return the limits by which a run that has not begun will be judged, and their origin.

    Raises:
        InputError: The file is missing or not valid.
    """
    if file is None:
        return limits_of(sequence.acceptance), "the sequence"
    return limits_of(load_acceptance(file).value.limits), str(file)


def accept_at_the_end(folder: Path, junit_file: Path | None) -> int:
    """Judge a run that has just been completed; return the exit status.

    The limits are those stored in the run's recording, because the file of limits may have changed
    since the start of the run. If neither a file nor the sequence states limits, the run is not
    judged.

    Raises:
        InputError: The limits cannot be read, or a file cannot be written.
    """

    limits, source = stated_limits(folder, None)
    if not limits:
        return DONE
    count = f"{len(limits)} acceptance {'limit' if len(limits) == 1 else 'limits'}"
    click.echo(f"The run is judged by {count}; this may take a minute.")
    try:
        found = accept_run(folder, limits, source, junit_file)
    except KeyboardInterrupt:
        click.echo(f"not judged; judge the run with `rig runs accept {folder}`", err=True)
        raise
    return DONE if found.accepted else BAD_VERDICT


_OF_THE_SEQUENCE = "sequence"


def limits_for(folder: Path, file: Path | None) -> tuple[tuple[Limit, ...], str]:
    """Return the limits for a run and their origin; see :func:`stated_limits`.

    Raises:
        InputError: No limits are stated, or they cannot be read.
    """
    limits, source = stated_limits(folder, file)
    if not limits:
        raise InputError(
            f"{folder}: the sequence of this run states no `acceptance`; give the limits with "
            "--acceptance FILE"
        )
    return limits, source


def stated_limits(folder: Path, file: Path | None) -> tuple[tuple[Limit, ...], str]:
    """Return the limits for a run and their origin: the file given here, else the file that was
    given to the run, else the recorded sequence, which may state no limits.

    Raises:
        InputError: A file is not valid, or cannot be read.
    """
    if file is not None:
        return limits_of(load_acceptance(file).value.limits), str(file)
    given = recorded_acceptance(folder, read_record(folder))
    if given is None:
        return _limits_of_the_sequence(folder), _OF_THE_SEQUENCE
    name = given.entry["file"]
    text = given.content.decode("utf-8", "replace")
    return limits_of(located_text(Path(name), text, AcceptanceFile).value.limits), name


def _limits_of_the_sequence(folder: Path) -> tuple[Limit, ...]:
    """Return the acceptance limits in the sequence that is attached to a run's recording.

    Raises:
        InputError: The sequence cannot be read.
    """
    path = folder / RECORDING_FILE
    try:
        root, _ = parse(first_attachment(path, SEQUENCE_ATTACHMENT).decode("utf-8"))
    except (DamageError, DocumentError, OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: the sequence in this recording cannot be read: {error}"
        ) from error
    return limits_of(validated(Path(SEQUENCE_ATTACHMENT), root, SequenceFile).value.acceptance)
