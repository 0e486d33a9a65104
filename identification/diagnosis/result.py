"""Result of a diagnosis: the verdict with its evidence, and all data of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from identification.effects.model import CorrectedModel, Curve
from identification.numerics.arrays import plain
from identification.numerics.spread import NO_SPREAD, Spread
from identification.recording import Array
from identification.result import LEAST_EXPLAINED, MOST_FLOORS, Misfit


class Verdict(Enum):
    """The four outcomes of a diagnosis."""

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
    """An alternative effect; ``why_not`` is empty if the data do not reject the rival."""

    name: str
    confidence: float
    why_not: str


@dataclass(frozen=True)
class Location:
    """Coordinate, ranges and recordings in which the mismatch shows.

    Attributes:
        coordinate: ``speed``, ``angle``, ``load``, ``direction``, ``time``, ``temperature``,
            ``time since reversal``, ``travel since reversal``, ``rest time``, ``acceleration``,
            ``torque``, ``torque rate``, ``motor angle`` or
            ``current direction``.
        unit: Unit of the ranges.
        ranges: Ranges of the coordinate in which the mismatch is significant.
        share_of_mismatch: Share of the mismatch's power that a function of this coordinate predicts
            beside the nominal parameters.
        recordings: Names of the recordings in which the mismatch shows.
    """

    coordinate: str
    unit: str
    ranges: tuple[tuple[float, float], ...]
    share_of_mismatch: float
    recordings: tuple[str, ...]


@dataclass(frozen=True)
class IdentifiedEffect:
    """One identified effect.

    Attributes:
        name: Stable name of the catalogue.
        alias_group: Names of the effects that these recordings do not distinguish from this effect,
            including this effect.
        confidence: Probability that this effect, and not a rival, is right; 0 to 1.
        statement: The finding in a plain sentence, with parameters.
        assumption_broken: Assumption of the paper that the effect violates.
        where: Location of the mismatch.
        parameters: Estimates by the parameter names of the catalogue.
        rivals: Rivals, sorted by their fit, best first.
        separating_experiment: Experiment that would split the alias group, or confirm the effect.
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
    """Rms errors of one equation by the nominal and by the corrected model, at one bandwidth; the
    values ``validate_*`` are None without recordings of role ``validate``.

    Attributes:
        baseline_rms: Error with the constants of the nominal model.
        final_rms: Error with the reported constants and effects, as in the exported model.
        noise_floor_rms: What no model can explain.
        nominal_within_limits_rms: Error of the nominal model with the constants that fit the rows
            of this equation best within their limits.
        relative: Norm of the error of the corrected model over that of the measured side.
    """

    equation: str
    unit: str
    bandwidth_Hz: float
    baseline_rms: float
    final_rms: float
    noise_floor_rms: float
    validate_baseline_rms: float | None = None
    validate_final_rms: float | None = None
    nominal_within_limits_rms: float | None = None
    validate_nominal_within_limits_rms: float | None = None
    relative: float | None = None


@dataclass(frozen=True)
class Shift:
    """Value of a nominal parameter in both models; None if the value is not identifiable."""

    before: float | None
    after: float | None
    unit: str


