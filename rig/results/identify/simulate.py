"""Predicts recordings with a fitted model."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.effects import prediction
from identification.effects.model import CorrectedModel, predictions, views_for
from identification.effects.prediction import Simulation as Banded
from identification.estimate.bandwidth import choose_bandwidth
from identification.numerics.arrays import Progress
from identification.plots.signals import predicted, simulated
from identification.prepare import Prepared, prepare, torque_unit
from identification.recording import Dataset
from identification.simulation.closed_loop import (
    Response,
    Sums,
    compare,
    pooled,
    replay,
)
from identification.views.predicted import Predicted, rms
from rig.common.errors import InputError
from rig.common.provenance import Provenance, sha256_file
from rig.common.tables import number, percent
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_file import fitted_of, model_of, read_result, require_motion
from rig.results.diagnose.own_effects import NO_FILE, OwnFile
from rig.results.document import (
    Document,
    Note,
    Paragraph,
    Picture,
    Section,
    Table,
    columns,
    few_of_each_role,
    provenance_section,
)
from rig.results.measured import named_errors
from rig.sources import load_source


@dataclass(frozen=True)
class Prediction:
    """Prediction of the model for every recording, with its effects or without."""

    effects: tuple[str, ...]
    parts: tuple[Predicted, ...]

    def error(self, equation: str, role: str) -> float | None:
        """Return the rms error of an equation over a role, or None if it does not apply."""
        return rms(p for p in self.parts if p.equation == equation and p.role == role)


def predict(dataset: Dataset, model: CorrectedModel, bandwidth_Hz: float) -> list[Prediction]:
    """Predict every recording with a model, and without effects if the model has some."""
    seen = views_for(dataset.recordings, bandwidth_Hz, model)
    forms = [model]
    if model.effects or model.curve is not None:
        forms.append(dataclasses.replace(model, effects={}, curve=None))
    return [
        Prediction(
            (*form.effects, *(["curve"] if form.curve is not None else [])),
            tuple(p for view in seen for p in predictions(view, form)),
        )
        for form in forms
    ]


RESULT_FILE = "simulate.json"


@dataclass(frozen=True)
class Simulation:
    """Result of ``rig simulate``."""

    dataset: Dataset
    file: Path  # result file of the model
    model: CorrectedModel
    # Equation errors of the model, with its effects and without.
    predictions: tuple[Prediction, ...]
    # The recordings at the bandwidth of the torque errors, in their order.
    prepared: tuple[Prepared, ...]
    # Errors of the closed loop without effects, by recording; empty if the controller of a
    # recording is unknown.
    sums: Mapping[str, Sums]
    # Responses of the closed loop, in the order of the recordings.
    responses: tuple[Response, ...]
    bandwidth_Hz: float  # bandwidth of the torque errors
    provenance: Provenance
    # Texts on recordings that are too short for the bandwidth and left out, and on effects of one's
    # own from another version of their file.
    short: tuple[str, ...] = ()
    # Torque of the model with its 90 % band, in the order of the recordings; empty if its
    # result file has no covariance.
    bands: tuple[Banded, ...] = ()

    def inside(self, role: str) -> float | None:
        """Return the share of the measured torque that is in its band, or None without samples."""
        known = [
            ((b.low["torque"] <= b.measured) & (b.measured <= b.high["torque"]))[moving]
            for r, b in zip(self.dataset.recordings, self.bands, strict=False)
            if r.role == role and b.measured is not None
            for moving in [np.isfinite(b.measured)]
        ]
        held = np.concatenate(known) if known else np.zeros(0)
        return float(np.mean(held)) if len(held) else None

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

    def pooled(self) -> dict[str, Sums]:
        """Return the errors of the closed loop over each role that has recordings."""
        return {
            role: pooled(self.sums[name] for name in names)
            for role in ("fit", "validate")
            if (names := self.names(role))
        }

    def errors(self) -> list[dict[str, Any]]:
        """Return the prediction errors, one entry per equation, SI units."""
        units = {"transmission": "rad" if self.rotary else "m", "voltage": "V"}
        return [
            {
                "effects": list(one.effects),
                "equation": equation,
                "unit": units.get(equation, self.unit),
                "rms": one.error(equation, "fit"),
                "validate_rms": one.error(equation, "validate"),
            }
            for one in self.predictions
            for equation in dict.fromkeys(p.equation for p in one.parts)
        ]


def simulate_source(
    source: Path,
    result: Path,
    bandwidth_Hz: float | None,
    progress: Progress,
    own: OwnFile = NO_FILE,
) -> Simulation:
    """Predict every recording of a source with the model of a result file, and simulate the closed
    loop if the controller is known.

    ``bandwidth_Hz``: bandwidth of the errors, or None for the bandwidth of the result, or chosen as
    in the identification; ``own``: file with the effects of one's own of a result.
    """
    started = time.perf_counter()
    progress("reading", 0.0)
    dataset = load_source(source)
    record = read_result(result)
    require_motion(record, dataset.recordings[0].bench.motion, str(result))
    names = [r.name for r in dataset.recordings]
    model = model_of(record, names, str(result), own.catalogue)
    bandwidth_Hz = bandwidth_Hz or record.get("fit", {}).get("bandwidth_Hz")
    with named_errors(source):
        dataset, bandwidth_Hz, short = choose_bandwidth(dataset, bandwidth_Hz)
        prepared = tuple(prepare(r, bandwidth_Hz) for r in dataset.recordings)
        predictions = predict(dataset, model, bandwidth_Hz)
        bands = _bands(result, record, model, dataset, bandwidth_Hz)
        known = all(r.controller is not None for r in dataset.recordings)
        sums, responses = _closed_loop(model, prepared if known else (), progress)
    seconds = time.perf_counter() - started
    provenance = Provenance.of(0, dataset.recordings, seconds, source, dataset.tables)
    read = {str(result): sha256_file(result)}
    made, other = record.get("effects_file"), []
    if made is not None and own.path is not None and made["sha256"] != own.sha256:
        other = [f"{result} was made with another version of {own.path} (see its SHA-256)"]
    return Simulation(
        dataset,
        result,
        model,
        tuple(predictions),
        prepared,
        sums,
        tuple(responses),
        bandwidth_Hz,
        dataclasses.replace(provenance, inputs={**provenance.inputs, **read}),
        (*short, *other),
        bands,
    )


def _bands(
    path: Path,
    record: Mapping[str, Any],
    model: CorrectedModel,
    dataset: Dataset,
    bandwidth_Hz: float,
) -> tuple[Banded, ...]:
    """Return the torque of every recording's motion with its band, with a fixed seed."""
    try:
        fitted = fitted_of(record, model, torque_unit(dataset.recordings[0]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: covariance: damaged: {error}; make the result again") from error
    if fitted is None:
        return ()
    fitted = dataclasses.replace(fitted, bandwidth_Hz=bandwidth_Hz)
    rng, seen = np.random.default_rng(0), views_for(dataset.recordings, bandwidth_Hz, model)
    return tuple(
        prediction.predict(fitted, view.recording, "motion", rng=rng, seen=view) for view in seen
    )


def _closed_loop(
    model: CorrectedModel, prepared: Sequence[Prepared], progress: Progress
) -> tuple[dict[str, Sums], list[Response]]:
    """Simulate the recordings; return the errors by recording, and the responses."""
    sums: dict[str, Sums] = {}
    responses: list[Response] = []
    for p in prepared:
        progress(f"simulating {p.recording.name}", len(sums) / len(prepared))
        responses.append(replay(p.recording, model.parameters, model.alpha))
        sums[p.recording.name] = compare(p, responses[-1])
    return sums, responses


def as_bench(
    source: Path, found: Simulation, own: OwnFile = NO_FILE
) -> tuple[dict[str, str], list[str]]:
    """Return the model as a simulated bench (file name to text), and remarks on this bench.

    If the model cannot be a simulated bench, there is no file, and the remarks state why.
    """
    try:
        constants = found.dataset.recordings[0].bench
        bench, left_out = model_bench(base_bench(source), found.model, constants, own)
        said = f"{BENCH_FILE} beside this page is the model as a simulated bench."
        return {BENCH_FILE: bench_text(bench, left_out)}, [said, *left_out]
    except InputError as error:
        return {}, list(error.problems)


_SHOWN_PER_ROLE = 3


def simulate_document(name: str, found: Simulation, beside: Sequence[str]) -> Document:
    """Return a simulation as a document."""
    return Document(
        f"Simulation of {name}",
        f"Model: {found.file}",
        tuple(_summary(found)),
        tuple(_sections(found, beside)),
    )


def _summary(found: Simulation) -> Iterator[Section]:
    bandwidth = f"{number(found.bandwidth_Hz, 3)} Hz"
    yield Section(f"equation errors at {bandwidth}, in motion", (_errors_of_equations(found),))
    if found.sums:
        head = f"closed loop, simulated from the first sample; torque filtered to {bandwidth}"
        yield Section(head, (_pooled(found),))
    for line in _remarks(found):
        yield Section("", (Note(line, "aside"),))


def _sections(found: Simulation, beside: Sequence[str]) -> Iterator[Section]:
    at = f"at {number(found.bandwidth_Hz, 4)} Hz"
    lines = [f"Equation errors are over samples in motion, {at}.", *_remarks(found)]
    if found.sums:
        lines += [
            "The closed loop is simulated from the first sample on; its inputs are only the "
            "command, the supply and the declared loads.",
            f"Errors of angle are over all samples; errors of torque are {at}.",
        ]
    yield Section("", tuple(map(Paragraph, (*lines, *beside))))
    drawn = _predicted(found)
    yield Section("Equation errors", (_errors_of_equations(found), *drawn))
    if found.sums:
        recordings = columns(
            [(found.sums[r.name], r) for r in found.dataset.recordings],
            (2, 3, 4),
            ("recording", lambda row: row[1].name),
            ("role", lambda row: row[1].role),
            *_error_columns(found),
        )
        yield Section("Closed loop", (_pooled(found),))
        yield Section("Recordings", (recordings, *_simulated(found)))
    yield provenance_section(found.provenance)


def _remarks(found: Simulation) -> Iterator[str]:
    """Yield what the band of the torque holds, where the recordings leave those of the fit, and
    what is left out or not simulated.
    """
    shares = {role: found.inside(role) for role in ("fit", "validate")}
    held = [f"{percent(100.0 * s)} ({role})" for role, s in shares.items() if s is not None]
    if held:
        yield (
            "the 90 % band of the torque, from the uncertainty of the parameters and the error of "
            f"the fit, holds {', '.join(held)} of the samples in motion"
        )
    for recording, band in zip(found.dataset.recordings, found.bands, strict=False):
        yield from (f"{recording.name}: {warning}" for warning in band.warnings)
    yield from found.short
    if not found.sums:
        yield (
            "no closed loop: the controller of these recordings is not declared (`controller:` in "
            "a campaign)"
        )
    elif found.model.effects:
        yield (
            "the closed loop is simulated without the effects; a simulated bench made from the "
            "result contains the effects"
        )


def _errors_of_equations(found: Simulation) -> Table:
    """Return one row for each equation, with the effects of the model and without."""
    shown = {"rad": ("mrad", 1e3), "m": ("um", 1e6)}

    def scaled(row: Mapping[str, Any], key: str) -> str:
        scale = shown.get(row["unit"], ("", 1.0))[1]
        return number(None if row[key] is None else scale * row[key], 4)

    return columns(
        found.errors(),
        (2, 3),
        ("effects", lambda e: ", ".join(e["effects"]) or "none"),
        ("equation", lambda e: e["equation"]),
        ("rms, fit", lambda e: scaled(e, "rms")),
        ("rms, validate", lambda e: scaled(e, "validate_rms")),
        ("unit", lambda e: shown.get(e["unit"], (e["unit"],))[0]),
    )


def _error_columns(found: Simulation) -> Iterator[tuple[str, Callable[[Any], str]]]:
    """Yield the columns of the errors of the closed loop, the first item of each row."""
    force, angle, scale = "torque", "angle error (mrad)", 1e3
    if not found.rotary:
        force, angle, scale = "force", "position error (um)", 1e6
    yield f"{force} error ({found.unit})", lambda row: number(row[0].torque_rms, 4)
    yield "relative", lambda row: percent(100.0 * row[0].torque_relative)
    yield angle, lambda row: number(scale * row[0].angle_rms, 4)


def _pooled(found: Simulation) -> Table:
    """Return one row for each role."""
    return columns(
        [(sums, role) for role, sums in found.pooled().items()],
        (1, 2, 3, 4),
        ("role", lambda row: row[1]),
        ("recordings", lambda row: str(len(found.names(row[1])))),
        *_error_columns(found),
    )


def _predicted(found: Simulation) -> list[Picture]:
    """Return figures of the torque equation, for a few recordings."""
    parts = [p for p in found.predictions[0].parts if p.equation == "torque"]
    names = [r.name for r in found.dataset.recordings]
    bands = dict(zip(names, found.bands, strict=False))
    return [
        Picture.of(
            f"predicted_{p.recording}",
            f"{p.recording} ({p.role}): torque measured and predicted",
            predicted(p, found.unit, bands.get(p.recording)),
        )
        for p in few_of_each_role(parts, lambda part: part.role, _SHOWN_PER_ROLE)
    ]


def _simulated(found: Simulation) -> list[Picture]:
    """Return figures of the closed loop, for a few recordings."""
    pairs = list(zip(found.prepared, found.responses, strict=True))
    shown = few_of_each_role(pairs, lambda pair: pair[0].recording.role, _SHOWN_PER_ROLE)
    return [
        Picture.of(
            f"simulated_{p.recording.name}",
            f"{p.recording.name}: measured and simulated",
            simulated(p, response),
        )
        for p, response in shown
    ]


SIMULATE_SCHEMA = "loadrig.simulate/2"


def simulation_record(found: Simulation) -> dict[str, Any]:
    """Return the record of ``rig simulate --json``."""

    def errors(sums: Sums) -> dict[str, float]:
        return {
            "torque_rms": sums.torque_rms,
            "torque_relative": sums.torque_relative,
            "angle_rms": sums.angle_rms,
        }

    return {
        **found.provenance.record(SIMULATE_SCHEMA),
        "result": str(found.file),
        "unit": found.unit,
        "angle_unit": "rad" if found.rotary else "m",
        "bandwidth_Hz": found.bandwidth_Hz,
        "equations": found.errors(),
        "band": {
            "inside": {role: found.inside(role) for role in ("fit", "validate")},
            "outside": {
                r.name: float(np.mean(b.outside))
                for r, b in zip(found.dataset.recordings, found.bands, strict=False)
            },
        },
        "closed_loop": {
            **{role: errors(sums) for role, sums in found.pooled().items()},
            "recordings": {name: errors(sums) for name, sums in found.sums.items()},
        }
        if found.sums
        else None,
    }
