"""Results of an estimator: values with intervals, fit errors, searches and traces for a report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.numerics.arrays import Array, finite, plain
from identification.numerics.spread import NO_SPREAD, Spread

WIDEST = 0.5
"""Half width of the 90 % interval over the value above which a parameter is not determined."""


@dataclass(frozen=True)
class Parameter:
    """One estimate with its 90 % interval.

    ``value``, ``low`` and ``high`` are None where ``identifiable`` is False; ``reason`` then states
    why. ``floor`` is the least half width of the interval by the Cramer-Rao bound, or None if it
    was not computed.
    """

    name: str
    unit: str
    value: float | None
    low: float | None = None
    high: float | None = None
    identifiable: bool = True
    at_bound: bool = False
    reason: str = ""
    floor: float | None = None

    @property
    def determined(self) -> bool:
        """Whether the interval, which contains what the model lacks, is narrow enough to say that
        the value is known; an offset, which may be zero, is judged by the torque instead.
        """
        if self.value is None or self.low is None or self.high is None:
            return False
        half = 0.5 * (self.high - self.low)
        return self.name == "offset" or half <= WIDEST * abs(self.value)


@dataclass(frozen=True)
class Fit:
    """Torque error at the stated bandwidth.

    A value ``*_relative`` is the norm of the residual over the norm of the torque.
    ``noise_floor_rms`` is the part of the error that no model can explain: the noise by third
    differences, or what differs between periods of the command, the greater of both; None if it was
    not computed.
    """

    unit: str
    bandwidth_Hz: float
    train_rms: float
    train_relative: float
    validate_rms: float | None = None
    validate_relative: float | None = None
    noise_floor_rms: float | None = None

    @property
    def explained(self) -> float:
        """Share of the torque's power that the fit explains."""
        return 1.0 - self.train_relative**2

    @property
    def floors(self) -> float | None:
        """Ratio of the error to the noise floor, or None if the floor is unknown or zero."""
        return self.train_rms / self.noise_floor_rms if self.noise_floor_rms else None

    @property
    def discrepancy_rms(self) -> float:
        """Rms of the error beyond the noise floor; zero if the floor is unknown."""
        floor = self.train_rms if self.noise_floor_rms is None else self.noise_floor_rms
        return math.sqrt(max(self.train_rms**2 - floor**2, 0.0))


class Misfit(StrEnum):
    """Ways in which a model does not describe the recordings."""

    AT_BOUNDS = "at_bounds"
    EXPLAINS_LITTLE = "explains_little"
    ABOVE_FLOOR = "above_noise_floor"


HEADLINES = {
    Misfit.EXPLAINS_LITTLE: "This model does not describe this machine",
    Misfit.AT_BOUNDS: "The fit has no friction or no inertia where the model has some",
    Misfit.ABOVE_FLOOR: "The model leaves more than noise",
}
LEAST_EXPLAINED = 0.5
"""Share of the torque's power that a model must explain to describe the machine."""
MOST_FLOORS = 1.5
"""Ratio of the error to the noise floor up to which a model describes the recordings."""
FOUNDATION = ("Mc", "sigma_2", "J", "mu_c")
"""Parameters without which the model has no friction or no inertia."""


