"""Makes the keys that all result files begin with, and converts numbers to plain JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.recording import Recording
from rig.common.provenance import sha256_file, utc_now, versions

IDENTIFY_SCHEMA = "loadrig.identify/1"
RESULT_FILE = "identify.json"
"""Name of the result file of ``rig identify`` in a run folder."""


@dataclass(frozen=True)
class Provenance:
    """Provenance data in every result file.

    Attributes:
        seed: Seed of the random generator.
        inputs: SHA-256 of the input files, by path.
        seconds: Wall-clock time spent.
        created: Time of creation, ISO 8601 in UTC.
        versions: Versions of this program and its dependencies.
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
        tables: Mapping[str, str] | None = None,
    ) -> Provenance:
        """Return the provenance of a result made just now from these recordings.

        Args:
            seed: Seed of the random generator.
            recordings: The recordings used.
            seconds: Wall-clock time spent.
            described_by: The campaign file or a run's ``run.json`` that describes the recordings.
            tables: SHA-256 of the tables that list the recordings, by path.

        Raises:
            OSError: ``described_by`` cannot be read.
        """
        inputs = {str(described_by): sha256_file(described_by)} if described_by else {}
        inputs |= dict(tables or {})
        inputs |= {r.source: r.sha256 for r in recordings if r.source}
        return cls(seed, inputs, seconds, utc_now().isoformat(timespec="seconds"), versions())

    def record(self, schema: str) -> dict[str, Any]:
        """Return the keys that a result file begins with."""
        return {
            "schema": schema,
            "version": self.versions["loadrig"],
            "versions": dict(self.versions),
            "created": self.created,
            "seconds": self.seconds,
            "seed": self.seed,
            "inputs": [{"file": file, "sha256": digest} for file, digest in self.inputs.items()],
        }


def finite(value: float | None) -> float | None:
    """Return a plain float, or None for infinities and NaN, which JSON does not have."""
    return float(value) if value is not None and math.isfinite(value) else None
