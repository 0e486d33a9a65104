"""Chooses runs of a list by their properties."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path

from rig.common.lock_holder import is_held
from rig.common.locks import OWNER_FILE
from rig.runs.catalogue.entry import DIED, GOING_ON, Entry

VERDICTS = (
    "done",
    "tripped",
    "stopped",
    "failed",
    "crashed",
    "died",
    "going-on",
    "accepted",
    "rejected",
    "weight-right",
    "weight-wrong",
    "weight-unchecked",
    "nothing_missing",
    "named",
    "ambiguous",
    "outside_catalogue",
    "half-written",
    "other-version",
    "unreadable",
)
"""Verdicts by which runs can be chosen."""
_SAME_MASS = 1e-3
"""Relative difference up to which two masses count as equal."""


@dataclass(frozen=True)
class Wanted:
    """Properties of the requested runs; None accepts every value of a property.

    Attributes:
        bench: Name of the bench, or a pattern with `*` and `?`.
        sequence: Name of the sequence, or a pattern.
        operator: Name of an operator, or a pattern.
        weight_kg: A mass that was on the lever; 0 for the empty lever.
        verdict: One of :data:`VERDICTS`.
        since: Earliest start time.
        until: Time before which the run must have started.
    """

    bench: str | None = None
    sequence: str | None = None
    operator: str | None = None
    weight_kg: float | None = None
    verdict: str | None = None
    since: datetime | None = None
    until: datetime | None = None

    def fits(self, root: Path, entry: Entry) -> bool:
        """Return whether a run has the wanted properties; a run in which a wanted property is
        unknown does not fit.
        """
        head = entry.head
        names = (
            (self.bench, (head.bench,)),
            (self.sequence, (head.sequence,)),
            (self.operator, head.operators),
        )
        return (
            all(pattern is None or _any_fits(pattern, known) for pattern, known in names)
            and (self.weight_kg is None or _has_mass(self.weight_kg, head.masses_kg))
            and (self.verdict is None or self.verdict in verdicts(root, entry))
            and self._in_time(head.created)
        )

    def _in_time(self, created: str) -> bool:
        if self.since is None and self.until is None:
            return True
        begun = time_of(created)
        if begun is None:
            return False
        return (self.since is None or begun >= self.since) and (
            self.until is None or begun < self.until
        )


def time_of(created: str) -> datetime | None:
    """Return a time of a record in UTC, or None if the text is not a time."""
    try:
        found = datetime.fromisoformat(created)
    except ValueError:
        return None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


def chosen(root: Path, entries: Iterable[Entry], wanted: Wanted) -> list[Entry]:
    """Return the runs that have the wanted properties."""
    return [entry for entry in entries if wanted.fits(root, entry)]


def latest(entries: Sequence[Entry], count: int | None) -> Sequence[Entry]:
    """Return the last runs of a list, or all runs."""
    return entries if count is None else entries[-count:]


def state_of(root: Path, entry: Entry) -> str:
    """Return the state of a run; if the record says `running`, return whether the program of the
    run still runs or has died.
    """
    if entry.head.kind != "run" or entry.head.state != "running":
        return entry.head.state
    return GOING_ON if is_held(root / entry.folder / OWNER_FILE) else DIED


def verdicts(root: Path, entry: Entry) -> set[str]:
    """Return all verdicts of a run by which the run can be chosen."""
    head = entry.head
    if head.kind != "run":
        return {head.kind.replace(" ", "-")}
    weights = {f"weight-{verdict}" for verdict in head.weights}
    state = state_of(root, entry).replace(" ", "-")
    return {state, head.acceptance, head.diagnosis, *weights} - {""}


def _any_fits(pattern: str, known: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in known)


def _has_mass(mass: float, known: Iterable[float]) -> bool:
    return any(math.isclose(mass, each, rel_tol=_SAME_MASS, abs_tol=1e-9) for each in known)
