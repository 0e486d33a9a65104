"""Advice after a run that stopped: the remedies first, then the command that continues the run."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any, Final

from drivers.errors import CORRECT_MACHINE
from drivers.interfaces import ServoState
from rig.common.provenance import sha256_file
from rig.control.safety import Check, foreseen, remedy
from rig.runs.run_record import RUN_FILE, Ending, RunRecord
from rig.wiring.preflight import RESET_HINT

NOT_READ_BACK = (
    "it was not verified that the drive is off: switch the main supply off, and do not touch the "
    "weights or the joint before it rests"
)
NEW_RUN = (
    "if a remedy changes the bench file, the sequence file or the file of the machine, start a new "
    "run: a run can continue only with unchanged files"
)
_FAULTS = frozenset({ServoState.FAULT.value, ServoState.FAULT_REACTION.value})
_BY_FILE = frozenset(
    {Check.ANGLE, Check.SPEED, Check.DISAGREEMENT, Check.LATENESS, Check.STAGE_TIME}
)
"""Trips whose remedy may be a change of the bench or sequence file."""


def first_words(record: RunRecord) -> list[str]:
    """Return the steps before the run can go on that its message does not state."""
    words = [] if record.de_energised else [NOT_READ_BACK]
    check, trip = _tripped(record), record.trip or {}
    found = "" if check is None else remedy(check, trip)
    if found not in record.message:
        words.append(found)
    elif _in_fault(record):
        words.append("remove the cause of the drive's fault")
    return words


def go_on_notes(record: RunRecord) -> list[str]:
    """Return further notes on continuing the run."""
    by_file = foreseen(record.trip or {}) or _tripped(record) in _BY_FILE
    return [NEW_RUN] if by_file or CORRECT_MACHINE in record.message else []


def go_on_command(record: RunRecord, folder: Path) -> str | None:
    """Return the command that continues a run, or None if every stage is done."""
    if all(stage.state == "done" for stage in record.stages):
        return None
    place = f"./{folder}" if str(folder).startswith("-") else str(folder)
    return f"rig resume {shlex.quote(place)}{' --reset-fault' if _in_fault(record) else ''}"


def go_on_words(record: RunRecord, folder: Path) -> str:
    """Return the last lines of the message on an unfinished run; empty for a finished run."""
    if record.state == Ending.DONE.value:
        return ""
    command = go_on_command(record, folder)
    lines = [
        *(f"first: {words}" for words in first_words(record)),
        *(f"note: {words}" for words in go_on_notes(record)),
        f"go on with: {command}" if command else "every stage is done; there is no stage to resume",
    ]
    return "\n".join(lines)


def _in_fault(record: RunRecord) -> bool:
    """Return whether the drive was left in a fault, which needs ``--reset-fault``."""
    return record.drive_state in _FAULTS or RESET_HINT in record.message


def _tripped(record: RunRecord) -> Check | None:
    """Return the check that tripped the run, or None if no check did."""
    name = record.trip.get("check") if record.trip else None
    return next((check for check in Check if check.value == name), None)


ACCEPTANCE_FILE: Final = "acceptance.json"
CERTIFICATE_PAGE = "certificate.html"
_VERDICTS: Final = frozenset({"accepted", "rejected"})


def read_verdict(folder: Path) -> dict[str, Any] | None:
    """Return the verdict on a run as JSON values.

    Returns:
        ``verdict``, ``accepted`` or ``rejected``; ``checks``, the number of checks; ``failed``, the
        failed checks as text; ``pages``, the certificates. None if the run was not judged, or if
        ``run.json`` was changed after the judgement, for example by ``rig resume``.
    """
    try:
        found = json.loads((folder / ACCEPTANCE_FILE).read_text(encoding="utf-8"))
        digests = {each["file"]: each["sha256"] for each in found["inputs"]}
        if digests[RUN_FILE] != sha256_file(folder / RUN_FILE):
            return None
        if found["verdict"] not in _VERDICTS:
            return None
        return {
            "verdict": found["verdict"],
            "checks": len(found["checks"]),
            "failed": [f"{c['limit']}: {c['words']}" for c in found["checks"] if not c["passed"]],
            "pages": [CERTIFICATE_PAGE] if (folder / CERTIFICATE_PAGE).is_file() else [],
        }
    except (OSError, ValueError, KeyError, TypeError):
        return None
