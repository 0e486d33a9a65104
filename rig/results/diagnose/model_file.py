"""Reads the model from a result file: nominal parameters, effects, and the empirical curve."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from identification.diagnosis.gas import PRESSURE
from identification.diagnosis.result import Diagnosis
from identification.effects import EFFECTS
from identification.effects.effect import Effect
from identification.effects.model import COORDINATES, CorrectedModel, Curve
from identification.effects.prediction import Fitted
from identification.numerics.spread import Spread
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import read_json
from rig.common.provenance import DIAGNOSE_SCHEMA, IDENTIFY_SCHEMA, Provenance, constants_of
from rig.planning.reference import LARGEST_ALPHA
from rig.runs.run_file import partial_names


def diagnosis_record(found: Diagnosis, dataset: Dataset, provenance: Provenance) -> dict[str, Any]:
    """Return the diagnosis of a dataset as the record of ``rig diagnose --json``.

    The record contains the verdict and the complete corrected model: ``parameters``, ``alpha``, the
    effects with their parameters, and ``curve`` for missing torque outside the catalogue.
    """
    return {
        **provenance.record(DIAGNOSE_SCHEMA),
        **found.to_dict(),
        "motion": dataset.recordings[0].bench.motion,
        "constants": constants_of(dataset),
        "partial": partial_names(dataset),
        "corrections": {r.name: list(r.notes) for r in dataset.recordings if r.notes},
    }


INVESTIGATE_SCHEMA = "loadrig.investigate/1"
"""Schema of a result that is that of a diagnosis of all runs of an investigation, and more."""
SCHEMAS = (IDENTIFY_SCHEMA, DIAGNOSE_SCHEMA, INVESTIGATE_SCHEMA)
_LARGEST = 1e12  # largest plausible magnitude of a parameter, SI units
_MOTION_OF_INERTIA = {"kg": "linear", "kg m^2": "rotary"}


def read_result(path: Path) -> dict[str, Any]:
    """Read a result file of ``rig identify`` or ``rig diagnose``.

    Raises:
        InputError: The file cannot be read, or is not a result file of these commands.
    """
    record = read_json(path)
    found = record.get("schema") if isinstance(record, dict) else type(record).__name__
    if found not in SCHEMAS:
        raise InputError(f"{path}: schema: must be {' or '.join(SCHEMAS)} (got {found!r})")
    return dict(record)


def require_motion(record: Mapping[str, Any], motion: str, place: str) -> None:
    """Refuse a result of a rotary bench for a linear bench and vice versa, because their units
    differ.

    Raises:
        InputError: The result is of a bench with the other kind of motion, by its ``motion`` or by
            the unit of its inertia.
    """
    found = record.get("motion")
    if found is None:
        given = (record.get(key, {}).get("J") for key in ("parameters", "parameter_shift"))
        units = [e.get("unit") for e in given if isinstance(e, Mapping)]
        found = next((_MOTION_OF_INERTIA[u] for u in units if u in _MOTION_OF_INERTIA), motion)
    if found != motion:
        raise InputError(
            f"{place}: motion: the result is of a {found} bench, but the recordings are of a "
            f"{motion} bench; if the bench of the recordings is {found}, set bench.motion: {found} "
            f"in the campaign, otherwise give a result of a {motion} bench"
        )


def model_of(
    record: Mapping[str, Any],
    recordings: Sequence[str],
    place: str = "result",
    catalogue: Mapping[str, Effect] = EFFECTS,
) -> CorrectedModel:
    """Return the model that a result file contains.

    Args:
        record: Record of ``rig identify --json`` or ``rig diagnose --json``.
        recordings: Names of the recordings from which the result was made, in their order.
        place: Path of the record, for messages.
        catalogue: The catalogue, with the effects of one's own of which the result may be.

    Raises:
        InputError: A value is missing or not a number, an effect has other parameters than the
            catalogue's, or the diagnosis is one of a gas generator.
    """
    if record.get("fit", {}).get("equation") == PRESSURE:
        raise InputError(
            f"{place}: a diagnosis of a gas generator has no torque model; give the result of a "
            "diagnosis of the motion"
        )
    given = record.get("fitted") or record.get("parameters") or {}
    parameters = {}
    for name, entry in given.items():
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        if value is not None:
            parameters[str(name)] = _finite(place, f"parameters.{name}", value)
    if not parameters:
        raise InputError(
            f"{place}: parameters: no parameter has a value, so the model cannot be simulated"
        )
    effects = dict(
        _effect(place, effect, recordings, catalogue, record.get("effects_file"))
        for effect in record.get("effects", ())
    )
    alpha = _finite(place, "alpha", record.get("alpha", 2.0))
    if not 0.0 < alpha <= LARGEST_ALPHA:
        raise InputError(
            f"{place}: alpha: must be above 0 and at most {LARGEST_ALPHA:g} (got {alpha:g})"
        )
    curve = _curve(place, record.get("curve"))
    return CorrectedModel(parameters, alpha, effects, curve, catalogue)


def fitted_of(record: Mapping[str, Any], model: CorrectedModel, unit: str) -> Fitted | None:
    """Return a model with the covariance, torque error and ranges of its result file; None if the
    file has no covariance, or no torque error in this unit.

    Raises:
        KeyError: A field is missing.
        ValueError: A field has no number, or the covariance another shape than its names.
    """
    given, found = record.get("covariance"), [*record.get("fits", ()), record.get("fit", {})]
    errors = [f for f in found if (f.get("equation", "torque"), f.get("unit")) == ("torque", unit)]
    if not given or not given["names"] or not errors:
        return None
    names = [str(n) for n in given["names"] if n in model.values]
    size = len(given["names"])
    at = [given["names"].index(n) for n in names]
    matrix = np.array(given["matrix"], dtype=float).reshape(size, size)[np.ix_(at, at)]
    freedom = math.inf if given["freedom"] is None else float(given["freedom"])
    noise = errors[0]["final_rms"] if "final_rms" in errors[0] else errors[0]["train_rms"]
    ranges = {n: (float(low), float(high)) for n, (low, high) in record["ranges"].items()}
    spread = Spread(tuple(names), matrix, freedom)
    return Fitted(model, spread, {"torque": float(noise)}, ranges, errors[0]["bandwidth_Hz"])


def _effect(
    place: str,
    effect: Mapping[str, Any],
    recordings: Sequence[str],
    catalogue: Mapping[str, Effect],
    own: Mapping[str, str] | None,
) -> tuple[str, dict[str, float]]:
    name = effect["name"]
    if name not in catalogue:
        remedy = "see rig effects"
        if own is not None:
            remedy = (
                f"it is from a file of one's own, {own['file']} (SHA-256 {own['sha256'][:12]}...); "
                "give this file with --effects"
            )
        raise InputError(f"{place}: effects: {name} is not an effect of the catalogue; {remedy}")
    known = {q.name for q in catalogue[name].parameters}
    given = {
        key: _finite(place, f"effects.{name}.{key}", entry["value"])
        for key, entry in effect["parameters"].items()
        if key in known or key == "recording"
    }
    # The parameter counts recordings from 1.
    if catalogue[name].place is not None and "recording" not in given:
        shown = [recordings.index(r) for r in effect["where"]["recordings"] if r in recordings]
        given["recording"] = 1.0 + min(shown, default=0)
    if known - given.keys():
        raise InputError(
            f"{place}: effects: {name} lacks {', '.join(sorted(known - given.keys()))}"
        )
    return name, given


def _curve(place: str, entry: Mapping[str, Any] | None) -> Curve | None:
    if entry is None or entry["coordinate"] not in COORDINATES:
        return None
    equation, coordinate, unit, residual_unit = (
        str(entry[key]) for key in ("equation", "coordinate", "unit", "residual_unit")
    )
    grid, value = (
        np.array([_finite(place, f"curve.{key}", v) for v in entry[key]], dtype=float)
        for key in ("grid", "value")
    )
    against = entry.get("against_motion", False) is True
    return Curve(equation, coordinate, unit, residual_unit, grid, value, against)


def _finite(place: str, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{place}: {name}: must be a finite number (got {value!r})")
    if abs(value) > _LARGEST:
        raise InputError(
            f"{place}: {name}: must be from {-_LARGEST:g} to {_LARGEST:g} (got {value:g})"
        )
    return float(value)
