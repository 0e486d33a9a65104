"""Identifies a source by the requested methods, and adds run time and provenance to the result."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from identification.estimate.covariance import uncertain_constants
from identification.estimate.default import identify_any_length
from identification.estimate.ladder import Rung, Transfer, climb, transfer
from identification.estimate.paper_method import Contender, compare, identify_paper
from identification.estimate.simulated_ladder import SimulatedRung, climb_simulated
from identification.model.parameters import LADDER, SIMULATED
from identification.numerics.arrays import Progress, finite, plain
from identification.recording import Dataset
from identification.result import Identification, by_name
from rig.common.places import is_folder
from rig.common.provenance import IDENTIFY_SCHEMA, Provenance, constants_of
from rig.results.measured import named_errors
from rig.runs.run_file import partial_names, partial_warnings, read_record, without_partial
from rig.runs.run_record import FEEDFORWARD_INPUT
from rig.sources import load_source
from rig.weighing.weight_check import comparable, off_label


class Method(Protocol):
    """Signature of an estimator as the commands call it."""

    def __call__(
        self,
        dataset: Dataset,
        *,
        bandwidth_Hz: float | None,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> Identification:
        """Identify a dataset."""
        ...


METHODS: Mapping[str, Method] = {"default": identify_any_length, "paper": identify_paper}
"""Estimators by the names of their methods on the command line."""
COMPARED_SEEDS = 5
"""Number of random seeds with which a comparison of methods runs each stochastic search."""
_FED = (
    "recorded with feed-forward: a joint that moves in pulses does not have the friction at its "
    "mean speed, and the recordings lack breakaways; static friction and Stribeck speeds may be "
    "wrong by tens of percent, outside their intervals; identify a run without feed-forward"
)


@dataclass(frozen=True)
class Outcome:
    """Result of ``rig identify``."""

    dataset: Dataset  # the identified dataset
    results: tuple[Identification, ...]
    provenance: Provenance
    ladder: tuple[Rung, ...] = ()  # all rungs of the ladder of friction models, if requested
    transfer: Transfer | None = None  # the first result scored on other recordings, if requested
    scored_on: Path | None = None  # source of the other recordings in `transfer`
    comparison: tuple[Contender, ...] = ()  # comparison of all estimators, if requested
    # The rungs fitted to the simulated angle, if requested and if the recordings can be simulated.
    simulated: tuple[SimulatedRung, ...] = ()


@dataclass(frozen=True)
class Request:
    """Settings of an identification."""

    # Names from `METHODS`; every method starts its random generator from `seed`.
    methods: Sequence[str] = ("default",)
    bandwidth_Hz: float | None = None  # bandwidth of the fit; None to choose it from the recordings
    seed: int = 0
    ladder: bool = False  # whether to fit and score every rung of the friction models as well
    score: Path | None = None  # another source to score the first result on
    profile: bool = False  # whether the default method profiles the likelihood of every parameter
    draws: int | None = None  # bootstrap draws of the default method, None for none
    # Whether to use unfinished excitations of a run as well; a warning in the result names these
    # excitations.
    partial: bool = False


def identify_source(source: Path, request: Request, progress: Progress) -> Outcome:
    """Identify a run folder or campaign file."""
    started = time.perf_counter()
    progress("reading", 0.0)
    dataset = load_source(source, partial=request.partial)
    other = None if request.score is None else load_source(request.score)
    warnings = _warnings(source, dataset)
    with named_errors(source, without_partial(dataset)):
        results = [
            _identified(dataset, method, request, warnings, progress) for method in request.methods
        ]
    rungs: tuple[Rung, ...] = ()
    simulated: tuple[SimulatedRung, ...] = ()
    if request.ladder:
        hertz, rng = request.bandwidth_Hz, np.random.default_rng(request.seed)
        with named_errors(source):
            rungs = climb(dataset, bandwidth_Hz=hertz, rng=rng, progress=progress)
            simulated = climb_simulated(dataset, bandwidth_Hz=hertz, progress=progress)
    carried = None
    if request.score is not None and other is not None:
        progress("scoring", 0.0)
        with named_errors(request.score):
            carried = transfer(results[0], dataset, other, np.random.default_rng(request.seed))
    read = (*dataset.recordings, *(other.recordings if other is not None else ()))
    tables = {**dataset.tables, **(other.tables if other is not None else {})}
    seconds = time.perf_counter() - started
    provenance = Provenance.of(request.seed, read, seconds, source, tables)
    return Outcome(
        dataset, tuple(results), provenance, rungs, carried, request.score, simulated=simulated
    )


def _identified(
    dataset: Dataset,
    method: str,
    request: Request,
    warnings: tuple[str, ...],
    progress: Progress,
) -> Identification:
    """Identify by one method, and measure the time."""
    begun = time.perf_counter()
    estimate = METHODS[method]
    if method == "default":
        estimate = partial(identify_any_length, profile=request.profile, draws=request.draws or 0)
    result = estimate(
        dataset,
        bandwidth_Hz=request.bandwidth_Hz,
        rng=np.random.default_rng(request.seed),
        progress=lambda stage, share: progress(f"{method}: {stage}", share),
    )
    constants = [c.place for c in uncertain_constants(dataset.part("fit"))]
    if (unused := [*constants, *dataset.model.priors]) and method != "default":
        ignored = f"the {method} method does not use the uncertainty of {', '.join(unused)}"
        warnings = (*warnings, ignored)
    return dataclasses.replace(
        result, seconds=time.perf_counter() - begun, warnings=(*result.warnings, *warnings)
    )


def _warnings(source: Path, dataset: Dataset) -> tuple[str, ...]:
    """Return the warnings on the recordings, which apply to the results of all methods."""
    off = tuple(weighing.message for weighing in off_label(dataset)) if comparable(dataset) else ()
    fed = is_folder(source) and FEEDFORWARD_INPUT in read_record(source).inputs
    return (*partial_warnings(dataset), *off, *((_FED,) if fed else ()))


def compare_methods(
    source: Path,
    outcome: Outcome,
    truth: Mapping[str, float] | None,
    progress: Progress,
) -> Outcome:
    """Return an outcome with all estimators compared; stochastic ones with several seeds."""
    started = time.perf_counter()
    seed = outcome.provenance.seed
    seeds = range(seed, seed + COMPARED_SEEDS)
    with named_errors(source):
        found = compare(
            outcome.dataset, outcome.results[0], seeds=seeds, truth=truth, progress=progress
        )
    spent = outcome.provenance.seconds + time.perf_counter() - started
    return dataclasses.replace(
        outcome, comparison=found, provenance=dataclasses.replace(outcome.provenance, seconds=spent)
    )


def outcome_record(outcome: Outcome) -> dict[str, Any]:
    """Return the record of ``rig identify --json``."""
    first, *others = outcome.results
    record = identification_record(first, outcome.provenance)
    record["corrections"] = {r.name: list(r.notes) for r in outcome.dataset.recordings if r.notes}
    record["partial"] = partial_names(outcome.dataset)
    record["constants"] = constants_of(outcome.dataset)
    if others:
        record["compared"] = [identification_record(r, outcome.provenance) for r in others]
    if outcome.ladder:
        record["ladder"] = ladder_record(outcome.ladder)
    if outcome.simulated:
        record["simulated_ladder"] = simulated_record(outcome.simulated)
    if outcome.transfer is not None:
        record["transfer"] = transfer_record(outcome.transfer, str(outcome.scored_on))
    if outcome.comparison:
        record["comparison"] = [
            {**plain(c, "excess"), "cost_above_least": finite(c.excess)} for c in outcome.comparison
        ]
    return record


def identification_record(result: Identification, provenance: Provenance) -> dict[str, Any]:
    """Return the record of one method."""
    return {**provenance.record(IDENTIFY_SCHEMA), **result.to_dict()}


def ladder_record(rungs: Sequence[Rung]) -> list[dict[str, Any]]:
    """Return the record under ``ladder``; errors of the angle in rad, or m if linear."""
    return [
        {
            "friction": rung.friction,
            "terms": list(LADDER[rung.friction]),
            "parameters": by_name(rung.result.parameters.values()),
            "fitted": plain(rung.result.fitted),
            "fit": plain(rung.result.fit),
            "angle_rms": None if rung.angle is None else rung.angle.angle_rms,
            "angle_mae": None if rung.angle is None else rung.angle.angle_mae,
        }
        for rung in rungs
    ]


def simulated_record(rungs: Sequence[SimulatedRung]) -> list[dict[str, Any]]:
    """Return the record under ``simulated_ladder``; errors of the angle in rad, or m if linear."""
    return [
        {
            "friction": rung.friction,
            "terms": list(SIMULATED[rung.friction]),
            "motor_constants": "free" if rung.free else "declared",
            "alpha": rung.alpha,
            "fitted": plain(rung.fitted),
            "train_mae": finite(rung.train),
            "cross_validated_mae": finite(rung.crossed),
            "validate_mae": finite(rung.scored),
            "horizon_s": finite(rung.horizon_s),
            "chosen": rung.chosen,
            "tied": rung.tied,
            "constants": {
                c.name: {
                    **plain(c, "name", "prior"),
                    "prior_relative_std": finite(c.prior),
                    "relative_change": finite(c.change),
                    "moved": c.moved,
                }
                for c in rung.constants
            },
        }
        for rung in rungs
    ]


def transfer_record(found: Transfer, source: str) -> dict[str, Any]:
    """Return the record under the key ``transfer`` of ``rig identify --json``."""
    floor = found.floor
    return {
        "source": source,
        "fit": plain(found.fit),
        "own": plain(found.own),
        "noise_floor_rms": None if floor is None else floor.rms,
        "noise_floor_samples": 0 if floor is None else floor.samples,
        "fit_by_recording": plain(found.by_recording),
        "parameters": {
            m.name: {
                "here": plain(m.first, "name"),
                "there": plain(m.second, "name"),
                "difference": m.difference,
                "joint": m.joint,
                "moved": m.moved,
            }
            for m in found.parameters
        },
    }
