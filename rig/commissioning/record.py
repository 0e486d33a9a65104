"""Records of the steps of a commissioning, and of their findings."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from rig.control.motion_proof import Change


class Verdict(Enum):
    """Verdict of a step."""

    GOOD = "good"
    WRONG = "wrong"
    SKIPPED = "not tried"


@dataclass(frozen=True)
class Measured:
    """One value that was measured or read."""

    name: str
    value: str
    unit: str = ""


@dataclass
class StepRecord:
    """Record of one step."""

    name: str
    announced: str
    consent: str = ""
    measured: list[Measured] = field(default_factory=list)
    verdict: Verdict = Verdict.GOOD
    words: str = ""
    changes: tuple[Change, ...] = ()

    def measure(self, name: str, value: object, unit: str = "") -> None:
        """Store a value; floats are shown with four digits."""
        shown = f"{value:z.4g}" if isinstance(value, float) else str(value)
        self.measured.append(Measured(name, shown, unit))

    def record(self) -> dict[str, Any]:
        """Return the record for the result file."""
        return {
            "name": self.name,
            "announced": self.announced,
            "consent": self.consent,
            "measured": [vars(item) for item in self.measured],
            "verdict": self.verdict.value,
            "words": self.words,
            "changes": [change.record() for change in self.changes],
        }


class WrongError(Exception):
    """A step found a wrong value or reaction; ``changes`` of the bench file may correct it."""

    def __init__(self, words: str, changes: tuple[Change, ...] = ()) -> None:
        super().__init__(words)
        self.changes = changes


class SkippedError(Exception):
    """A step cannot be performed, or the operator did not agree; the message states the reason."""
