"""Records of a run in a list of runs: the head for lists, the identified parameters for
comparisons.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

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
        sequence: Name of the sequence.
        created: Start of the run, ISO 8601, UTC.
        bench: Name of the bench.
        simulated: Whether the bench is simulated, or None if unknown.
        operators: Names of the operators, in order.
        masses_kg: Confirmed masses of the stages, each once; the planned masses if no mass was
            confirmed.
        state: `running`, or how the run ended.
        message: How the run ended, as text.
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
        unit: Unit.
        at_bound: Whether the estimate is at a bound of the search.
    """

    value: float | None
    low: float | None
    high: float | None
    unit: str
    at_bound: bool = False

    @property
    def half_width(self) -> float | None:
        """Half the width of the interval, or None if value or interval is missing, or if the
        estimate is at a bound.
        """
        if self.value is None or self.low is None or self.high is None or self.at_bound:
            return None
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class Details:
    """The properties of a run that a comparison uses.

    Attributes:
        constants: Identified parameters by name.
        fit_rms: Torque error of the identification, or None if unknown.
        fit_unit: Unit of the torque error.
        motion: `rotary` or `linear`.
        devices: Identity (name and serial number) of the devices by role.
    """

    constants: Mapping[str, Constant] = field(default_factory=dict)
    fit_rms: float | None = None
    fit_unit: str = ""
    motion: str = ""
    devices: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Details:
        """Return the details from their JSON form ``record``."""
        constants = {name: Constant(**each) for name, each in record["constants"].items()}
        return cls(**{**record, "constants": constants})


@dataclass(frozen=True)
class Entry:
    """One run in a list of runs.

    Attributes:
        folder: Folder of the run, relative to the searched folder.
        head: Properties that a list shows.
        details: Properties that a comparison needs, as JSON; parsed by :meth:`parsed`.
    """

    folder: str
    head: Head
    details: str

    def parsed(self) -> Details:
        """Return the details of the run."""
        import json

        return Details.of(json.loads(self.details))
