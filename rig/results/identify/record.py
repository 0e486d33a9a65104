"""Converts an identification to the JSON record of ``rig identify --json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from identification.estimate.ladder import Interval, Moved, Rung, Transfer
from identification.estimate.paper_method import Contender
from identification.estimate.simulated_ladder import Constant, SimulatedRung
from identification.model.parameters import LADDER, SIMULATED
from identification.result import Convergence, Fit, Identification, Parameter
from rig.common.provenance import IDENTIFY_SCHEMA, Provenance, finite
from rig.results.identify.identify import Outcome
from rig.runs.run_file import partial_names


def outcome_record(outcome: Outcome) -> dict[str, Any]:
    """Return the record of ``rig identify --json``."""
    first, *others = outcome.results
    record = identification_record(first, outcome.provenance)
    record |= uncertainty_record(first) | known_record(first)
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
        "fitted": {name: finite(value) for name, value in result.fitted.items()},
        "parameters": {name: parameter_record(p) for name, p in result.parameters.items()},
        "fit": fit_record(result.fit),
        "fit_by_recording": {
            name: fit_record(fit) for name, fit in result.fits_by_recording.items()
        },
        "evaluations": result.evaluations,
        "stages": [_stage_record(s) for s in result.stages],
        "convergence": {
            s.stage: _history_record(s) for s in result.stages if s.cost_history is not None
        },
        "warnings": list(result.warnings),
    }


def parameter_record(parameter: Parameter) -> dict[str, Any]:
    """Return the record of one parameter; ``value`` is null if the parameter is not identifiable,
    ``floor`` is null if no floor was computed.
    """
    return {
        "value": finite(parameter.value),
        "low": finite(parameter.low),
        "high": finite(parameter.high),
        "unit": parameter.unit,
        "identifiable": parameter.identifiable,
        "at_bound": parameter.at_bound,
        "reason": parameter.reason,
        "floor": finite(parameter.floor),
    }


def fit_record(fit: Fit) -> dict[str, Any]:
    """Return the record of one fit; the ``validate`` values are null if no recording has role
    validate.
    """
    return {
        "unit": fit.unit,
        "bandwidth_Hz": finite(fit.bandwidth_Hz),
        "train_rms": finite(fit.train_rms),
        "train_relative": finite(fit.train_relative),
        "validate_rms": finite(fit.validate_rms),
        "validate_relative": finite(fit.validate_relative),
    }


def known_record(result: Identification) -> dict[str, Any]:
    """Return the part of the record on priors and on constants with a stated uncertainty."""
    return {
        "priors": {
            p.name: {
                "value": finite(p.value),
                "uncertainty": finite(p.uncertainty),
                "alone": finite(p.alone),
                "alone_uncertainty": finite(p.alone_uncertainty),
                "posterior": finite(p.posterior),
                "posterior_uncertainty": finite(p.posterior_uncertainty),
            }
            for p in result.priors
        },
        "known_constants": [
            {
                "place": c.place,
                "value": finite(c.value),
                "uncertainty": finite(c.uncertainty),
                "shifts": {name: finite(shift) for name, shift in c.shifts.items()},
            }
            for c in result.known_constants
        ],
    }


def uncertainty_record(result: Identification) -> dict[str, Any]:
    """Return the part of the record on trade-offs, bounds, starts, profiles and bootstrap."""
    return {
        "tradeoffs": [
            {"names": list(t.names), "correlation": finite(t.correlation), "statement": t.statement}
            for t in result.tradeoffs
        ],
        "least_pinned": result.least_pinned,
        "noise": None if result.noise is None else asdict(result.noise),
        "bounds_hit": [p.name for p in result.parameters.values() if p.at_bound],
        "starts": [
            {
                "stage": s.stage,
                "cost": s.cost,
                "ends": [finite(e) for e in s.ends],
                "reached_best": s.best,
            }
            for s in result.starts
        ],
        "profiles": {
            c.name: {
                "unit": c.unit,
                "values": [finite(v) for v in c.values],
                "deviance": [finite(v) for v in c.deviance],
                "low": finite(c.low),
                "high": finite(c.high),
                "scale": finite(c.scale),
            }
            for c in result.profiles
        },
        "bootstrap": {
            r.name: {
                "unit": r.unit,
                "low": finite(r.low),
                "high": finite(r.high),
                "draws": r.draws,
                "solved": r.solved,
            }
            for r in result.resampled
        },
    }


def ladder_record(rungs: Sequence[Rung]) -> list[dict[str, Any]]:
    """Return the record under the key ``ladder`` of ``rig identify --json``; errors of the angle
    are in rad, or in m for a linear bench.
    """
    return [
        {
            "friction": rung.friction,
            "terms": list(LADDER[rung.friction]),
            "parameters": {name: parameter_record(p) for name, p in rung.result.parameters.items()},
            "fitted": {name: finite(value) for name, value in rung.result.fitted.items()},
            "fit": fit_record(rung.result.fit),
            "train_rms": _interval_record(rung.train),
            "validate_rms": _interval_record(rung.scored),
            "angle_rms": _interval_record(rung.angle),
            "angle_mae": _interval_record(rung.angle_mae),
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
            "fitted": {name: finite(value) for name, value in rung.fitted.items()},
            "train_mae": _interval_record(rung.train),
            "cross_validated_mae": finite(rung.crossed),
            "validate_mae": _interval_record(rung.scored),
            "horizon_s": finite(rung.horizon_s),
            "best_share": rung.best,
            "chosen": rung.chosen,
            "tied": rung.tied,
            "constants": {c.name: _constant_record(c) for c in rung.constants},
        }
        for rung in rungs
    ]


def _constant_record(c: Constant) -> dict[str, Any]:
    return {
        "unit": c.unit,
        "declared": c.declared,
        "prior_relative_std": finite(c.prior),
        "value": finite(c.value),
        "low": finite(c.low),
        "high": finite(c.high),
        "relative_change": finite(c.change),
        "moved": c.moved,
    }


def transfer_record(found: Transfer, source: str) -> dict[str, Any]:
    """Return the record under the key ``transfer`` of ``rig identify --json``."""
    floor = found.floor
    return {
        "source": source,
        "fit": fit_record(found.fit),
        "own": fit_record(found.own),
        "noise_floor_rms": None if floor is None else floor.rms,
        "noise_floor_samples": 0 if floor is None else floor.samples,
        "fit_by_recording": {name: fit_record(fit) for name, fit in found.by_recording.items()},
        "parameters": {m.name: _moved_record(m) for m in found.parameters},
    }


def comparison_record(contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Return the comparison of methods for the result file; errors are relative."""
    return [
        {
            "name": c.name,
            "runs": c.runs,
            "failures": c.failures,
            "evaluations": c.evaluations,
            "seconds": c.seconds,
            "cost_above_least": finite(c.excess),
            "error": finite(c.error),
            "worst": c.worst,
            "true_error": finite(c.true_error),
            "true_worst": c.true_worst,
            "values": {name: finite(value) for name, value in c.values.items()},
        }
        for c in contenders
    ]


def _stage_record(stage: Convergence) -> dict[str, Any]:
    return {
        "stage": stage.stage,
        "method": stage.method,
        "evaluations": stage.evaluations,
        "generations": stage.generations,
        "cost": finite(stage.cost),
        "cost_unit": stage.cost_unit,
        "target": finite(stage.target),
        "reached": stage.reached,
    }


def _history_record(stage: Convergence) -> dict[str, Any]:
    costs = [] if stage.cost_history is None else [finite(v) for v in stage.cost_history]
    histories = {
        name: [finite(v) for v in values] for name, values in stage.parameter_history.items()
    }
    return {"cost": costs, "parameters": histories}


def _interval_record(found: Interval | None) -> dict[str, float] | None:
    return None if found is None else {"value": found.value, "low": found.low, "high": found.high}


def _moved_record(m: Moved) -> dict[str, Any]:
    return {
        "here": parameter_record(m.first),
        "there": parameter_record(m.second),
        "difference": m.difference,
        "joint": m.joint,
        "moved": m.moved,
    }
