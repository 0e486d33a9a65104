"""Records of a run in a list of runs: the head for lists, the details for comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from rig.common.locks import OWNER_FILE, is_held

Kind = Literal["run", "commissioning", "half written", "other version", "unreadable"]
GOING_ON, DIED = "going on", "died"
"""States of a run whose record says `running`: a program either holds the folder or has died."""


@dataclass(frozen=True)
class Head:
    """The properties of a run that a list shows.

    Attributes:
        kind: Kind of the folder: `run`, `commissioning`, `half written` (the record is missing or
            incomplete), `other version` (this program does not read the format of the record), or
            `unreadable` (the record is invalid, or cannot be read).
        problem: Message with the remedy; empty for a run.
        created: Start of the run, ISO 8601, UTC.
        simulated: Whether the bench is simulated, or None if unknown.
        operators: Names of the operators, in order.
        masses_kg: Confirmed masses of the stages, each once; the planned masses if no mass was
            confirmed.
        state: `running`, or how the run ended.
        seconds: Time of the bench, s.
        weights: Verdicts of the weight checks, each once.
        identified: Method of the identification; empty without an identification.
        diagnosis: Verdict of the diagnosis; empty without a diagnosis.
        acceptance: `accepted` or `rejected`; empty without an acceptance.
        digest: SHA-256 of the record, by which copies are recognised; empty without a record.
        notes: Further remarks, such as on a result file that cannot be read.
    """

    kind: Kind = "run"
    problem: str = ""
    sequence: str = ""
    created: str = ""
    bench: str = ""
    simulated: bool | None = None
    operators: tuple[str, ...] = ()
    masses_kg: tuple[float, ...] = ()
    state: str = ""
    message: str = ""
    seconds: float = 0.0
    weights: tuple[str, ...] = ()
    identified: str = ""
    diagnosis: str = ""
    acceptance: str = ""
    digest: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Head:
        """Return the head from its JSON form ``record``."""
        lists = ("operators", "masses_kg", "weights", "notes")
        return cls(**{**record, **{name: tuple(record[name]) for name in lists}})


@dataclass(frozen=True)
class Constant:
    """One identified parameter with its 90 % interval.

    Attributes:
        value: Estimate, or None if the parameter is not identifiable.
        low: Lower end of the interval, or None without an interval.
        high: Upper end of the interval, or None.
        at_bound: Whether the estimate is at a bound of the search.
    """

    value: float | None
    low: float | None
    high: float | None
    unit: str
    at_bound: bool = False

    @property
    def half_width(self) -> float | None:
        """Half the width of the interval, or None without one or at a bound."""
        if self.value is None or self.low is None or self.high is None or self.at_bound:
            return None
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class Details:
    """The properties of a run that a comparison uses."""

    constants: Mapping[str, Constant] = field(default_factory=dict)  # identified parameters by name
    fit_rms: float | None = None  # torque error of the identification, or None if unknown
    fit_unit: str = ""
    motion: str = ""  # `rotary` or `linear`
    # Identity (name and serial number) of the devices by role.
    devices: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Details:
        """Return the details from their JSON form ``record``."""
        constants = {name: Constant(**each) for name, each in record["constants"].items()}
        return cls(**{**record, "constants": constants})


@dataclass(frozen=True)
class Entry:
    """One run in a list of runs."""

    folder: str
    head: Head
    details: str

    def parsed(self) -> Details:
        """Return the details of the run."""
        import json

        return Details.of(json.loads(self.details))


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
_SAME_MASS = 1e-3  # relative difference up to which two masses count as equal


@dataclass(frozen=True)
class Wanted:
    """Properties of the requested runs; None accepts every value of a property."""

    bench: str | None = None  # name of the bench, or a pattern with `*` and `?`
    sequence: str | None = None  # name of the sequence, or a pattern
    operator: str | None = None  # name of an operator, or a pattern
    weight_kg: float | None = None  # a mass that was on the lever; 0 for the empty lever
    verdict: str | None = None  # one of `VERDICTS`
    since: datetime | None = None  # earliest start time
    until: datetime | None = None  # time before which the run must have started

    def fits(self, root: Path, entry: Entry) -> bool:
        """Return whether a run has the wanted properties; an unknown one does not fit."""
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
    """Return the state of a run; of one `running`, whether its program has died."""
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
