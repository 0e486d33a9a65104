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
from identification.effects.model import COORDINATES, CorrectedModel, Curve
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.places import read_json
from rig.common.provenance import IDENTIFY_SCHEMA, Provenance, constants_of, plain
from rig.planning.reference import LARGEST_ALPHA
from rig.runs.run_file import partial_names

DIAGNOSE_SCHEMA = "loadrig.diagnose/1"
FIELDS = (
    *("fit", "fits", "parameter_shift", "p_value", "location", "parameters", "alpha", "steps"),
    "warnings",
)


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
        **{name: plain(getattr(found, name)) for name in FIELDS},
        "motion": dataset.recordings[0].bench.motion,
        "constants": constants_of(dataset),
        "partial": partial_names(dataset),
        "corrections": {r.name: list(r.notes) for r in dataset.recordings if r.notes},
    }


def effects_record(found: Diagnosis) -> dict[str, Any]:
    """Return what the corrected model adds to the nominal one: effects and empirical curve."""
    return {"effects": plain(found.effects), "curve": plain(found.curve)}


SCHEMAS = (IDENTIFY_SCHEMA, DIAGNOSE_SCHEMA)
_LARGEST = 1e12
"""Largest plausible magnitude of a parameter, SI units."""
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
    record: Mapping[str, Any], recordings: Sequence[str], place: str = "result"
) -> CorrectedModel:
    """Return the model that a result file contains.

    Args:
        record: Record of ``rig identify --json`` or ``rig diagnose --json``.
        recordings: Names of the recordings from which the result was made, in their order.
        place: Path of the record, for messages.

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
    effects = dict(_effect(place, effect, recordings) for effect in record.get("effects", ()))
    alpha = _finite(place, "alpha", record.get("alpha", 2.0))
    if not 0.0 < alpha <= LARGEST_ALPHA:
        raise InputError(
            f"{place}: alpha: must be above 0 and at most {LARGEST_ALPHA:g} (got {alpha:g})"
        )
    return CorrectedModel(parameters, alpha, effects, _curve(place, record.get("curve")))


def _effect(
    place: str, effect: Mapping[str, Any], recordings: Sequence[str]
) -> tuple[str, dict[str, float]]:
    name = effect["name"]
    if name not in EFFECTS:
        raise InputError(
            f"{place}: effects: {name} is not an effect of the catalogue; see rig effects"
        )
    known = {q.name for q in EFFECTS[name].parameters}
    given = {
        key: _finite(place, f"effects.{name}.{key}", entry["value"])
        for key, entry in effect["parameters"].items()
        if key in known or key == "recording"
    }
    # The parameter counts recordings from 1.
    if EFFECTS[name].place is not None and "recording" not in given:
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
    grid, value = (
        np.array([_finite(place, f"curve.{key}", v) for v in entry[key]], dtype=float)
        for key in ("grid", "value")
    )
    return Curve(
        entry["equation"],
        entry["coordinate"],
        entry["unit"],
        entry["residual_unit"],
        grid,
        value,
        entry.get("against_motion", False) is True,
    )


def _finite(place: str, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{place}: {name}: must be a finite number (got {value!r})")
    if abs(value) > _LARGEST:
        raise InputError(
            f"{place}: {name}: must be from {-_LARGEST:g} to {_LARGEST:g} (got {value:g})"
        )
    return float(value)