@dataclass(frozen=True)
class Map:
    """The mismatch against one coordinate, with simultaneous 90 % bands.

    Attributes:
        equation: ``torque``, ``transmission``, ``voltage``, ``breakaway`` or ``pressure``.
        coordinate: Coordinate, as in :class:`Location`.
        unit: Unit of the coordinate.
        residual_unit: Unit of the mismatch.
        centre: Centres of the bins, shape (b,).
        mean: Mean mismatch in each bin before correction, shape (b,).
        low: Lower band around ``mean``, shape (b,).
        high: Upper band around ``mean``, shape (b,).
        after: Mean mismatch in each bin by the corrected model, shape (b,).
        share: Share of the mismatch's power that a function of the coordinate predicts beside the
            nominal parameters.
        against_motion: Whether the mismatch was multiplied by the direction of motion, like
            friction.
        mean_share: Share of the mismatch's power that ``mean`` explains.
        periodic: Whether the coordinate is an angle of which full turns are equal.
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
    mean_share: float = 0.0
    periodic: bool = False

    def curve(self, grid: Array, value: Array) -> Curve:
        """Return a curve of the mismatch over this coordinate."""
        where = self.equation, self.coordinate, self.unit, self.residual_unit
        return Curve(*where, grid, value, self.against_motion)


@dataclass(frozen=True)
class Step:
    """One step of the search: a test, or an added or removed effect with the reason."""

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


NOT_WRITTEN = ("maps", "traces", "seconds", "model")
"""Fields of a diagnosis that its result file does not have."""


@dataclass(frozen=True)
class Diagnosis:
    """Result of one diagnosis.

    Attributes:
        verdict: The verdict.
        statement: The verdict in a plain sentence.
        effects: Identified effects in order of importance; empty if nothing is missing or no effect
            fits; a part of the mismatch if the verdict is ``outside_catalogue``.
        fit: Errors of the equation in which the mismatch is judged (the torque equation if nothing
            is missing).
        fits: Errors of every equation that the recordings allow.
        parameters: Nominal parameters of the corrected model, name to value.
        parameter_shift: Nominal parameters in the nominal model and in the corrected model.
        p_value: p-value of the test whether physics is missing.
        location: Location of the greatest mismatch, whether an effect explains it or not.
        curve: Empirical curve of a mismatch that is ``outside_catalogue`` and has no effect.
        maps: Mismatch against each coordinate, for the report.
        steps: Steps of the search.
        traces: Mismatch against time, for the report.
        warnings: Warnings on the recordings and on the result.
        seconds: Computing time, s.
        alpha: Stribeck exponent.
        covariance: Covariance of the parameters of the corrected model, those of effects as
            ``effect.name`` with the variances of their intervals; without effects that of the
            default estimator.
        ranges: Least and greatest ``angle``, ``velocity`` and ``moment`` of the load in the
            recordings that were fitted, at the bandwidth of the fit.
        model: The corrected model, for predictions and simulations; None of a gas generator.
    """

    verdict: Verdict
    statement: str
    effects: tuple[IdentifiedEffect, ...]
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
    alpha: float = 2.0
    covariance: Spread = NO_SPREAD
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    model: CorrectedModel | None = None

    @property
    def misfit(self) -> tuple[Misfit, ...]:
        """Ways in which the corrected model fails the recordings, the gravest first (``fit``)."""
        fit = self.fit
        signs = {
            Misfit.EXPLAINS_LITTLE: (fit.relative or 0.0) ** 2 > 1.0 - LEAST_EXPLAINED,
            Misfit.ABOVE_FLOOR: 0.0 < MOST_FLOORS * fit.noise_floor_rms < fit.final_rms,
        }
        return tuple(code for code, holds in signs.items() if holds)

    @property
    def values(self) -> dict[str, float]:
        """Name to value of the identifiable nominal parameters, and of the ``effect.name`` ones."""
        known = {n: v for n, v in self.parameters.items() if n in self.parameter_shift}
        nominal = {n: v for n, v in known.items() if self.parameter_shift[n].after is not None}
        return {
            **nominal,
            **{f"{e.name}.{n}": own.value for e in self.effects for n, own in e.parameters.items()},
        }

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Name to 90 % interval, of the names of ``values`` that have one."""
        half = {n: self.covariance.half_width(n) for n in self.covariance.names}
        nominal = {n: (v - half[n], v + half[n]) for n, v in self.values.items() if n in half}
        effects = {
            f"{e.name}.{n}": (own.low, own.high)
            for e in self.effects
            for n, own in e.parameters.items()
        }
        return {**nominal, **effects}

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters of ``covariance``, shape (p, p)."""
        return self.covariance.correlation

    @property
    def residuals(self) -> dict[str, Array]:
        """Name of each fitted recording to the error of the corrected model in the equation of
        ``fit``, at the samples of its :class:`ResidualTrace`.
        """
        return {t.recording: t.after for t in self.traces if t.equation == self.fit.equation}

    def to_dict(self) -> dict[str, Any]:
        """Return the result as values for JSON, with the keys of ``rig diagnose --json``."""
        return {**plain(self, *NOT_WRITTEN), "misfit": [str(code) for code in self.misfit]}
