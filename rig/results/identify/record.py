"""Converts an identification to the JSON record of ``rig identify --json``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from identification.estimate.ladder import Rung, Transfer
from identification.estimate.paper_method import Contender
from identification.estimate.simulated_ladder import SimulatedRung
from identification.model.parameters import LADDER, SIMULATED
from identification.result import Identification
from rig.common.provenance import IDENTIFY_SCHEMA, Provenance, finite, plain
from rig.results.identify.identify import Outcome
from rig.runs.run_file import partial_names


def outcome_record(outcome: Outcome) -> dict[str, Any]:
    """Return the record of ``rig identify --json``."""
    first, *others = outcome.results
    record = identification_record(first, outcome.provenance) | uncertainty_record(first)
    record["corrections"] = {r.name: list(r.notes) for r in outcome.dataset.recordings if r.notes}
    record["partial"] = partial_names(outcome.dataset)
    if others:
        record["compared"] = [identification_record(r, outcome.provenance) for r in others]
    if outcome.ladder:
        record["ladder"] = ladder_record(outcome.ladder)
    if outcome.simulated:
        record["simulated_ladder"] = simulated_record(outcome.simulated)
    if outcome.transfer is not None:
        record["transfer"] = transfer_record(outcome.transfer, str(outcome.scored_on))
    if outcome.comparison:
        record["comparison"] = comparison_record(outcome.comparison)
    return record


def identification_record(result: Identification, provenance: Provenance) -> dict[str, Any]:
    """Return the record of one method."""
    return {
        **provenance.record(IDENTIFY_SCHEMA),
        "method": result.method,
        "motion": result.motion,
        "alpha": result.alpha,
        "friction": result.friction,
        "fitted": plain(result.fitted),
        "parameters": _by_name(result.parameters.values()),
        "fit": plain(result.fit),
        "fit_by_recording": plain(result.fits_by_recording),
        "evaluations": result.evaluations,
        "stages": [plain(s, "cost_history", "parameter_history") for s in result.stages],
        "convergence": {
            s.stage: {"cost": plain(s.cost_history), "parameters": plain(s.parameter_history)}
            for s in result.stages
            if s.cost_history is not None
        },
        "warnings": list(result.warnings),
    }


def uncertainty_record(result: Identification) -> dict[str, Any]:
    """Return the part of the record on trade-offs, bounds, starts, profiles, bootstrap, priors, and
    constants with a stated uncertainty.
    """
    return {
        "tradeoffs": plain(result.tradeoffs),
        "least_pinned": result.least_pinned,
        "noise": plain(result.noise),
        "bounds_hit": [p.name for p in result.parameters.values() if p.at_bound],
        "starts": [
            {**plain(s, "reached", "absolute"), "reached_best": s.best} for s in result.starts
        ],
        "profiles": _by_name(result.profiles),
        "bootstrap": _by_name(result.resampled),
        "priors": _by_name(result.priors),
        "known_constants": plain(result.known_constants),
    }


def ladder_record(rungs: Sequence[Rung]) -> list[dict[str, Any]]:
    """Return the record under the key ``ladder`` of ``rig identify --json``; errors of the angle
    are in rad, or in m for a linear bench.
    """
    return [
        {
            "friction": rung.friction,
            "terms": list(LADDER[rung.friction]),
            "parameters": _by_name(rung.result.parameters.values()),
            "fitted": plain(rung.result.fitted),
            "fit": plain(rung.result.fit),
            "train_rms": plain(rung.train),
            "validate_rms": plain(rung.scored),
            "angle_rms": plain(rung.angle),
            "angle_mae": plain(rung.angle_mae),
            "best_share": rung.best,
        }
        for rung in rungs
    ]


def simulated_record(rungs: Sequence[SimulatedRung]) -> list[dict[str, Any]]:
    """Return the record under the key ``simulated_ladder`` of ``rig identify --json``; errors of
    the angle are in rad, or in m for a linear bench.
    """
    return [
        {
            "friction": rung.friction,
            "terms": list(SIMULATED[rung.friction]),
            "motor_constants": "free" if rung.free else "declared",
            "alpha": rung.alpha,
            "fitted": plain(rung.fitted),
            "train_mae": plain(rung.train),
            "cross_validated_mae": finite(rung.crossed),
            "validate_mae": plain(rung.scored),
            "horizon_s": finite(rung.horizon_s),
            "best_share": rung.best,
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


def comparison_record(contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Return the comparison of methods for the result file; errors are relative."""
    return [{**plain(c, "excess"), "cost_above_least": finite(c.excess)} for c in contenders]


def _by_name(records: Iterable[Any]) -> dict[str, Any]:
    return {record.name: plain(record, "name") for record in records}
