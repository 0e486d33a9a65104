"""Reads the limits by which a run is accepted.

This module is separate from the judgement, because the libraries of the judgement take half a
second to import, and every run asks at its end whether there are limits.
"""

from __future__ import annotations

from pathlib import Path

from rig.common.errors import InputError
from rig.common.yaml_tree import DocumentError, parse
from rig.config.acceptance import Limit, limits_of
from rig.config.configuration import validated
from rig.config.sequence import Sequence, load_acceptance
from rig.runs.mcap.records import DamageError
from rig.runs.mcap.stream import first_attachment
from rig.runs.run_record import RECORDING_FILE, SEQUENCE_ATTACHMENT

_OF_THE_SEQUENCE = "sequence"


def limits_for(folder: Path, file: Path | None) -> tuple[tuple[Limit, ...], str]:
    """Return the limits for a run and their origin: the given file, else the recorded sequence.

    Raises:
        InputError: The file is not valid; or there is none, and the sequence states no limits.
    """
    if file is not None:
        return limits_of(load_acceptance(file).value.limits), str(file)
    limits = recorded_limits(folder)
    if not limits:
        raise InputError(
            f"{folder}: the sequence of this run states no `acceptance`; give the limits with "
            "--acceptance FILE"
        )
    return limits, _OF_THE_SEQUENCE


def recorded_limits(folder: Path) -> tuple[Limit, ...]:
    """Return the acceptance limits in the sequence that is attached to a run's recording.

    Raises:
        InputError: The sequence cannot be read.
    """
    path = folder / RECORDING_FILE
    try:
        root, _ = parse(first_attachment(path, SEQUENCE_ATTACHMENT).decode("utf-8"))
    except (DamageError, DocumentError, OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the sequence in it cannot be read: {error}") from error
    return limits_of(validated(Path(SEQUENCE_ATTACHMENT), root, Sequence).value.acceptance)
