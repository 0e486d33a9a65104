"""Resumes a stopped run at its first unfinished stage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.config.sequence import Sequence, load_sequence
from rig.runs.recorded_inputs import recorded_input
from rig.runs.recover import mend
from rig.runs.run import discard, first_unfinished
from rig.runs.run_file import read_record
from rig.runs.run_record import (
    ACCEPTANCE_INPUT,
    BENCH_ATTACHMENT,
    DIED,
    SEQUENCE_ATTACHMENT,
    RunRecord,
)

_ATTACHED = {BENCH_ATTACHMENT, SEQUENCE_ATTACHMENT}


@dataclass(frozen=True)
class Resumption:
    """Inputs of a resumed run.

    Attributes:
        record: ``run.json``, completed.
        bench: The bench file of the run, which is unchanged.
        sequence: The sequence file of the run, which is unchanged.
        stage: Index of the stage with which the run continues.
        mended: Messages on recordings whose writer died.
        died: Whether the writer of the last recording died, so that the drive's watchdog stopped
            the drive.
    """

    record: RunRecord
    bench: Document[Bench]
    sequence: Document[Sequence]
    stage: int
    mended: tuple[str, ...]
    died: bool


def prepare(folder: Path) -> Resumption:
    """Repair a run if its writer died, and find the stage with which the run continues.

    Recordings of the unfinished stage are marked as not to be used. The caller must hold the lock
    of the folder until the resumed run has ended.

    Raises:
        InputError: All stages are done, or the bench or sequence file is gone or was
            changed since.
        OSError: The folder cannot be written.
    """
    recovery = mend(folder)
    record = read_record(folder)
    stage = first_unfinished(record)
    if stage is None:
        raise InputError(
            f"{folder}: all {len(record.stages)} stages are done; there is no stage to resume"
        )
    bench = load_bench(_unchanged(folder, record, BENCH_ATTACHMENT))
    sequence = load_sequence(_unchanged(folder, record, SEQUENCE_ATTACHMENT))
    for name in sorted(set(record.inputs) - _ATTACHED - {ACCEPTANCE_INPUT}):
        _unchanged(folder, record, name)
    discard(record, stage)
    return Resumption(
        record, bench, sequence, stage, recovery.damage, record.parts[-1].state == DIED
    )


def _unchanged(folder: Path, record: RunRecord, name: str) -> Path:
    """Return the path of an input file, after a check that the file is unchanged since the start of
    the run.
    """
    entry = record.inputs[name]
    path = recorded_input(folder, entry)
    attached = f" (it is attached to the recording as {name})" if name in _ATTACHED else ""
    if name == BENCH_ATTACHMENT and record.simulated:
        attached = attached.replace(")", ", without the simulated machine's true constants)")
    remedy = f"restore the file with which the run began{attached}, or start a new run"
    try:
        digest = sha256_file(path)
    except OSError as error:
        text = (
            f"{path}: {folder} was run with this file, which cannot be read: {error.strerror}; "
            f"{remedy}"
        )
        raise InputError(text) from error
    if digest != entry["sha256"]:
        then, now = entry["sha256"][:12], digest[:12]
        raise InputError(
            f"{path}: changed since {folder} was run with this file (SHA-256 {then}, now "
            f"{now}); {remedy}"
        )
    return path


def stopped_words(record: RunRecord) -> str:
    """Return the state of the run as a sentence."""
    done = sum(stage.state == "done" for stage in record.stages)
    return (
        f"{record.name}: {done} of {len(record.stages)} stages done; {record.state}: "
        f"{record.message}"
    )
