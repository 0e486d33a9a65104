"""From a source and result files to simulated responses, scored against the recordings."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from identification.prepare import Prepared, default_bandwidth, prepare, torque_unit
from identification.recording import Dataset, RecordingError
from identification.simulate.closed_loop import Response, replay
from identification.simulate.score import Sums, compare, pooled, with_friction
from rig.errors import InputError
from rig.provenance import sha256_file
from rig.results import IDENTIFY_SCHEMA, Provenance
from rig.run_record import RUN_FILE
from rig.sources import load_source

SHARES = (1.0, 0.5, 0.0)
"""Friction simulated, over that of the result: its error means something beside those of half of it and of none."""


@dataclass(frozen=True)
class FittedModel:
    """A model out of a result file.

    Attributes:
        file: Where it was read.
        values: Name to value.
        alpha: Stribeck exponent.
    """

    file: Path
    values: Mapping[str, float]
    alpha: float


@dataclass(frozen=True)
class Case:
    """One model with one share of its friction, simulated on every recording."""

    model: FittedModel
    share: float
    sums: Mapping[str, Sums]

    def over(self, names: Sequence[str]) -> Sums:
        """Return the pooled sums of some recordings."""
        return pooled(self.sums[name] for name in names)


@dataclass(frozen=True)
class Simulation:
    """What ``rig simulate`` found.

    Attributes:
        dataset: The recordings.
        prepared: Their measured side at the bandwidth, in the same order.
        cases: Every model with every share of friction.
        responses: Of the first model with all its friction, in the order of the recordings.
        bandwidth_Hz: Of the torque errors.
        provenance: Inputs, time.
    """

    dataset: Dataset
    prepared: tuple[Prepared, ...]
    cases: tuple[Case, ...]
    responses: tuple[Response, ...]
    bandwidth_Hz: float
    provenance: Provenance

    @property
    def unit(self) -> str:
        """Unit of the torque errors."""
        return torque_unit(self.dataset.recordings[0])

    def names(self, role: str) -> list[str]:
        """Return the recordings of one role."""
        return [r.name for r in self.dataset.recordings if r.role == role]


def simulate_source(
    source: Path, results: Sequence[Path], bandwidth_Hz: float | None, progress: Callable[[str, float], None]
) -> Simulation:
    """Simulate every recording of a source in closed loop with the model of each result file.

    Args:
        source: Campaign file or run folder whose recordings have a controller.
        results: Result files of ``rig identify``.
        bandwidth_Hz: Of the torque errors; None chooses it as the identification does.
        progress: Called with what is being done and the share that is done.

    Raises:
        InputError: A file cannot be used, or a recording cannot be simulated.
    """
    started = time.perf_counter()
    models = [read_model(path) for path in results]
    progress("reading", 0.0)
    dataset = load_source(source)
    cases: list[Case] = []
    shown: list[Response] = []
    try:
        if bandwidth_Hz is None:
            bandwidth_Hz = min(default_bandwidth(r) for r in dataset.part("fit") or dataset.recordings)
        prepared = tuple(prepare(r, bandwidth_Hz) for r in dataset.recordings)
        total = len(models) * len(SHARES) * len(prepared)
        for model in models:
            for share in SHARES:
                sums: dict[str, Sums] = {}
                for p in prepared:
                    progress(f"simulating {p.recording.name}", (len(cases) * len(prepared) + len(sums)) / total)
                    response = replay(p.recording, with_friction(model.values, share), model.alpha)
                    sums[p.recording.name] = compare(p, response)
                    if not cases:
                        shown.append(response)
                cases.append(Case(model, share, sums))
    except RecordingError as error:
        raise InputError(f"{source}: {error}") from error
    described_by = source / RUN_FILE if source.is_dir() else source
    provenance = Provenance.of(0, dataset.recordings, time.perf_counter() - started, described_by)
    inputs = {**provenance.inputs, **{str(path): sha256_file(path) for path in results}}
    provenance = Provenance(0, inputs, provenance.seconds, provenance.created, provenance.versions)
    return Simulation(dataset, prepared, tuple(cases), tuple(shown), bandwidth_Hz, provenance)


def read_model(path: Path) -> FittedModel:
    """Read the model of a result file: what its fit ended with, or its parameters where that is not recorded.

    Raises:
        InputError: It cannot be read, or is no result of an identification; names file, place and value.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(record, dict) or record.get("schema") != IDENTIFY_SCHEMA:
        found = record.get("schema") if isinstance(record, dict) else type(record).__name__
        raise InputError(f"{path}: schema: this program simulates {IDENTIFY_SCHEMA} (got {found!r})")
    entries = record.get("fitted")
    if entries is None:
        parameters = record.get("parameters")
        if not isinstance(parameters, dict) or not all(isinstance(p, dict) for p in parameters.values()):
            raise InputError(f"{path}: parameters: must map names to records with a `value`")
        entries = {name: p.get("value") for name, p in parameters.items() if p.get("value") is not None}
    if not isinstance(entries, dict) or not entries:
        raise InputError(f"{path}: fitted: no value to simulate with; identify first")
    values = {str(name): _finite(path, name, value) for name, value in entries.items()}
    return FittedModel(path, values, _finite(path, "alpha", record.get("alpha", 2.0)))


def _finite(path: Path, name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{path}: {name}: must be a finite number (got {value!r})")
    return float(value)
