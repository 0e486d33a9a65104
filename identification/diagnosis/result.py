"""What a diagnosis returns: the verdict with its evidence, and everything a report shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from identification.recording import Array


class Verdict(Enum):
    """The four ends of a diagnosis."""

    NOTHING_MISSING = "nothing_missing"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    OUTSIDE_CATALOGUE = "outside_catalogue"


@dataclass(frozen=True)
class Estimate:
    """One parameter of an effect with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Rival:
    """An effect that was considered instead; ``why_not`` is empty where the data cannot reject
    it.
    """

    name: str
    confidence: float
    why_not: str


@dataclass(frozen=True)
class Location:
    """Where the mismatch shows.

    Attributes:
        coordinate: ``speed``, ``angle``, ``load``, ``direction``, ``time``, ``temperature``,
            ``time since reversal``, ``travel since reversal``, ``rest time`` or ``frequency``.
        unit: Of the ranges.
        ranges: Stretches of the coordinate in which the mismatch is beyond its band.
        share_of_mismatch: Share of the mismatch's power that a curve over this coordinate explains.
        recordings: Names of those in which it shows.
    """

    coordinate: str
    unit: str
    ranges: tuple[tuple[float, float], ...]
    share_of_mismatch: float
    recordings: tuple[str, ...]


@dataclass(frozen=True)
class Effect:
    """One named effect.

    Attributes:
        name: Stable name of the catalogue.
        alias_group: Names that these recordings cannot tell from it, itself included.
        confidence: That this name, rather than a rival, is right; 0 to 1.
        statement: The finding in a plain sentence, with its size and what it does to the error.
        assumption_broken: Which assumption of the paper it breaks.
        where: Where it shows.
        parameters: By the catalogue's names.
        rivals: The nearest ones, best first.
        separating_experiment: What would split the alias group, or confirm the name.
    """

    name: str
    alias_group: tuple[str, ...]
    confidence: float
    statement: str
    assumption_broken: str
    where: Location
    parameters: Mapping[str, Estimate]
    rivals: tuple[Rival, ...]
    separating_experiment: str


@dataclass(frozen=True)
class Fit:
    """Errors of one equation before and after, one bandwidth throughout; None where nothing was set
    aside.
    """

    equation: str
    unit: str
    bandwidth_Hz: float
    baseline_rms: float
    final_rms: float
    noise_floor_rms: float
    validate_baseline_rms: float | None = None
    validate_final_rms: float | None = None


@dataclass(frozen=True)
class Shift:
    """A nominal parameter before and after the correction; None where it is not identifiable."""

    before: float | None
    after: float | None
    unit: str


@dataclass(frozen=True)
class Map:
    """The mismatch against one coordinate, with simultaneous 90 % bands.

    Attributes:
        equation: ``torque``, ``transmission``, ``voltage`` or ``breakaway``.
        coordinate: As in :class:`Location`.
        unit: Of the coordinate.
        residual_unit: Of the mismatch.
        centre: Centres of the bins, shape (b,).
        mean: Mean mismatch in each before correction, shape (b,).
        low: Lower band around ``mean``, shape (b,).
        high: Upper band, shape (b,).
        after: Mean mismatch in each after correction, shape (b,).
        share: Share of the mismatch's power that the curve explains.
        against_motion: The mismatch was taken times the direction of motion, as friction acts.
    """

    equation: str
    coordinate: str
    unit: str
    residual_unit: str
    centre: Array
    mean: Array
    low: Array
    high: Array
    after: Array
    share: float
    against_motion: bool = False


@dataclass(frozen=True)
class Curve:
    """A smooth empirical curve of what is missing, to be carried in a simulation where no name
    fits.

    ``value`` over ``grid``, both shape (g,); between points it is linear, outside constant.
    """

    equation: str
    coordinate: str
    unit: str
    residual_unit: str
    grid: Array
    value: Array


@dataclass(frozen=True)
class Step:
    """One step of the search, as it happened: what was tested, added or taken out again, and
    why.
    """

    action: str
    name: str
    p_value: float | None
    gain: float
    note: str


@dataclass(frozen=True)
class ResidualTrace:
    """The mismatch of one recording in one equation, at the stated bandwidth, shapes (n,)."""

    recording: str
    role: str
    equation: str
    unit: str
    time: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Diagnosis:
    """Result of one diagnosis.

    Attributes:
        verdict: One of four.
        statement: The verdict in a plain sentence.
        effects: In order of importance; empty where nothing is missing or no name fits.
        fit: Of the equation in which the mismatch is found (the torque's where nothing is missing).
        fits: Of every equation that the recordings bear.
        parameters: Nominal parameters of the corrected model, name to value.
        parameter_shift: Nominal parameters before and after.
        p_value: Of the test that anything is missing at all.
        location: Where the mismatch is greatest, whether or not it has a name.
        curve: The empirical curve of an outside_catalogue verdict.
        maps: For the report.
        steps: How the search went.
        traces: For the report.
        warnings: What the reader must know.
        seconds: Time spent.
    """

    verdict: Verdict
    statement: str
    effects: tuple[Effect, ...]
    fit: Fit
    fits: tuple[Fit, ...]
    parameters: Mapping[str, float]
    parameter_shift: Mapping[str, Shift]
    p_value: float
    location: Location | None = None
    curve: Curve | None = None
    maps: tuple[Map, ...] = ()
    steps: tuple[Step, ...] = ()
    traces: tuple[ResidualTrace, ...] = ()
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    alpha: float = field(default=2.0)
