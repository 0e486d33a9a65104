"""The identification method of the paper (genetic algorithm), and a comparison of optimisers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from identification.estimate import equation_error as projection
from identification.estimate.bandwidth import choose_bandwidth
from identification.estimate.equation_error import require_motion
from identification.estimate.parameter_table import fit_of, trace_of, units_of
from identification.model.friction import stribeck_shape, system_friction
from identification.model.parameters import LOAD_PARAMETERS, PAPER_FRICTION, SYSTEM_PARAMETERS
from identification.numerics.arrays import Array, Progress
from identification.numerics.least_squares import Design
from identification.numerics.optimisers import (
    GENERATIONS,
    POPULATION,
    GeneticAlgorithm,
    cma_es,
    differential_evolution,
    genetic_algorithm,
    multi_start,
)
from identification.prepare import Prepared, prepare, torque_unit
from identification.recording import Dataset, Model, RecordingError
from identification.result import Convergence, Identification, Parameter

_CHUNK = 2048  # samples per block, so that a population's block fits into the processor's cache
_LOG_NEGLIGIBLE = -80.0  # exp(-80) is negligible against 1; below -708 it would be a denormal


class TorqueMisfit:
    """sqrt(sum e^2) with e = torque - load (sgn(w) (c + (s - c) exp(-|w/w_s|^alpha)) + v w) - J dw.

    Args:
        torque: Drive torque less known torques, N m, shape (n,).
        velocity: w, rad/s, shape (n,); samples at rest must be omitted, because at rest friction is
            not a function of speed.
        acceleration: dw, rad/s^2, shape (n,).
        load: Factor on the friction terms, shape (n,): 1 for the system load (eq. 9), F_P L1 in N m
            for the working load (eq. 13).
        alpha: Stribeck exponent.
    """

    def __init__(
        self, torque: Array, velocity: Array, acceleration: Array, load: Array, alpha: float
    ) -> None:
        dry = load * np.sign(velocity)
        features = np.stack([torque, dry, load * velocity, acceleration], axis=1)
        self.samples = len(torque)
        self._speed = np.abs(velocity) ** alpha
        self._alpha = alpha
        self._gram = features.T @ features
        self._products = dry[:, None] * features
        self._square = dry * dry

    def norms(self, c: Array, s: Array, w_s: Array, v: Array, inertia: Array) -> Array:
        """Return the norm for every candidate; all arguments have shape (p,).

        Cancellation between the sums limits the accuracy of the result to about 1e-8 of the norm of
        the torque.

        Args:
            c: Coulomb level (Mc or mu_c).
            s: Static level (Ms or mu_s).
            w_s: Stribeck speed, rad/s, above 0.
            v: Viscous coefficient (sigma_2 or mu_2).
            inertia: J, kg m^2.
        """
        rates = -(w_s**-self._alpha)
        linear = np.zeros((len(c), 4))
        square = np.zeros(len(c))
        for start in range(0, self.samples, _CHUNK):
            block = slice(start, start + _CHUNK)
            decay = np.multiply.outer(rates, self._speed[block])
            np.exp(np.maximum(decay, _LOG_NEGLIGIBLE, out=decay), out=decay)
            linear += decay @ self._products[block]
            square += np.multiply(decay, decay, out=decay) @ self._square[block]
        weights = np.stack([np.ones_like(c), -c, -v, -inertia], axis=1)
        constant = np.einsum("pi,ij,pj->p", weights, self._gram, weights)
        excess = s - c
        total = (
            constant - 2.0 * excess * np.einsum("pi,pi->p", weights, linear) + excess**2 * square
        )
        return np.asarray(np.sqrt(np.maximum(total, 0.0)))


TARGETS: Mapping[str, float] = {"unloaded": 0.01, "loaded": 0.015}
"""Fitness at which the search of each stage stops early, N m (Sec. 4.2.1, 4.2.2)."""
_AT_BOUND = 1e-3  # distance from a bound, relative to the width of the box

STAGES: Mapping[str, tuple[str, ...]] = {"unloaded": SYSTEM_PARAMETERS, "loaded": LOAD_PARAMETERS}
"""Parameters that each stage searches; the unloaded stage also searches J."""


@dataclass(frozen=True)
class StageSamples:
    """The equations of one stage, without samples at rest; every array has shape (n,)."""

    torque: Array
    velocity: Array
    acceleration: Array
    load: Array


def identify_paper(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator,
    progress: Progress | None = None,
    generations: int = GENERATIONS,
) -> Identification:
    """Identify a dataset by the paper's method.

    ``bandwidth_Hz``: bandwidth of the filter that all signals pass, or None for the one that
    :func:`identification.estimate.bandwidth.choose_bandwidth` chooses. ``progress``: called with
    the stage and the share of the stage's generations that is done. ``generations``: greatest
    number of generations per stage.
    """
    dataset, bandwidth_Hz, short = choose_bandwidth(dataset, bandwidth_Hz)
    prepared = [prepare(recording, bandwidth_Hz) for recording in dataset.recordings]
    alpha = dataset.model.alpha
    warnings = (*_left_out(dataset.model), *short)
    search = _Search(dataset, generations, rng, progress)
    known: dict[str, float] = {}
    parameters: dict[str, Parameter] = {}
    stages: list[Convergence] = []
    for stage in STAGES:
        chosen = [p for p in prepared if p.recording.role == "fit" and p.recording.stage == stage]
        if stage == "loaded" and not chosen:
            continue
        if not chosen:
            raise RecordingError(
                "no unloaded recording has role fit; the paper's method needs at least one (stage: "
                "unloaded)"
            )
        found, estimates, convergence = search.solve(stage, chosen, known)
        known |= found
        parameters |= estimates
        stages += convergence
    fitted = [p for p in prepared if p.recording.role == "fit"]
    validate = [p for p in prepared if p.recording.role == "validate"]
    return Identification(
        method="paper",
        motion=dataset.recordings[0].bench.motion,
        alpha=alpha,
        parameters=parameters,
        fit=fit_of(fitted, known, alpha, validate),
        stages=tuple(stages),
        fitted=dict(known),
        warnings=warnings,
        traces=tuple(trace_of(p, known, alpha) for p in prepared),
        fits_by_recording={p.recording.name: fit_of([p], known, alpha) for p in prepared},
        evaluations=sum(s.evaluations for s in stages),
    )


def _left_out(model: Model) -> tuple[str, ...]:
    """Return a warning about declared terms; raise RecordingError for another friction model."""
    if model.friction != PAPER_FRICTION:
        raise RecordingError(
            f"the paper's method supports only the friction model {PAPER_FRICTION}; for the model "
            f"{model.friction} use the default method"
        )
    if not model.terms:
        return ()
    return (
        f"the paper's method does not fit the declared terms: {', '.join(model.terms)}; use the "
        "default method",
    )


@dataclass(frozen=True)
class _Search:
    """Settings and search, the same for the unloaded and for the loaded stage."""

    dataset: Dataset
    generations: int
    rng: np.random.Generator
    progress: Progress | None

    def solve(
        self, stage: str, prepared: Sequence[Prepared], known: Mapping[str, float]
    ) -> tuple[dict[str, float], dict[str, Parameter], list[Convergence]]:
        """Return values, estimates and record of one stage; no record if all is fixed."""
        names, fixed = STAGES[stage], self.dataset.model.fixed
        units = units_of(prepared)
        held = {name: fixed[name] for name in names if name in fixed}
        kept = {
            n: Parameter(n, units[n], value, reason="fixed by the campaign")
            for n, value in held.items()
        }
        if len(held) == len(names):
            return held, kept, []
        samples = collect(stage, prepared, known, self.dataset.model.alpha)
        box = {
            name: bounds for name, bounds in search_box(samples, names).items() if name not in held
        }
        done = self._run(stage, samples, box, held)
        found = {name: float(history[-1]) for name, history in done.parameter_history.items()}
        estimates = {n: _parameter(n, found[n], units[n], box[n], samples, done.cost) for n in box}
        both = kept | estimates
        return held | found, {name: both[name] for name in names}, [done]

    def _run(
        self,
        stage: str,
        samples: StageSamples,
        box: Mapping[str, tuple[float, float]],
        held: Mapping[str, float],
    ) -> Convergence:
        """Run the genetic algorithm on one stage, and record its best point by generation."""
        alpha = self.dataset.model.alpha
        misfit = TorqueMisfit(
            samples.torque, samples.velocity, samples.acceleration, samples.load, alpha
        )
        low, high = zip(*box.values(), strict=True)
        algorithm = GeneticAlgorithm(low, high, self.rng, self.generations)
        target = TARGETS[stage]
        costs: list[float] = []
        history: list[Array] = []
        constant = {
            name: np.full(POPULATION, value) for name, value in ({"J": 0.0} | dict(held)).items()
        }
        while not algorithm.stop and algorithm.best_cost > target:
            columns = constant | dict(zip(box, algorithm.ask().T, strict=True))
            c, s, w_s, v = (columns[name] for name in STAGES[stage][:4])
            algorithm.tell(misfit.norms(c, s, w_s, v, columns["J"]))
            costs.append(algorithm.best_cost)
            history.append(algorithm.best)
            if self.progress is not None:
                self.progress(stage, algorithm.generation / self.generations)
        return Convergence(
            stage=stage,
            method=f"genetic algorithm over {misfit.samples} samples",
            evaluations=POPULATION * algorithm.generation,
            generations=algorithm.generation,
            cost=algorithm.best_cost,
            cost_unit=torque_unit(self.dataset.recordings[0]),
            target=target,
            reached=algorithm.best_cost <= target,
            cost_history=np.array(costs),
            parameter_history=dict(zip(box, np.array(history).T, strict=True)),
        )


def search_box(samples: StageSamples, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the search box, which depends only on the size of the signals.

    The upper bound of dry friction is twice the largest torque (under load, the largest ratio of
    torque to contact moment), because a breakaway may lie between two samples. The upper bounds of
    viscous friction and inertia are the values that explain the largest torque at the largest speed
    and at the largest acceleration. The Stribeck speed ranges from 1/500 of the largest speed to
    the largest speed.
    """
    torque = float(np.max(np.abs(samples.torque / samples.load)))
    speed = float(np.max(np.abs(samples.velocity)))
    coulomb, static, stribeck, viscous, *inertia = names
    box = {
        coulomb: (0.0, 2.0 * torque),
        static: (0.0, 2.0 * torque),
        stribeck: (speed / 500.0, speed),
        viscous: (0.0, torque / speed),
    }
    for name in inertia:
        box[name] = (0.0, torque / float(np.max(np.abs(samples.acceleration))))
    return box


