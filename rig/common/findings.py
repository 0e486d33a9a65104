"""What a check before a run finds: causes, words, and whether a run would refuse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum


class Cause(Enum):
    """What a finding is about; the words of a verdict."""

    BUS = "bus"
    NODES = "node identifiers"
    FILES = "device files"
    CONSTANTS = "machine constants"
    SIMULATION = "simulated drive"
    CALIBRATION = "calibration"
    STATE = "state of the drive"
    DRIVE = "settings of the drive"
    ENCODER = "joint encoder"
    PRESSURE = "pressure transmitter"
    LIMITS = "limits"
    READINGS = "readings"


@dataclass(frozen=True)
class Finding:
    """One thing that a check found.

    Attributes:
        cause: What it is about.
        text: In words, with the remedy; a refusal in the words in which a run refuses.
        refused: Whether a run would refuse; else it is a warning.
        connectable: Whether the bench can be connected to all the same.
    """

    cause: Cause
    text: str
    refused: bool = True
    connectable: bool = True


def refusals(findings: Sequence[Finding]) -> list[str]:
    """Return the words of those for which a run would refuse."""
    return [finding.text for finding in findings if finding.refused]


def warnings(findings: Sequence[Finding]) -> list[str]:
    """Return the words of the others."""
    return [finding.text for finding in findings if not finding.refused]


def verdict(findings: Sequence[Finding]) -> str:
    """Return the verdict in words: good, or what is at fault."""
    causes = list(dict.fromkeys(finding.cause.value for finding in findings if finding.refused))
    if not causes:
        return "good: a run would start"
    listed = causes[0] if len(causes) == 1 else f"{', '.join(causes[:-1])} and {causes[-1]}"
    return f"NOT good: a run would refuse, because of {listed}"
