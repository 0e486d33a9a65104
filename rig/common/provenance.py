"""Collects the provenance of a result: digests, versions, commit."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.common.places import is_folder, require_plain

if TYPE_CHECKING:
    # At run time this import would load numba, for which `rig --help` must not wait.
    from identification.recording import Dataset, Recording


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    require_plain(path)
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def utc_now() -> datetime:
    """Return the date and time in UTC, which are used for labels only and never for timing."""
    return datetime.now(UTC)


def versions() -> dict[str, str]:
    """Return the versions of this program and its dependencies, and the commit of a work tree."""
    found = dict(_installed())
    commit = _git_commit(Path(__file__).parents[2])
    if commit:
        found["commit"] = commit
    return found


@cache
def _installed() -> Mapping[str, str]:
    names = ("loadrig", "numpy", "canopen", "python-can", "mcap")
    return {name: version(name) for name in names} | {"python": platform.python_version()}


def _git_commit(root: Path) -> str | None:
    """Return the commit that is checked out at ``root``; None without a plain work tree."""
    head = _text(root / ".git" / "HEAD")
    if head is None or not head.startswith("ref: "):
        return head
    ref = head.removeprefix("ref: ")
    loose = _text(root / ".git" / ref)
    if loose is not None:
        return loose
    packed = _text(root / ".git" / "packed-refs") or ""
    return next((line.split()[0] for line in packed.splitlines() if line.endswith(f" {ref}")), None)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        # ``root`` is not a work tree, or is one of another project.
        return None


RUN_FILE = "run.json"  # record of a run in its folder
IDENTIFY_SCHEMA = "loadrig.identify/1"
DIAGNOSE_SCHEMA = "loadrig.diagnose/1"
ACCEPTANCE_SCHEMA = "loadrig.acceptance/1"
RESULT_FILE = "identify.json"  # name of the result file of `rig identify` in a run folder
FRICTION_FIGURE = "figures/stribeck_default.png"
"""Name in a run folder of the figure that shows the result of an identified run."""


@dataclass(frozen=True)
class Provenance:
    """Provenance data in every result file."""

    seed: int
    inputs: Mapping[str, str]  # SHA-256 of the input files, by path
    seconds: float  # wall-clock time spent
    created: str  # time of creation, ISO 8601 in UTC
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
        """Return the provenance of a result made just now from these recordings."""
        inputs = {}
        if described_by is not None:
            file = described_by / RUN_FILE if is_folder(described_by) else described_by
            inputs[str(file)] = sha256_file(file)
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


def heading(schema: str) -> dict[str, Any]:
    """Return the keys that a result file without a fit begins with, at the present time."""
    known = versions()
    return {
        "schema": schema,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
    }


def constants_of(dataset: Dataset) -> dict[str, Any]:
    """Return the known constants of the bench, which the model of a result needs."""
    from identification.numerics.arrays import finite

    bench = dataset.recordings[0].bench
    left_out = ("motion", "gas_generator")
    return {f.name: finite(getattr(bench, f.name)) for f in fields(bench) if f.name not in left_out}
