"""From a source to its diagnosis, timed, with its provenance."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.corrected.refit import refit
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.gas.burns import bears
from identification.diagnosis.gas.diagnose import diagnose_gas
from identification.diagnosis.joint import Joint
from identification.diagnosis.result import Diagnosis
from identification.recording import Dataset, RecordingError
from rig.common.errors import InputError
from rig.common.input_files import is_folder
from rig.common.result_files import Provenance
from rig.results.diagnose.model_file import model_of
from rig.results.diagnose.record import diagnosis_record, effects_record
from rig.runs.partial import partial_warnings, without_partial
from rig.runs.run_record import RUN_FILE
from rig.sources import load_source

RESULT_FILE = "diagnose.json"
EFFORT = frozenset({"torque", "current", "voltage"})
"""Channels any of which gives the drive's torque."""
REFINED_SAMPLES = 60_000
"""Samples up to which refining takes about as long as the search, some ten seconds."""


@dataclass(frozen=True)
class Outcome:
    """What ``rig diagnose`` found.

    Attributes:
        dataset: What was diagnosed.
        diagnosis: The verdict with its evidence.
        provenance: Seed, inputs, time.
    """

    dataset: Dataset
    diagnosis: Diagnosis
    provenance: Provenance

    def record(self) -> dict[str, Any]:
        """Return the record of ``rig diagnose --json``."""
        return diagnosis_record(self.diagnosis, self.dataset, self.provenance)


def diagnose_source(
    source: Path,
    seed: int,
    bandwidth_Hz: float | None = None,
    progress: Callable[[str, float], None] | None = None,
    refine: bool | None = False,
    gas: bool = False,
    onlooker: Callable[[Joint], None] | None = None,
    partial: bool = False,
) -> Outcome:
    """Diagnose a run folder or campaign file.

    Args:
        source: Run folder or campaign file.
        seed: Of the random generator.
        bandwidth_Hz: Bandwidth of every error; None leaves it to the recordings. Pressure keeps its
        own.
        progress: Called with what is being done and the share that is done.
        refine: Whether to refit the nominal parameters by prediction errors, with the effects taken
            out, where the recordings allow it; None where there are :data:`REFINED_SAMPLES` at
            most. Those of a gas generator always are.
        gas: Diagnose the gas generator though there is torque as well; recordings in which none
        burns are left out.
        onlooker: Shown the nominal model's fit before anything is sought; not of a gas generator.
        partial: Whether to take the unfinished excitations of a run as well; the result warns of
            them.

    Raises:
        InputError: The source cannot be read, or its recordings cannot be diagnosed.
    """
    started = time.perf_counter()
    if progress is not None:
        progress("reading", 0.0)
    dataset = load_source(source, partial=partial)
    described_by = source / RUN_FILE if is_folder(source) else source
    try:
        rng = np.random.default_rng(seed)
        if gas or without_torque(dataset):
            dataset = burning(dataset)
            found, refine = diagnose_gas(dataset, rng=rng, progress=progress), False
        else:
            found = diagnose(
                dataset, bandwidth_Hz=bandwidth_Hz, rng=rng, progress=progress, onlooker=onlooker
            )
        if refine is None:
            found, refine = _refined_or_told(dataset, found)
        if refine:
            if progress is not None:
                progress("refining", 0.95)
            found = _refined_if_possible(dataset, found, seed)
    except RecordingError as error:
        raise InputError(f"{source}: {error}{without_partial(dataset)}") from error
    seconds = time.perf_counter() - started
    found = settled(found)
    warnings = (*found.warnings, *partial_warnings(dataset))
    found = dataclasses.replace(found, seconds=seconds, warnings=warnings)
    return Outcome(dataset, found, Provenance.of(seed, dataset.recordings, seconds, described_by))


def without_torque(dataset: Dataset) -> bool:
    """Whether recordings say nothing of the torque, and all of their gas generator."""
    return all(bears(r) and not r.channels.keys() & EFFORT for r in dataset.recordings)


def burning(dataset: Dataset) -> Dataset:
    """Return the recordings in which a gas generator burns: hot firings, and what has no torque.

    Raises:
        RecordingError: There are none.
    """
    kept = tuple(
        r for r in dataset.recordings if bears(r) and (r.hot_fire or not r.channels.keys() & EFFORT)
    )
    if not kept:
        raise RecordingError(
            "no hot firing with pressure and angle on a bench with bench.gas_generator"
        )
    return dataclasses.replace(dataset, recordings=kept)


def refined(dataset: Dataset, found: Diagnosis, seed: int) -> Diagnosis:
    """Return a diagnosis whose nominal parameters are those of the default estimator with the
    effects taken out.

    Args:
        dataset: What was diagnosed.
        found: The diagnosis.
        seed: Of the estimator's random generator.

    Raises:
        RecordingError: The recordings cannot pin the nominal model.
    """
    record = {"parameters": found.parameters, "alpha": found.alpha, **effects_record(found)}
    model = model_of(record, [r.name for r in dataset.recordings])
    rng = np.random.default_rng(seed)
    result = refit(dataset, model, found.fit.bandwidth_Hz, rng)
    values = result.values()
    shift = {
        n: dataclasses.replace(s, after=values.get(n)) for n, s in found.parameter_shift.items()
    }
    notes = tuple(f"refined: {w}" for w in result.warnings)
    return dataclasses.replace(
        found,
        parameters={**found.parameters, **values},
        parameter_shift=shift,
        warnings=(*found.warnings, *notes),
    )


def _refined_or_told(dataset: Dataset, found: Diagnosis) -> tuple[Diagnosis, bool]:
    """Say whether refining takes no longer than the search; where it does, tell how to ask for
    it.
    """
    samples = sum(len(r.time) for r in dataset.part("fit"))
    if samples <= REFINED_SAMPLES:
        return found, True
    note = (
        f"not refined: {samples} samples are fitted, and refining them takes minutes; --refine "
        f"does it"
    )
    return dataclasses.replace(found, warnings=(*found.warnings, note)), False


def _refined_if_possible(dataset: Dataset, found: Diagnosis, seed: int) -> Diagnosis:
    """Refine where the recordings allow it; where not, say why and keep the values of the
    search.
    """
    try:
        return refined(dataset, found, seed)
    except RecordingError as error:
        return dataclasses.replace(found, warnings=(*found.warnings, f"not refined: {error}"))


def settled(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis that says nothing of friction at rest where its recordings do not pin it.

    The equation errors at a low bandwidth may leave static friction at any height above a speed too
    low to be seen, and a machine made of that never breaks away: it is brought down to Coulomb's,
    and the result says so.
    """
    parameters, notes = dict(found.parameters), []
    for static, coulomb in (("Ms", "Mc"), ("mu_s", "mu_c"), ("mu_gs", "mu_gc")):
        shift = found.parameter_shift.get(static)
        if shift is not None and shift.after is None and {static, coulomb} <= parameters.keys():
            parameters[static] = parameters[coulomb]
            notes.append(
                f"{static} is not pinned by these recordings; the corrected model has it equal to "
                f"{coulomb}"
            )
    return dataclasses.replace(found, parameters=parameters, warnings=(*found.warnings, *notes))