@dataclass(frozen=True)
class Convergence:
    """Record of the search of one part of the fit: unloaded, loaded or joint.

    Attributes:
        stage: ``unloaded``, ``loaded`` or ``joint``.
        method: Name of the optimiser.
        evaluations: Residual evaluations spent.
        generations: Generations or iterations spent.
        cost: Final cost, in ``cost_unit``.
        target: Cost at which the search stops early, or None.
        reached: Whether the target was reached; None without a target.
        cost_history: Best cost after each generation, shape (g,).
        parameter_history: Name to best value after each generation, shape (g,).
    """

    stage: str
    method: str
    evaluations: int
    generations: int
    cost: float
    cost_unit: str
    target: float | None = None
    reached: bool | None = None
    cost_history: Array | None = None
    parameter_history: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Starts:
    """Search ends: final cost of each start of one search.

    Attributes:
        stage: ``unloaded`` or ``loaded``.
        cost: Name of the quantity that was compared.
        ends: Final cost of each start, in the order they were tried.
        reached: Limit of the cost up to which a start counts as having reached the best end.
        absolute: Whether ``reached`` is a fixed cost that ends the search; otherwise ``reached`` is
            a margin above the least final cost.
    """

    stage: str
    cost: str
    ends: tuple[float, ...]
    reached: float
    absolute: bool = False

    @property
    def best(self) -> int:
        """Number of starts that reached the best end."""
        return sum(end <= self.reached for end in self.ends)


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one parameter, with all other parameters optimised at each point.

    Attributes:
        name: Name of the parameter.
        unit: Unit of ``values``.
        values: Values at which the parameter was held, rising, shape (n,).
        deviance: Deviance at these values less the deviance at the estimate, shape (n,).
        low: Lower end of the 90 % range, or None if ``values`` do not reach it.
        high: Upper end of the 90 % range, or None if ``values`` do not reach it.
        scale: Factor applied to the deviance, so that its curvature agrees with the interval.
    """

    name: str
    unit: str
    values: Array
    deviance: Array
    low: float | None
    high: float | None
    scale: float

    def moved(self, by: float) -> Profile:
        """Return the profile with its values shifted by ``by``."""
        low, high = (None if end is None else end + by for end in (self.low, self.high))
        return replace(self, values=self.values + by, low=low, high=high)


@dataclass(frozen=True)
class Tradeoff:
    """Two parameters that correlate strongly, and the combination that is determined.

    Attributes:
        names: Names of the two parameters.
        correlation: Correlation of their estimates.
        statement: Text with the combination that is determined.
    """

    names: tuple[str, str]
    correlation: float
    statement: str


@dataclass(frozen=True)
class Trace:
    """Signals of one recording in the fit, all at the stated bandwidth, shape (n,)."""

    recording: str
    role: str
    stage: str
    time: Array
    angle: Array
    velocity: Array
    torque: Array
    torque_model: Array
    friction: Array
    used: NDArray[np.bool_]


@dataclass(frozen=True)
class Resampled:
    """Spread of one parameter over bootstrap samples of the motion segments.

    Attributes:
        name: Name of the parameter.
        unit: Unit of the parameter.
        low: Lower end of the central 90 % of the bootstrap samples, or None if the equations of too
            few samples could be solved.
        high: Upper end of the central 90 % of the bootstrap samples, or None as for ``low``.
        draws: Number of bootstrap samples.
        solved: Number of samples whose equations could be solved.
    """

    name: str
    unit: str
    low: float | None
    high: float | None
    draws: int
    solved: int

    def moved(self, by: float) -> Resampled:
        """Return the result with its bounds shifted by ``by``."""
        low, high = (None if end is None else end + by for end in (self.low, self.high))
        return replace(self, low=low, high=high)


@dataclass(frozen=True)
class MeasuredNoise:
    """Noise of the measurement, as estimated from the prediction errors.

    Attributes:
        torque: White noise of the measured torque, a mean over one period, rms in ``unit``.
        correlated: Correlated noise of the torque, a first-order process, rms in ``unit``; zero if
            the fit has no correlated noise.
        correlation_s: Correlation time of the correlated noise, s.
        angle_rad: Noise of the joint angle in addition to the quantisation error, rad rms.
        encoder_step_rad: Quantisation step of the angle at the joint, rad.
        unit: Unit of the torque.
    """

    torque: float
    correlated: float
    correlation_s: float
    angle_rad: float
    encoder_step_rad: float
    unit: str


@dataclass(frozen=True)
class Prior:
    """The prior value of a parameter, its estimate from the recordings, and the combination of
    prior and estimate.

    Attributes:
        name: The parameter.
        value: Prior value.
        uncertainty: Standard deviation of the prior value.
        alone: Estimate from the recordings alone.
        alone_uncertainty: Standard deviation of this estimate.
        posterior: Combination of prior value and estimate.
        posterior_uncertainty: Standard deviation of the combination.
    """

    name: str
    value: float
    uncertainty: float
    alone: float
    alone_uncertainty: float
    posterior: float
    posterior_uncertainty: float


@dataclass(frozen=True)
class KnownConstant:
    """A constant that was given with an uncertainty, and the uncertainty that this constant adds to
    the estimates.

    Attributes:
        place: Place of the constant in a recording, such as ``bench.torque_constant``.
        value: The constant, SI.
        uncertainty: Standard deviation of the constant.
        shifts: Name of each parameter to the change of its estimate when the constant is raised by
            one standard deviation.
    """

    place: str
    value: float
    uncertainty: float
    shifts: Mapping[str, float]


@dataclass(frozen=True)
class Identification:
    """Result of one identification of one dataset by one method.

    Attributes:
        method: Name of the estimator.
        motion: ``rotary`` or ``linear``.
        alpha: Stribeck exponent.
        parameters: Name to estimate with its interval.
        fit: Torque error over all recordings.
        stages: Record of each search.
        warnings: Warnings about the result.
        traces: Signals of every recording.
        fits_by_recording: Torque error of every recording.
        evaluations: Residual evaluations spent.
        seconds: Wall-clock time spent.
        fitted: Name to the value at the end of the fit, including parameters that are not
            identifiable by themselves but are needed to simulate the fitted model.
        friction: Rung of :data:`identification.model.parameters.LADDER`.
        starts: Search ends of each search; empty if each search had one start only.
        tradeoffs: Pairs of parameters that correlate strongly.
        least_pinned: Text that states the least determined combination of parameters.
        noise: Noise of the measurement, or None if the refined values were not accepted.
        profiles: Profile likelihoods; empty unless requested.
        resampled: Spread over bootstrap samples; empty unless requested.
        known_constants: Constants given with an uncertainty. The intervals of ``parameters``
            include this uncertainty; profile likelihoods and bootstrap do not.
        priors: Prior values that were combined with the estimates from the recordings.
        covariance: Covariance of the identifiable parameters that were fitted, from which their
            intervals are made, with that of known constants, priors and unmodelled torque; without
            a name if the method has none.
        ranges: Least and greatest ``angle``, ``velocity`` and ``moment`` of the load in the
            recordings that were fitted, at the bandwidth of the fit.
    """

    method: str
    motion: str
    alpha: float
    parameters: Mapping[str, Parameter]
    fit: Fit
    stages: tuple[Convergence, ...]
    warnings: tuple[str, ...] = ()
    traces: tuple[Trace, ...] = ()
    fits_by_recording: Mapping[str, Fit] = field(default_factory=dict)
    evaluations: int = 0
    seconds: float = 0.0
    fitted: Mapping[str, float] = field(default_factory=dict)
    friction: str = "stribeck"
    starts: tuple[Starts, ...] = ()
    tradeoffs: tuple[Tradeoff, ...] = ()
    least_pinned: str = ""
    noise: MeasuredNoise | None = None
    profiles: tuple[Profile, ...] = ()
    resampled: tuple[Resampled, ...] = ()
    known_constants: tuple[KnownConstant, ...] = ()
    priors: tuple[Prior, ...] = ()
    covariance: Spread = NO_SPREAD
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def torque_unit(self) -> str:
        """Unit of the torques in ``traces``, also if the fit is in volts."""
        return self.parameters["Mc"].unit

    @property
    def bounded(self) -> tuple[str, ...]:
        """Names of the parameters of :data:`FOUNDATION` that are at their bounds."""
        return tuple(n for n in FOUNDATION if n in self.parameters and self.parameters[n].at_bound)

    @property
    def misfit(self) -> tuple[Misfit, ...]:
        """Ways in which the fitted model does not describe the recordings, the gravest first."""
        signs = {
            Misfit.EXPLAINS_LITTLE: self.fit.explained < LEAST_EXPLAINED,
            Misfit.AT_BOUNDS: bool(self.bounded),
            Misfit.ABOVE_FLOOR: (self.fit.floors or 0.0) > MOST_FLOORS,
        }
        return tuple(code for code, holds in signs.items() if holds)

    @property
    def misfit_words(self) -> str:
        """What is left beside torque and noise floor, and the constants at their bounds; empty if
        the model describes the recordings.
        """
        fit, parts = self.fit, []
        if Misfit.EXPLAINS_LITTLE in self.misfit:
            share = 100.0 * max(fit.explained, 0.0)
            parts.append(f"the fit explains {share:.3g} % of the torque's power")
        if Misfit.AT_BOUNDS in self.misfit:
            words = "are at their bounds 0" if len(self.bounded) > 1 else "is at its bound 0"
            parts.append(f"{', '.join(self.bounded)} {words}")
        if Misfit.ABOVE_FLOOR in self.misfit:
            parts.append(
                f"the error, {fit.train_rms:.3g} {fit.unit} rms at {fit.bandwidth_Hz:.3g} Hz, is "
                f"{fit.floors:.3g} times the noise floor, {fit.noise_floor_rms:.3g} {fit.unit}, "
                "and the intervals include what is left"
            )
        return "; ".join(parts)

    @property
    def values(self) -> dict[str, float]:
        """Name to value of the identifiable parameters."""
        return {name: p.value for name, p in self.parameters.items() if p.value is not None}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Name to 90 % interval of the identifiable parameters that were fitted."""
        return {
            name: (p.low, p.high)
            for name, p in self.parameters.items()
            if p.low is not None and p.high is not None
        }

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters of ``covariance``, shape (p, p)."""
        return self.covariance.correlation

    @property
    def residuals(self) -> dict[str, Array]:
        """Name of each recording to its torque less the model's, NaN at samples that the fit does
        not use, at the times of its :class:`Trace`.
        """
        return {
            t.recording: np.where(t.used, t.torque - t.torque_model, np.nan) for t in self.traces
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the result as values for JSON, with the keys of ``rig identify --json``."""
        return {
            "method": self.method,
            "motion": self.motion,
            "alpha": self.alpha,
            "friction": self.friction,
            "fitted": plain(self.fitted),
            "parameters": by_name(self.parameters.values()),
            "covariance": self.covariance.to_dict(),
            "ranges": plain(self.ranges),
            "fit": {**plain(self.fit), "explained": finite(self.fit.explained)},
            "misfit": [str(code) for code in self.misfit],
            "fit_by_recording": plain(self.fits_by_recording),
            "evaluations": self.evaluations,
            "stages": [plain(s, "cost_history", "parameter_history") for s in self.stages],
            "convergence": {
                s.stage: {"cost": plain(s.cost_history), "parameters": plain(s.parameter_history)}
                for s in self.stages
                if s.cost_history is not None
            },
            "warnings": list(self.warnings),
            "tradeoffs": plain(self.tradeoffs),
            "least_pinned": self.least_pinned,
            "noise": plain(self.noise),
            "bounds_hit": [p.name for p in self.parameters.values() if p.at_bound],
            "starts": [
                {**plain(s, "reached", "absolute"), "reached_best": s.best} for s in self.starts
            ],
            "profiles": by_name(self.profiles),
            "bootstrap": by_name(self.resampled),
            "priors": by_name(self.priors),
            "known_constants": plain(self.known_constants),
        }


def by_name(records: Iterable[Any]) -> dict[str, Any]:
    """Return records as values for JSON, by their names."""
    return {record.name: plain(record, "name") for record in records}
