"""Result records as the JSON of the contract."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.recording import Recording
from identification.result import Convergence, Fit, Identification, Parameter
from rig.common.provenance import sha256_file, utc_now, versions

IDENTIFY_SCHEMA = "loadrig.identify/1"
RESULT_FILE = "identify.json"
"""Name of such a result beside the recordings of a run."""
PAPER_SCHEMA = "loadrig.paper/1"


@dataclass(frozen=True)
class Provenance:
    """What every result file carries beside its result.

    Attributes:
        seed: Of the random generator.
        inputs: File to its SHA-256.
        seconds: Wall-clock time spent.
        created: When, ISO 8601 in UTC.
        versions: Of this program and of what it depends on.
    """

    seed: int
    inputs: Mapping[str, str]
    seconds: float
    created: str
    versions: Mapping[str, str]

    @classmethod
    def of(
        cls,
        seed: int,
        recordings: Sequence[Recording],
        seconds: float,
        described_by: Path | None = None,
    ) -> Provenance:
        """Return the provenance of a result made just now from these recordings.

        Args:
            seed: Of the random generator.
            recordings: What was identified.
            seconds: Wall-clock time spent.
            described_by: The campaign file, or a run's ``run.json``, which says what the recordings
                are.

        Raises:
            OSError: ``described_by`` cannot be read.
        """
        inputs = {str(described_by): sha256_file(described_by)} if described_by else {}
        inputs |= {r.source: r.sha256 for r in recordings if r.source}
        return cls(seed, inputs, seconds, utc_now().isoformat(timespec="seconds"), versions())

    def record(self, schema: str) -> dict[str, Any]:
        """Return the head of a result file."""
        return {
            "schema": schema,
            "version": self.versions["loadrig"],
            "versions": dict(self.versions),
            "created": self.created,
            "seconds": self.seconds,
            "seed": self.seed,
            "inputs": [{"file": file, "sha256": digest} for file, digest in self.inputs.items()],
        }


def identification_record(result: Identification, provenance: Provenance) -> dict[str, Any]:
    """Return one identification as the record of ``rig identify --json``."""
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
    """Return one parameter; ``value`` is null where it is not identifiable, ``floor`` where it was
    not computed.
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
    """Return one fit; the ``validate`` figures are null where nothing was set aside."""
    return {
        "unit": fit.unit,
        "bandwidth_Hz": finite(fit.bandwidth_Hz),
        "train_rms": finite(fit.train_rms),
        "train_relative": finite(fit.train_relative),
        "validate_rms": finite(fit.validate_rms),
        "validate_relative": finite(fit.validate_relative),
    }


def finite(value: float | None) -> float | None:
    """Return a plain float, or None for infinities and NaN, which JSON does not have."""
    return float(value) if value is not None and math.isfinite(value) else None


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
