"""Simulates the responses of models from result files to the commands of a source, and compares
them with the recordings.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from identification.export.model import CorrectedModel, Predicted, predictions, rms
from identification.prepare import Prepared, default_bandwidth, prepare, torque_unit
from identification.recording import Dataset, RecordingError
from identification.simulate.closed_loop import (
    Response,
    Sums,
    compare,
    pooled,
    replay,
    with_friction,
)
from identification.views.view import views
from rig.common.errors import InputError
from rig.common.places import is_folder
from rig.common.provenance import Provenance, sha256_file
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_file import model_of, read_result, require_motion
from rig.runs.run_record import RUN_FILE
from rig.sources import load_source


@dataclass(frozen=True)
class Prediction:
    """Prediction of one model for every recording.

    Attributes:
        file: Result file.
        effects: Names of the active effects; empty for the nominal part alone.
        parts: Every equation of every recording.
    """

    file: Path
    effects: tuple[str, ...]
    parts: tuple[Predicted, ...]

    def error(self, equation: str, role: str) -> float | None:
        """Return the rms error of one equation over the recordings of one role, or None if the
        equation does not apply.
        """
        return rms(p for p in self.parts if p.equation == equation and p.role == role)


def predict(
    dataset: Dataset, models: Sequence[tuple[Path, CorrectedModel]], bandwidth_Hz: float
) -> list[Prediction]:
    """Predict every recording with every model, and again without effects if the model has
    effects.

    Raises:
        RecordingError: A recording cannot be filtered to this bandwidth.
    """
    seen = views(dataset.recordings, bandwidth_Hz)
    found = []
    for file, model in models:
        forms = [model]
        if model.effects or model.curve is not None:
            forms.append(dataclasses.replace(model, effects={}, curve=None))
        for form in forms:
            names = (*form.effects, *(["curve"] if form.curve is not None else []))
            found.append(
                Prediction(file, names, tuple(p for view in seen for p in predictions(view, form)))
            )
    return found


RESULT_FILE = "simulate.json"
SHARES = (1.0, 0.5, 0.0)
"""Factors on the friction of a result; the errors with half of the friction and without friction
serve as references.
"""


@dataclass(frozen=True)
class FittedModel:
    """A model from a result file.

    Attributes:
        file: The result file.
        corrected: Nominal parameters and effects.
    """

    file: Path
    corrected: CorrectedModel


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
    """Result of ``rig simulate``.

    Attributes:
        dataset: The recordings.
        models: Models in the requested order.
        predictions: Equation errors of every model, with its effects and without.
        prepared: The recordings at the bandwidth of the torque errors, in their order.
        cases: Every model with every share of friction, in closed loop, without effects; empty if
            the controller of a recording is unknown.
        responses: Responses of the first model with full friction, in the order of the recordings.
        bandwidth_Hz: Bandwidth of the torque errors.
        provenance: Inputs, time.
    """

    dataset: Dataset
    models: tuple[FittedModel, ...]
    predictions: tuple[Prediction, ...]
    prepared: tuple[Prepared, ...]
    cases: tuple[Case, ...]
    responses: tuple[Response, ...]
    bandwidth_Hz: float
    provenance: Provenance

    @property
    def unit(self) -> str:
        """Unit of the torque errors."""
        return torque_unit(self.dataset.recordings[0])

    @property
    def rotary(self) -> bool:
        """Whether the bench is rotary; a linear bench has forces and positions."""
        return self.dataset.recordings[0].bench.motion == "rotary"

    def names(self, role: str) -> list[str]:
        """Return the recordings of one role."""
        return [r.name for r in self.dataset.recordings if r.role == role]


def simulate_source(
    source: Path,
    results: Sequence[Path],
    bandwidth_Hz: float | None,
    progress: Callable[[str, float], None],
) -> Simulation:
    """Predict every recording of a source with the model of each result file, and simulate the
    closed loop if the controller is known.

    Args:
        source: Campaign file or run folder.
        results: Result files of ``rig identify`` or ``rig diagnose``.
        bandwidth_Hz: Bandwidth of the errors, or None for the bandwidth of the first result, or
            chosen as in the identification.
        progress: Called with the current step and the completed share.

    Raises:
        InputError: A file cannot be used, or a recording cannot be simulated.
    """
    started = time.perf_counter()
    progress("reading", 0.0)
    dataset = load_source(source)
    records = [read_result(path) for path in results]
    models = _models(dataset, results, records)
    bandwidth_Hz = bandwidth_Hz or records[0].get("fit", {}).get("bandwidth_Hz")
    try:
        if bandwidth_Hz is None:
            bandwidth_Hz = min(
                default_bandwidth(r) for r in dataset.part("fit") or dataset.recordings
            )
        prepared = tuple(prepare(r, bandwidth_Hz) for r in dataset.recordings)
        predictions = predict(dataset, [(m.file, m.corrected) for m in models], bandwidth_Hz)
        known = all(r.controller is not None for r in dataset.recordings)
        cases, responses = _closed_loop(models if known else (), prepared, progress)
    except RecordingError as error:
        raise InputError(f"{source}: {error}") from error
    described_by = source / RUN_FILE if is_folder(source) else source
    seconds = time.perf_counter() - started
    provenance = Provenance.of(0, dataset.recordings, seconds, described_by, dataset.tables)
    read = {str(path): sha256_file(path) for path in results}
    return Simulation(
        dataset,
        models,
        tuple(predictions),
        prepared,
        tuple(cases),
        tuple(responses),
        bandwidth_Hz,
        dataclasses.replace(provenance, inputs={**provenance.inputs, **read}),
    )


def _models(
    dataset: Dataset, files: Sequence[Path], records: Sequence[Mapping[str, Any]]
) -> tuple[FittedModel, ...]:
    """Return the models of result files; all must be from a bench with the same kind of motion as
    the recordings.
    """
    names = [r.name for r in dataset.recordings]
    for path, record in zip(files, records, strict=True):
        require_motion(record, dataset.recordings[0].bench.motion, str(path))
    return tuple(
        FittedModel(path, model_of(record, names, str(path)))
        for path, record in zip(files, records, strict=True)
    )


def _closed_loop(
    models: Sequence[FittedModel],
    prepared: Sequence[Prepared],
    progress: Callable[[str, float], None],
) -> tuple[list[Case], list[Response]]:
    """Simulate every model with every share of its friction; return the cases, and the responses of
    the first case.
    """
    cases: list[Case] = []
    shown: list[Response] = []
    total = len(models) * len(SHARES) * len(prepared)
    for model, share in product(models, SHARES):
        sums: dict[str, Sums] = {}
        for p in prepared:
            done = len(cases) * len(prepared) + len(sums)
            progress(f"simulating {p.recording.name}", done / total)
            values = with_friction(model.corrected.parameters, share)
            response = replay(p.recording, values, model.corrected.alpha)
            sums[p.recording.name] = compare(p, response)
            if not cases:
                shown.append(response)
        cases.append(Case(model, share, sums))
    return cases, shown


def as_bench(source: Path, found: Simulation) -> tuple[dict[str, str], list[str]]:
    """Return the first model as a simulated bench (file name to text), and remarks on this bench.

    If the model cannot be a simulated bench, there is no file, and the remarks state why.
    """
    try:
        constants = found.dataset.recordings[0].bench
        bench, left_out = model_bench(base_bench(source), found.models[0].corrected, constants)
        said = f"{BENCH_FILE} beside this page is the model as a simulated bench."
        return {BENCH_FILE: bench_text(bench, left_out)}, [said, *left_out]
    except InputError as error:
        return {}, list(error.problems)
