"""Compares several optimisers on the paper's equation error with the default identification method.

An optimiser fails if its final cost is more than 0.1 % above the least cost that any optimiser
found; it then ended in a wrong basin, or before convergence. (For the 2000 samples of a stage of 20
s, a cost 0.1 % above the least corresponds to two standard errors with white noise.) The difference
between the parameters of least cost and the true parameters is an error of the equation-error
method, not of an optimiser.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from identification.estimate.paper_method.optimisers import OPTIMISERS, Optimiser
from identification.estimate.paper_method.stage_problem import StageProblem
from identification.numerics.arrays import Array
from identification.prepare import prepare
from identification.recording import Dataset, RecordingError
from identification.result import Identification

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
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Contender, ...]:
    """Run every optimiser on the recordings to which the default method was fitted.

    Args:
        dataset: Recordings with role ``fit``, at least one of them unloaded; the declared model has
            the nine nominal parameters.
        default: Result of the default method on the dataset; the comparison uses its bandwidth, and
            its values as the reference.
        seeds: Random seeds; a stochastic optimiser is run once per seed.
        truth: True parameters of a simulated bench; used only for the tables, after all runs.
        progress: Called with the name of the optimiser and the share of its runs done.

    Returns:
        The default method first, then the optimisers in the order of :data:`OPTIMISERS`.

    Raises:
        RecordingError: The model has fixed values or declared terms, which the comparison does not
            support, or the joint does not move.
    """
    if dataset.model.fixed or dataset.model.terms:
        held = ", ".join((*dataset.model.fixed, *dataset.model.terms))
        raise RecordingError(
            "a comparison of optimisers needs the nominal model; remove model.fixed and "
            f"model.terms ({held})"
        )
    prepared = [prepare(r, default.fit.bandwidth_Hz) for r in dataset.part("fit")]
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
    reference = default.values()
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
    """Return the greatest relative error over the common parameters, and the name of the parameter
    with this error.
    """
    errors = [
        (abs(values[n] / v - 1.0), n) for n, v in reference.items() if n in values and v != 0.0
    ]
    return max(errors, default=(0.0, ""))
