"""The identification method of the paper (Sec. 4): a genetic algorithm on the equation error.

The equation error of eq. 15/16 is minimised in two stages. Stage 1 uses the unloaded recordings and
searches x = [Mc, Ms, omega_sf, sigma_2, J]; stage 2 uses the loaded recordings, keeps these five
parameters fixed and searches x = [mu_c, mu_s, omega_sL, mu_2]. The fitness is sqrt(sum e(k)^2), the
targets are 0.01 and 0.015 N m, and the population of 40 has at most 1000 generations (Sec. 4.2).

This module defines three points that the paper does not state. Friction opposes motion, so eq. 13
and 15 contain sgn(omega). Samples at rest are omitted, because at rest friction and drive torque
obey an inequality and not an equation. The search box follows from the size of the recorded signals
(:func:`search_box`). The method computes no intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.equation_error.regression import require_motion
from identification.estimate.paper_method.torque_misfit import TorqueMisfit
from identification.estimate.uncertainty.parameter_table import fit_of, trace_of, units_of
from identification.model.friction import system_friction
from identification.model.ladder import NOMINAL
from identification.model.parameters import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.numerics.arrays import Array
from identification.numerics.genetic_algorithm import GeneticAlgorithm, GeneticSettings
from identification.prepare import Prepared, default_bandwidth, prepare, torque_unit
from identification.recording import Dataset, Model, RecordingError
from identification.result import Convergence, Identification, Parameter

TARGETS: Mapping[str, float] = {"unloaded": 0.01, "loaded": 0.015}
"""Fitness at which the search of each stage stops early, N m (Sec. 4.2.1, 4.2.2)."""
POPULATION = 40
GENERATIONS = 1000
_AT_BOUND = 1e-3  # distance from a bound, relative to the width of the box

STAGES: Mapping[str, tuple[str, ...]] = {"unloaded": SYSTEM_PARAMETERS, "loaded": LOAD_PARAMETERS}
"""Parameters that each stage searches: Coulomb level, static level, Stribeck speed, viscous
coefficient, and J in the unloaded stage.
"""

Progress = Callable[[str, float], None]


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

    Args:
        dataset: Recordings of one bench.
        bandwidth_Hz: Bandwidth of the filter that all signals pass, or None for the least of the
            default bandwidths of the fitted recordings.
        rng: Source of all randomness.
        progress: Called with the stage and the share of the stage's generations that is done.
        generations: Greatest number of generations per stage.

    Raises:
        RecordingError: There is no unloaded recording to fit, or the joint does not move in a
            recording.
    """
    if bandwidth_Hz is None:
        bandwidth_Hz = min((default_bandwidth(r) for r in dataset.part("fit")), default=None)
    prepared = [prepare(recording, bandwidth_Hz) for recording in dataset.recordings]
    alpha = dataset.model.alpha
    warnings = _left_out(dataset.model)
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
    """Return a warning about declared terms that the paper's method does not contain.

    Raises:
        RecordingError: A friction model other than that of the paper is declared.
    """
    if model.friction != NOMINAL:
        raise RecordingError(
            f"the paper's method supports only the friction model {NOMINAL}; for the model "
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
        """Return the values and estimates of one stage, and the record of its search; if all
        parameters are fixed, there is no search and no record.
        """
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
        """Run the genetic algorithm on one stage and record its best point after every
        generation.
        """
        alpha = self.dataset.model.alpha
        misfit = TorqueMisfit(
            samples.torque, samples.velocity, samples.acceleration, samples.load, alpha
        )
        low, high = zip(*box.values(), strict=True)
        settings = GeneticSettings(population=POPULATION, generations=self.generations)
        algorithm = GeneticAlgorithm(low, high, self.rng, settings)
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
    """Return the equations of one stage; in the loaded stage the terms of the system parameters are
    subtracted from the torque.

    Raises:
        RecordingError: There is too little motion, or a loaded recording has no contact force.
    """
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
    """Return one parameter; J is not identifiable if the torque of the inertia is smaller than the
    torque error of the fit.
    """
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
