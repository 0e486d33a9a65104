"""Errors that the user can correct: unusable input, unwritable output, a bench in use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum


class InputError(Exception):
    """A file that the user wrote or named cannot be used; the command line exits with status 2."""

    def __init__(self, problems: str | Iterable[str]) -> None:
        # All problems found, one line each: `file:line:column: path: message (got VALUE)` for
        # configuration, `file: row N: message` for recordings.
        self.problems: tuple[str, ...] = (
            (problems,) if isinstance(problems, str) else tuple(problems)
        )
        super().__init__("\n".join(self.problems))


class StorageError(Exception):
    """A recording, run folder or lock file cannot be written; status 4."""


class InUseError(Exception):
    """A bench or a run folder is held by another program; the command line exits with status 4."""


class Cause(Enum):
    """Subject of a finding, as named in a verdict."""

    BUS = "bus"
    NODES = "node identifiers"
    FILES = "device files"
    CONSTANTS = "machine constants"
    SIMULATION = "simulated drive"
    CALIBRATION = "calibration"
    STATE = "state of the drive"
    OFF = "a drive that is not proved off"
    DRIVE = "settings of the drive"
    ENCODER = "joint encoder"
    PRESSURE = "pressure transmitter"
    LIMITS = "limits"
    READINGS = "readings"


@dataclass(frozen=True)
class Finding:
    """One finding of a check."""

    cause: Cause  # subject of the finding
    text: str  # message with remedy; for a refusal, the message of the run
    refused: bool = True  # whether a run would refuse to start; otherwise the finding is a warning
    connectable: bool = True  # whether a connection to the bench is possible in spite of it


def refusals(findings: Sequence[Finding]) -> list[str]:
    """Return the messages of the findings for which a run would refuse to start."""
    return [finding.text for finding in findings if finding.refused]


def warnings(findings: Sequence[Finding]) -> list[str]:
    """Return the messages of the findings with which a run would start."""
    return [finding.text for finding in findings if not finding.refused]


def verdict(findings: Sequence[Finding]) -> str:
    """Return the verdict as text: good, or the causes for which a run would refuse to start."""
    causes = list(dict.fromkeys(finding.cause.value for finding in findings if finding.refused))
    if not causes:
        return "good: a run would start"
    listed = causes[0] if len(causes) == 1 else f"{', '.join(causes[:-1])} and {causes[-1]}"
    return f"NOT good: a run would refuse, because of {listed}"
