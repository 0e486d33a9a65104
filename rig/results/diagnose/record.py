"""Converts a diagnosis to the JSON record of ``rig diagnose --json``."""

from __future__ import annotations

from typing import Any

from identification.diagnosis.result import (
    Curve,
    Diagnosis,
    Estimate,
    Fit,
    IdentifiedEffect,
    Location,
    Step,
)
from identification.recording import Dataset
from rig.common.result_files import Provenance, finite
from rig.runs.partial import partial_names

DIAGNOSE_SCHEMA = "loadrig.diagnose/1"


def diagnosis_record(found: Diagnosis, dataset: Dataset, provenance: Provenance) -> dict[str, Any]:
    """Return the diagnosis of a dataset as the record of ``rig diagnose --json``.

    The record contains the verdict and the complete corrected model: ``parameters``, ``alpha``, the
    effects with their parameters, and ``curve`` for missing torque outside the catalogue.
    """
    return {
        **provenance.record(DIAGNOSE_SCHEMA),
        "verdict": found.verdict.value,
        "statement": found.statement,
        **effects_record(found),
        "fit": _fit_record(found.fit),
        "fits": [_fit_record(f) for f in found.fits],
        "parameter_shift": {
            name: {"before": finite(s.before), "after": finite(s.after), "unit": s.unit}
            for name, s in found.parameter_shift.items()
        },
        "p_value": finite(found.p_value),
        "location": None if found.location is None else _location_record(found.location),
        "parameters": {name: finite(value) for name, value in found.parameters.items()},
        "alpha": found.alpha,
        "steps": [_step_record(s) for s in found.steps],
        "warnings": list(found.warnings),
        "motion": dataset.recordings[0].bench.motion,
        "partial": partial_names(dataset),
        "corrections": {r.name: list(r.notes) for r in dataset.recordings if r.notes},
    }


def effects_record(found: Diagnosis) -> dict[str, Any]:
    """Return the additions of the corrected model to the nominal model: effects, and the empirical
    curve.
    """
    return {
        "effects": [_effect_record(e) for e in found.effects],
        "curve": None if found.curve is None else _curve_record(found.curve),
    }


def _effect_record(effect: IdentifiedEffect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "alias_group": list(effect.alias_group),
        "confidence": finite(effect.confidence),
        "statement": effect.statement,
        "assumption_broken": effect.assumption_broken,
        "where": _location_record(effect.where),
        "parameters": {name: _estimate_record(e) for name, e in effect.parameters.items()},
        "rivals": [
            {"name": r.name, "confidence": finite(r.confidence), "why_not": r.why_not}
            for r in effect.rivals
        ],
        "separating_experiment": effect.separating_experiment,
    }


def _estimate_record(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": finite(estimate.value),
        "low": finite(estimate.low),
        "high": finite(estimate.high),
        "unit": estimate.unit,
    }


def _location_record(where: Location) -> dict[str, Any]:
    return {
        "coordinate": where.coordinate,
        "unit": where.unit,
        "ranges": [[finite(low), finite(high)] for low, high in where.ranges],
        "share_of_mismatch": finite(where.share_of_mismatch),
        "recordings": list(where.recordings),
    }


def _fit_record(fit: Fit) -> dict[str, Any]:
    return {
        "equation": fit.equation,
        "unit": fit.unit,
        "bandwidth_Hz": finite(fit.bandwidth_Hz),
        "baseline_rms": finite(fit.baseline_rms),
        "final_rms": finite(fit.final_rms),
        "noise_floor_rms": finite(fit.noise_floor_rms),
        "validate_baseline_rms": finite(fit.validate_baseline_rms),
        "validate_final_rms": finite(fit.validate_final_rms),
    }


def _curve_record(curve: Curve) -> dict[str, Any]:
    return {
        "equation": curve.equation,
        "coordinate": curve.coordinate,
        "unit": curve.unit,
        "residual_unit": curve.residual_unit,
        "against_motion": curve.against_motion,
        "grid": [finite(v) for v in curve.grid],
        "value": [finite(v) for v in curve.value],
    }


def _step_record(step: Step) -> dict[str, Any]:
    return {
        "action": step.action,
        "name": step.name,
        "p_value": finite(step.p_value),
        "gain": finite(step.gain),
        "note": step.note,
    }
