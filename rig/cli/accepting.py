"""Judges a run against its acceptance limits: for ``rig runs accept``, and at the end of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli.entry import BAD_VERDICT, DONE
from rig.common.errors import InputError
from rig.common.places import replacing, usable
from rig.common.yaml_tree import DocumentError, parse
from rig.config.acceptance import Limit, limits_of
from rig.config.configuration import located_text, validated
from rig.config.sequence import AcceptanceFile, load_acceptance
from rig.config.sequence import Sequence as SequenceFile
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.recorded_inputs import GivenFile, recorded_acceptance
from rig.runs.run_file import read_record
from rig.runs.run_record import RECORDING_FILE, SEQUENCE_ATTACHMENT

if TYPE_CHECKING:
    from rig.results.acceptance.certificate import Acceptance


def accept_run(
    folder: Path, limits: Sequence[Limit], source: str, junit_file: Path | None
) -> Acceptance:
    """Judge a run, print the outcome, and write the JUnit file if one is requested."""
    from rig.results.acceptance.certificate import accept, acceptance_document
    from rig.results.document import text
    from rig.terminal.output import ShareBar

    with ShareBar() as bar:
        found = accept(folder, limits, source, bar)
    if junit_file is not None:
        with usable(junit_file, "written"), replacing(junit_file) as draft:
            draft.write_bytes(found.junit)
    click.echo(text(acceptance_document(found)))
    return found


def given_acceptance(file: Path | None) -> GivenFile | None:
    """Read the file of limits of a run before the joint moves; return None if none is given."""
    if file is None:
        return None
    load_acceptance(file)
    return GivenFile.of(file)


def limits_before(file: Path | None, sequence: SequenceFile) -> tuple[tuple[Limit, ...], str]:
    """Return the limits by which a run that has not begun will be judged, and their origin."""
    return _of_file(file) or (limits_of(sequence.acceptance), "the sequence")


def _of_file(file: Path | None) -> tuple[tuple[Limit, ...], str] | None:
    return None if file is None else (limits_of(load_acceptance(file).value.limits), str(file))


def accept_at_the_end(folder: Path, junit_file: Path | None) -> int:
    """Judge a run that has just been completed; return the exit status.

    The limits are those stored in the run's recording, because the file of limits may have changed
    since the start of the run. If neither a file nor the sequence states limits, the run is not
    judged.
    """
    limits, source = stated_limits(folder, None)
    if not limits:
        return DONE
    count = f"{len(limits)} acceptance {'limit' if len(limits) == 1 else 'limits'}"
    click.echo(f"The run is judged by its completeness and {count}; this may take a minute.")
    try:
        found = accept_run(folder, limits, source, junit_file)
    except KeyboardInterrupt:
        click.echo(f"not judged; judge the run with `rig runs accept {folder}`", err=True)
        raise
    return DONE if found.accepted else BAD_VERDICT


def limits_for(folder: Path, file: Path | None) -> tuple[tuple[Limit, ...], str]:
    """Return the limits for a run and their origin; see :func:`stated_limits`."""
    limits, source = stated_limits(folder, file)
    if not limits:
        raise InputError(
            f"{folder}: the sequence of this run states no `acceptance`; give the limits with "
            "--acceptance FILE"
        )
    return limits, source


def stated_limits(folder: Path, file: Path | None) -> tuple[tuple[Limit, ...], str]:
    """Return limits and origin: this file, else the file or the sequence of the run."""
    if (stated := _of_file(file)) is not None:
        return stated
    given = recorded_acceptance(folder, read_record(folder))
    if given is not None:
        name, text = given.entry["file"], given.content.decode("utf-8", "replace")
        return limits_of(located_text(Path(name), text, AcceptanceFile).value.limits), name
    path = folder / RECORDING_FILE
    try:
        root, _ = parse(first_attachment(path, SEQUENCE_ATTACHMENT).decode("utf-8"))
    except (DamageError, DocumentError, OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: the sequence in this recording cannot be read: {error}"
        ) from error
    sequence = validated(Path(SEQUENCE_ATTACHMENT), root, SequenceFile).value
    return limits_of(sequence.acceptance), "sequence"
