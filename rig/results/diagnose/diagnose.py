"""Diagnoses a source, and adds run time and provenance to the result."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.gas import diagnose_gas, has_gas_channels
from identification.diagnosis.joint import Joint
from identification.diagnosis.result import Diagnosis, Verdict
from identification.estimate.covariance import uncertain_constants
from identification.estimate.default import identify_any_length
from identification.export.model import refit
from identification.recording import Dataset, RecordingError
from rig.common.errors import InputError
from rig.common.provenance import Provenance
from rig.results.diagnose.model_file import diagnosis_record, effects_record, model_of
from rig.runs.run_file import partial_warnings, without_partial
from rig.sources import load_source

RESULT_FILE = "diagnose.json"
EFFORT = frozenset({"torque", "current", "voltage"})
"""Channels from any of which the drive torque can be computed."""
REFINED_SAMPLES = 60_000
"""Number of samples up to which a new fit of the nominal parameters takes about as long as the
search for effects, some ten seconds.
"""


@dataclass(frozen=True)
class Outcome:
    """Result of ``rig diagnose``."""

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
    refine: bool = False,
    gas: bool = False,
    inspect: Callable[[Joint], None] | None = None,
    partial: bool = False,
) -> Outcome:
    """Diagnose a run folder or campaign file.

    Args:
        source: Run folder or campaign file.
        seed: Seed of the random generator.
        bandwidth_Hz: Bandwidth of every equation except that of the pressure; None to choose it
            from the recordings.
        progress: Called with the current step and the completed share.
        refine: Whether to refine the nominal parameters: if nothing is missing, the values are
            those of ``rig identify``; if physics is missing, the parameters are fitted again by
            prediction errors, with the effects subtracted, for at most :data:`REFINED_SAMPLES`
            samples. The parameters of a gas generator are always fitted again.
        gas: Whether to diagnose the gas generator although the recordings have torque too;
            recordings without a firing are left out.
        inspect: Receives the nominal model's fit before the search; not called for a gas
            generator.
        partial: Whether to use unfinished excitations of a run as well; a warning in the result
            names these excitations.

    Raises:
        InputError: The source cannot be read, or its recordings cannot be diagnosed.
    """
    started = time.perf_counter()
    if progress is not None:
        progress("reading", 0.0)
    dataset, exact = _as_exact(load_source(source, partial=partial))
    try:
        rng = np.random.default_rng(seed)
        if gas or without_torque(dataset):
            dataset = burning(dataset)
            found = diagnose_gas(dataset, rng=rng, progress=progress)
        else:
            estimate = functools.partial(_identified, seed=seed, progress=progress)
            found = diagnose(
                dataset,
                bandwidth_Hz=bandwidth_Hz,
                rng=rng,
                progress=progress,
                inspect=inspect,
                estimate=estimate if refine else None,
            )
            found = _refined(dataset, found, seed, progress) if refine else found
    except RecordingError as error:
        raise InputError(f"{source}: {error}{without_partial(dataset)}") from error
    seconds, found = time.perf_counter() - started, settled(found)
    warnings = (*found.warnings, *partial_warnings(dataset), *exact)
    found = dataclasses.replace(found, seconds=seconds, warnings=warnings)
    provenance = Provenance.of(seed, dataset.recordings, seconds, source, dataset.tables)
    return Outcome(dataset, found, provenance)


def _as_exact(dataset: Dataset) -> tuple[Dataset, list[str]]:
    """Return a dataset without priors and uncertainties, and warnings that state this."""
    constants = uncertain_constants(dataset.part("fit"))
    warnings = []
    if constants:
        listed = ", ".join(f"{c.place} {c.value:.4g} +- {c.uncertainty:.2g}" for c in constants)
        warnings.append(
            "the diagnosis takes known constants as exact: its intervals do not contain the "
            f"uncertainty of {listed}; the intervals of rig identify do"
        )
    if dataset.model.priors:
        warnings.append(
            f"the diagnosis does not use the priors of {', '.join(dataset.model.priors)}: it "
            "fits these parameters freely"
        )
    recordings = tuple(dataclasses.replace(r, uncertainties={}) for r in dataset.recordings)
    model = dataclasses.replace(dataset.model, priors={})
    return dataclasses.replace(dataset, recordings=recordings, model=model), warnings


def without_torque(dataset: Dataset) -> bool:
    """Return whether all recordings have the pressure of a gas generator and none has torque."""
    return all(has_gas_channels(r) and not r.channels.keys() & EFFORT for r in dataset.recordings)


def burning(dataset: Dataset) -> Dataset:
    """Return the recordings of a gas generator: hot firings, and recordings without torque.

    Raises:
        RecordingError: No recording is of a gas generator.
    """
    kept = tuple(
        r
        for r in dataset.recordings
        if has_gas_channels(r) and (r.hot_fire or not r.channels.keys() & EFFORT)
    )
    if not kept:
        raise RecordingError(
            "no recording is a hot firing with pressure, angle and bench.gas_generator"
        )
    return dataclasses.replace(dataset, recordings=kept)


def refined(dataset: Dataset, found: Diagnosis, seed: int) -> Diagnosis:
    """Return a diagnosis whose nominal parameters are from the default estimator, after the effects
    have been subtracted.

    Raises:
        RecordingError: The recordings do not determine the nominal model.
    """
    record = {"parameters": found.parameters, "alpha": found.alpha, **effects_record(found)}
    model = model_of(record, [r.name for r in dataset.recordings])
    rng = np.random.default_rng(seed)
    result = refit(dataset, model, found.fit.bandwidth_Hz, rng)
    values = result.values()
    shift = {
        n: dataclasses.replace(s, after=values.get(n)) for n, s in found.parameter_shift.items()
    }
    notes = tuple(f"nominal parameters fitted again: {w}" for w in result.warnings)
    return dataclasses.replace(
        found,
        parameters={**found.parameters, **values},
        parameter_shift=shift,
        warnings=(*found.warnings, *notes),
    )


def _identified(
    dataset: Dataset, seed: int, progress: Callable[[str, float], None] | None
) -> tuple[dict[str, float | None], tuple[str, ...]]:
    """Return the parameters by ``rig identify``, None if undetermined, and its warnings."""
    try:
        result = identify_any_length(dataset, rng=np.random.default_rng(seed), progress=progress)
    except RecordingError as error:
        return {}, (f"not identified: {error}",)
    return {**result.values()}, tuple(f"identification: {w}" for w in result.warnings)


def _refined(
    dataset: Dataset, found: Diagnosis, seed: int, progress: Callable[[str, float], None] | None
) -> Diagnosis:
    """Refine a diagnosis that found physics missing, or state in a warning why this is not done."""
    if found.verdict is Verdict.NOTHING_MISSING:
        return found
    samples = sum(len(r.time) for r in dataset.part("fit"))
    if samples > REFINED_SAMPLES:
        note = (
            f"with {samples} samples (more than {REFINED_SAMPLES}), the nominal parameters are "
            f"from equation errors at the bandwidth {found.fit.bandwidth_Hz:.3g} Hz: static "
            "friction and Stribeck speed are less precise than those of rig identify"
        )
        return dataclasses.replace(found, warnings=(*found.warnings, note))
    if progress is not None:
        progress("fitting the nominal parameters again", 0.95)
    try:
        return refined(dataset, found, seed)
    except RecordingError as error:
        note = f"the nominal parameters were not fitted again: {error}"
        return dataclasses.replace(found, warnings=(*found.warnings, note))


def settled(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis in which static friction equals Coulomb friction if the recordings do not
    determine static friction.

    Equation errors at a low bandwidth may give an arbitrarily high static friction below the
    resolvable speed, and a machine simulated with this friction never breaks away. Static friction
    is then set to Coulomb friction, and the result states this.
    """
    parameters, notes = dict(found.parameters), []
    for static, coulomb in (("Ms", "Mc"), ("mu_s", "mu_c"), ("mu_gs", "mu_gc")):
        shift = found.parameter_shift.get(static)
        if shift is not None and shift.after is None and {static, coulomb} <= parameters.keys():
            parameters[static] = parameters[coulomb]
            notes.append(
                f"{static} is not determined by these recordings; the corrected model sets it "
                f"equal to {coulomb}"
            )
    return dataclasses.replace(found, parameters=parameters, warnings=(*found.warnings, *notes))
