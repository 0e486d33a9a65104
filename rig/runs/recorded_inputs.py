"""Finds the input files of a run by their entries in ``run.json``."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

from rig.common.errors import InputError
from rig.common.places import is_file, read_bytes
from rig.common.provenance import sha256, sha256_file
from rig.common.text import stored_path, valid
from rig.config.configuration import packaged
from rig.runs.mcap.reader import DamageError, first_attachment
from rig.runs.run_file import read_record
from rig.runs.run_record import ACCEPTANCE_INPUT, BENCH_ATTACHMENT, RUN_FILE, RunRecord

if TYPE_CHECKING:
    from drivers.mock.plant.parts.constants import Machine


@dataclass(frozen=True)
class GivenFile:
    """A file that was given to a run in addition to bench and sequence."""

    entry: Mapping[str, str]
    content: bytes

    @classmethod
    def of(cls, path: Path) -> Self:
        """Read a file."""
        content = path.read_bytes()
        return cls(input_entry(path, sha256(content)), content)


def input_entry(path: str | os.PathLike[str], sha256: str) -> dict[str, str]:
    """Return the entry of an input file, with an absolute path, for ``run.json``."""
    return {"file": valid(os.path.abspath(path)), "sha256": sha256}


def recorded_acceptance(folder: Path, record: RunRecord) -> GivenFile | None:
    """Return the file of limits that was last given to a run, from the recordings of the run, or
    None if no file was given.

    If no recording contains the file, because a recording could not be started, the file itself is
    read, provided that it is unchanged.
    """
    entry = record.inputs.get(ACCEPTANCE_INPUT)
    if entry is None:
        return None
    for content in _copies(folder, record, entry):
        if sha256(content) == entry["sha256"]:
            return GivenFile(entry, content)
    raise InputError(
        f"{folder}: no recording of this run contains the limits that the run was given "
        f"({entry['file']}); give these limits with --acceptance FILE"
    )


def _copies(folder: Path, record: RunRecord, entry: Mapping[str, str]) -> Iterator[bytes]:
    """Yield the contents that may be the file of limits that was given to a run."""
    for part in reversed(record.parts):
        with suppress(DamageError, OSError):
            yield first_attachment(folder / part.file, ACCEPTANCE_INPUT)
    with suppress(OSError, ValueError):
        yield read_bytes(stored_path(entry["file"]))


JOINT_FIELDS = {
    "J": "inertia_kg_m2",
    "Mc": "Mc_N_m",
    "Ms": "Ms_N_m",
    "omega_sf": "omega_sf_rad_s",
    "sigma_2": "sigma_2_N_m_s_rad",
    "mu_c": "mu_c",
    "mu_s": "mu_s",
    "omega_sL": "omega_sL_rad_s",
    "mu_2": "mu_2_s_rad",
}
"""Names in the simulated joint by the parameter names of the estimators."""


def true_parameters(machine: Machine) -> dict[str, float]:
    """Return the parameters of a simulated machine by the estimators' names, SI."""
    return {name: getattr(machine.joint, field) for name, field in JOINT_FIELDS.items()}


def truth_of(source: Path) -> dict[str, float] | None:
    """Return the true parameters of a run on a simulated bench, or None if they are not available.

    The run folder does not contain the true parameters. They are read from the bench file of the
    run or from a packaged file of this name, if the file has the recorded SHA-256. The result is
    None for a bench with injected effects or another machine.
    """
    if not is_file(source / RUN_FILE):
        return None
    record = read_record(source)
    entry = record.inputs.get(BENCH_ATTACHMENT)
    if not record.simulated or entry is None:
        return None
    # Imported here, because measured recordings can be read without the drivers.
    from rig.config.bench import load_bench

    path = stored_path(entry["file"])
    for candidate in (path, packaged(path.stem, "benches")):
        if is_file(candidate) and sha256_file(candidate) == entry["sha256"]:
            try:
                machine = load_bench(candidate).value.mock
            except InputError:
                # This version cannot read the bench file, but can still identify the recording.
                return None
            if machine is None or machine.effects or machine.plant:
                return None
            return true_parameters(machine)
    return None
