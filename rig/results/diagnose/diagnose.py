"""Diagnoses a source, and adds run time and provenance to the result."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.diagnosis.diagnose import as_exact, diagnose
from identification.diagnosis.gas import diagnose_gas, has_gas_channels
from identification.diagnosis.joint import Joint
from identification.diagnosis.result import Diagnosis
from identification.diagnosis.search import Search
from identification.estimate.default import identify_any_length
from identification.numerics.arrays import Progress
from identification.recording import Dataset, RecordingError
from rig.common.errors import InputError
from rig.common.provenance import Provenance
from rig.results.diagnose.model_file import diagnosis_record
from rig.results.diagnose.own_effects import NO_FILE, OwnFile
from rig.results.measured import named_errors
from rig.runs.run_file import partial_warnings, without_partial
from rig.sources import load_source

RESULT_FILE = "diagnose.json"
EFFORT = frozenset({"torque", "current", "voltage"})
"""Channels from any of which the drive torque can be computed."""


@dataclass(frozen=True)
class Outcome:
    """Result of ``rig diagnose``."""

    dataset: Dataset
    diagnosis: Diagnosis
    provenance: Provenance
    own: OwnFile = NO_FILE

    def record(self) -> dict[str, Any]:
        """Return the record of ``rig diagnose --json``."""
        return {
            **diagnosis_record(self.diagnosis, self.dataset, self.provenance),
            **self.own.record,
        }


def diagnose_source(
    source: Path,
    seed: int,
    bandwidth_Hz: float | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    gas: bool = False,
    inspect: Callable[[Joint], None] | None = None,
    partial: bool = False,
    own: OwnFile = NO_FILE,
) -> Outcome:
    """Diagnose a run folder or campaign file, see :func:`diagnose_dataset`.

    With ``partial``, unfinished excitations of a run are used as well; a warning in the result
    names these excitations.
    """
    if progress is not None:
        progress("reading", 0.0)
    stated = load_source(source, partial=partial)
    return diagnose_dataset(
        stated, source, seed, bandwidth_Hz, progress, refine, gas, inspect, own=own
    )


def diagnose_dataset(
    stated: Dataset,
    source: Path,
    seed: int,
    bandwidth_Hz: float | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    gas: bool = False,
    inspect: Callable[[Joint], None] | None = None,
    searched: Callable[[Search], None] | None = None,
    own: OwnFile = NO_FILE,
) -> Outcome:
    """Diagnose recordings.

    Args:
        stated: The recordings, with uncertainties and priors as stated.
        source: Run folder or campaign file of the recordings, or of the first of them.
        seed: Seed of the random generator.
        bandwidth_Hz: Bandwidth of every equation except that of the pressure; None to choose it
            from the recordings.
        progress: Called with the current step and the completed share.
        refine: Whether the constants of the nominal model are those of ``rig identify``, and those
            of the corrected model are fitted again by prediction errors, with the effects
            subtracted. The parameters of a gas generator are always fitted again.
        gas: Whether to diagnose the gas generator although the recordings have torque too;
            recordings without a firing are left out.
        inspect: Receives the nominal model's fit before the search; not called for a gas
            generator.
        searched: Receives the fits of all hypotheses after the search; not called for a gas
            generator.
        own: File with effects of one's own, which a gas generator does not have.

    Raises:
        InputError: The source cannot be read, its recordings cannot be diagnosed, or an effect of
            one's own fails.
    """
    started = time.perf_counter()
    dataset, exact = as_exact(stated)
    with named_errors(source, without_partial(dataset)):
        rng = np.random.default_rng(seed)
        if gas or without_torque(dataset):
            if own.effects:
                raise InputError(
                    f"{source}: effects of one's own are effects of the motion, but this is a "
                    "diagnosis of a gas generator; leave --effects out"
                )
            dataset = burning(dataset)
            found = diagnose_gas(dataset, rng=rng, progress=progress)
        else:
            found = diagnose(
                dataset,
                bandwidth_Hz=bandwidth_Hz,
                rng=rng,
                progress=progress,
                inspect=inspect,
                searched=searched,
                # The result of `rig identify` with this seed.
                estimate=(
                    lambda _exact: identify_any_length(
                        stated, rng=np.random.default_rng(seed), progress=progress
                    )
                )
                if refine
                else None,
                effects=own.effects,
            )
    seconds = time.perf_counter() - started
    warnings = (*found.warnings, *partial_warnings(dataset), *exact)
    found = dataclasses.replace(found, seconds=seconds, warnings=warnings)
    provenance = Provenance.of(seed, dataset.recordings, seconds, source, dataset.tables)
    return Outcome(dataset, found, provenance, own)


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
