"""Reads the limits by which a run is accepted.

This module is separate from the judgement, because the libraries of the judgement take half a
second to import, and every run asks at its end whether there are limits.
"""

from __future__ import annotations

from pathlib import Path

from rig.common.errors import InputError
from rig.common.yaml_tree import DocumentError, parse
from rig.config.acceptance import Limit, limits_of
from rig.config.configuration import located_text, validated
from rig.config.sequence import AcceptanceFile, Sequence, load_acceptance
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.recorded_inputs import recorded_acceptance
from rig.runs.run_file import read_record
from rig.runs.run_record import RECORDING_FILE, SEQUENCE_ATTACHMENT

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
    return limits_of(validated(Path(SEQUENCE_ATTACHMENT), root, Sequence).value.acceptance)