def collect(
    stage: str, prepared: Sequence[Prepared], known: Mapping[str, float], alpha: float
) -> StageSamples:
    """Return the equations of a stage; the loaded stage's are less the system's terms."""
    require_motion(prepared)
    parts = []
    for p in prepared:
        rows = np.flatnonzero(p.used & (p.velocity != 0.0))
        torque, load = p.torque[rows], np.ones(len(rows))
        if stage == "loaded":
            torque = (
                torque
                - system_friction(p.velocity[rows], known, alpha)
                - known["J"] * p.acceleration[rows]
            )
            load = p.moment[rows]
        parts.append((torque, p.velocity[rows], p.acceleration[rows], load))
    samples = StageSamples(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    if not np.all(samples.load > 0.0):
        names = ", ".join(p.recording.name for p in prepared)
        raise RecordingError(
            f"{names}: these recordings are loaded, but the contact force is not above 0 N at all "
            "samples; state weight_mass"
        )
    return samples


def _parameter(
    name: str,
    value: float,
    unit: str,
    bounds: tuple[float, float],
    samples: StageSamples,
    cost: float,
) -> Parameter:
    """Return one parameter; J is withheld if its torque is below the torque error."""
    inertial = value * float(np.linalg.norm(samples.acceleration))
    if name == "J" and inertial < cost:
        reason = (
            f"the torque of the inertia, {inertial:.3g} (norm over the samples), is below the "
            f"torque error of the fit, {cost:.3g}; record a motion with higher acceleration"
        )
        return Parameter(name, unit, None, identifiable=False, reason=reason)
    low, high = bounds
    near = min(value - low, high - value) < _AT_BOUND * (high - low)
    return Parameter(
        name, unit, value, at_bound=near, reason="at the edge of the search box" if near else ""
    )


class StageProblem:
    """Cost and residuals of one stage over the unit cube, with a counter of evaluations.

    Args:
        known: The system parameters, which are fixed in the search of the loaded stage.
    """

    def __init__(
        self, stage: str, prepared: Sequence[Prepared], known: Mapping[str, float], alpha: float
    ) -> None:
        self.stage = stage
        self.names = STAGES[stage]
        self.samples: StageSamples = collect(stage, prepared, known, alpha)
        box = search_box(self.samples, self.names)
        self.low = np.array([box[name][0] for name in self.names])
        self.high = np.array([box[name][1] for name in self.names])
        self.evaluations = 0
        self._alpha = alpha
        s = self.samples
        self._misfit = TorqueMisfit(s.torque, s.velocity, s.acceleration, s.load, alpha)
        self._dry = s.load * np.sign(s.velocity)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    def named(self, x: Array) -> dict[str, float]:
        """Return the parameters at ``x`` of the unit cube, shape (d,), by name."""
        return dict(zip(self.names, (float(v) for v in self._physical(x)), strict=True))

    def costs(self, x: Array) -> Array:
        """Return the cost of every row of ``x``, shape (p, d), N m."""
        self.evaluations += len(x)
        coulomb, static, speed, viscous, *inertia = self._physical(x).T
        return self._misfit.norms(
            coulomb, static, speed, viscous, inertia[0] if inertia else np.zeros(len(x))
        )

    def residuals(self, x: Array) -> Array:
        """Return the torque error of every sample at ``x``, shape (d,), N m."""
        self.evaluations += 1
        coulomb, static, speed, viscous, *inertia = self._physical(x)
        s = self.samples
        shape = stribeck_shape(s.velocity, speed, self._alpha)
        friction = (
            s.load * ((static - coulomb) * shape + viscous * s.velocity) + coulomb * self._dry
        )
        return np.asarray(s.torque - friction - (inertia[0] if inertia else 0.0) * s.acceleration)

    def design(self, omega_s: float) -> Design:
        """Return the linear problem at one Stribeck speed, with the rise for the static level."""
        s = self.samples
        shape = s.load * stribeck_shape(s.velocity, omega_s, self._alpha)
        columns = [self._dry, shape, s.load * s.velocity]
        columns += [s.acceleration] if self.size > 4 else []
        kept = [0, 1, 3, 4][: len(columns)]
        self.evaluations += 1
        return Design(np.column_stack(columns), s.torque, np.zeros(len(columns)), self.high[kept])

    def unlinear(self, omega_s: float, coefficients: Array) -> Array:
        """Return a solution of :meth:`design` as a point of the unit cube, shape (d,)."""
        coulomb, rise, *others = coefficients
        physical = np.array([coulomb, coulomb + rise, omega_s, *others])
        return np.asarray((physical - self.low) / (self.high - self.low))

    def _physical(self, x: Array) -> Array:
        return np.asarray(self.low + x * (self.high - self.low))


Optimiser = Callable[[StageProblem, np.random.Generator], Array]
"""Function of a problem and a random generator that returns the best point in the unit cube."""


def variable_projection(problem: StageProblem, rng: np.random.Generator) -> Array:
    """Search the Stribeck speed alone; linear least squares give the other coordinates."""
    solution = projection.solve(problem.design, problem.low[2], problem.high[2])
    return problem.unlinear(solution.omega_s, solution.coefficients)


OPTIMISERS: Mapping[str, Optimiser] = {
    "variable projection": variable_projection,
    "genetic algorithm": genetic_algorithm,
    "differential evolution": differential_evolution,
    "CMA-ES": cma_es,
    "multi-start least squares": multi_start,
}
"""The optimisers by name; the default method uses the first of them."""


COST_TOLERANCE = 1e-3
"""Relative excess of the final cost over the least cost, above which a search counts as failed."""
DEFAULT = "default method"


@dataclass(frozen=True)
class Contender:
    """One estimator over all its runs, one per seed.

    Attributes:
        name: Name of the estimator.
        runs: Number of seeds tried; a deterministic optimiser is run once.
        failures: Number of runs that failed in the unloaded or in the loaded stage.
        evaluations: Evaluations of the cost in both stages, median over the runs.
        seconds: Computing time, s, median over the runs.
        excess: Relative excess of the final cost over the least cost, in the stage with the greater
            excess, median over the runs; None for the default method, which continues with
            prediction errors.
        values: Parameters of the run with the median error.
        error: Greatest relative difference from the default method among the parameters that the
            default method identifies, median over the runs.
        worst: Parameter with this difference.
        true_error: Greatest relative error against the true parameters, if these are known, median
            over the runs.
        true_worst: Parameter with this error.
    """

    name: str
    runs: int
    failures: int
    evaluations: int
    seconds: float
    excess: float | None
    values: Mapping[str, float]
    error: float
    worst: str
    true_error: float | None = None
    true_worst: str | None = None


@dataclass(frozen=True)
class _Run:
    values: dict[str, float]
    costs: tuple[float, ...]
    evaluations: int
    seconds: float


def compare(
    dataset: Dataset,
    default: Identification,
    *,
    seeds: Sequence[int] = (0,),
    truth: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> tuple[Contender, ...]:
    """Run every optimiser on the recordings to which the default method was fitted.

    ``dataset``: recordings with role ``fit``, at least one of them unloaded; the declared model has
    the nine nominal parameters. ``default``: result of the default method on the dataset; the
    comparison uses its bandwidth, and its values as the reference. ``truth``: true parameters of a
    simulated bench; used only for the tables, after all runs.

    Returns:
        The default method first, then the optimisers in the order of :data:`OPTIMISERS`.
    """
    if dataset.model.fixed or dataset.model.terms:
        held = ", ".join((*dataset.model.fixed, *dataset.model.terms))
        raise RecordingError(
            "a comparison of optimisers needs the nominal model; remove model.fixed and "
            f"model.terms ({held})"
        )
    dataset, bandwidth_Hz, _ = choose_bandwidth(dataset, default.fit.bandwidth_Hz)
    prepared = [prepare(r, bandwidth_Hz) for r in dataset.part("fit")]
    stages = {s: [p for p in prepared if p.recording.stage == s] for s in ("unloaded", "loaded")}
    alpha = dataset.model.alpha
    problems = [StageProblem("unloaded", stages["unloaded"], {}, alpha)]
    first, rng = next(iter(OPTIMISERS.values())), np.random.default_rng(0)
    if stages["loaded"]:
        known = problems[0].named(first(problems[0], rng))
        problems.append(StageProblem("loaded", stages["loaded"], known, alpha))
    runs: dict[str, list[_Run]] = {}
    for name, optimiser in OPTIMISERS.items():
        tried = seeds if optimiser is not first else seeds[:1]
        for k, seed in enumerate(tried):
            runs.setdefault(name, []).append(_run(problems, optimiser, np.random.default_rng(seed)))
            if progress is not None:
                progress(name, (k + 1) / len(tried))
    least = [
        min(run.costs[k] for each in runs.values() for run in each) for k in range(len(problems))
    ]
    reference = default.values
    whole = _contender(
        DEFAULT, [_Run(reference, (), default.evaluations, default.seconds)], (), reference, truth
    )
    return whole, *(_contender(name, each, least, reference, truth) for name, each in runs.items())


def _run(problems: Sequence[StageProblem], optimiser: Optimiser, rng: np.random.Generator) -> _Run:
    began, before = perf_counter(), sum(p.evaluations for p in problems)
    points: list[Array] = [optimiser(problem, rng) for problem in problems]
    seconds, spent = perf_counter() - began, sum(p.evaluations for p in problems) - before
    costs = tuple(
        float(np.linalg.norm(p.residuals(x))) for p, x in zip(problems, points, strict=True)
    )
    values = {n: v for p, x in zip(problems, points, strict=True) for n, v in p.named(x).items()}
    return _Run(values, costs, spent, seconds)


def _contender(
    name: str,
    runs: Sequence[_Run],
    least: Sequence[float],
    reference: Mapping[str, float],
    truth: Mapping[str, float] | None,
) -> Contender:
    excesses = [
        max((c / b - 1.0 for c, b in zip(run.costs, least, strict=True)), default=0.0)
        for run in runs
    ]
    ranked = sorted((_worst(run.values, reference), k) for k, run in enumerate(runs))
    (error, worst), middle = ranked[(len(ranked) - 1) // 2]
    true = (
        None
        if truth is None
        else sorted(_worst(run.values, truth) for run in runs)[(len(runs) - 1) // 2]
    )
    return Contender(
        name=name,
        runs=len(runs),
        failures=sum(excess > COST_TOLERANCE for excess in excesses),
        evaluations=round(median(run.evaluations for run in runs)),
        seconds=median(run.seconds for run in runs),
        excess=median(excesses) if least else None,
        values=runs[middle].values,
        error=error,
        worst=worst,
        true_error=None if true is None else true[0],
        true_worst=None if true is None else true[1],
    )


def _worst(values: Mapping[str, float], reference: Mapping[str, float]) -> tuple[float, str]:
    """Return the greatest relative error over the common parameters, and its parameter."""
    errors = [
        (abs(values[n] / v - 1.0), n) for n, v in reference.items() if n in values and v != 0.0
    ]
    return max(errors, default=(0.0, ""))
