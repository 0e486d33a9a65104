"""Findings of a check before a run: cause, message, and whether a run would refuse to start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


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
    """One finding of a check.

    Attributes:
        cause: Subject of the finding.
        text: Message with remedy; for a refusal, the message of the run.
        refused: Whether a run would refuse to start; otherwise the finding is a warning.
        connectable: Whether a connection to the bench is possible in spite of the finding.
    """

    cause: Cause
    text: str
    refused: bool = True
    connectable: bool = True


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
