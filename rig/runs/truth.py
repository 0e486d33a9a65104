"""Reads the true parameters of a simulated bench, for the tables of a demonstration.

Only code that prints uses this module, after the estimators have finished; the dataset of the
estimators does not contain the true parameters.
"""

from __future__ import annotations

from pathlib import Path

from drivers.mock.plant.parts.constants import Machine
from rig.common.errors import InputError
from rig.common.input_files import is_file
from rig.common.provenance import sha256_file
from rig.config.bench import load_bench
from rig.config.packaged import packaged
from rig.runs.recorded_inputs import recorded_input
from rig.runs.run_file import read_record
from rig.runs.run_record import BENCH_ATTACHMENT, RUN_FILE

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
    """Return the nine parameters of a simulated machine under the names of the estimators, SI
    units.
    """
    return {name: getattr(machine.joint, field) for name, field in JOINT_FIELDS.items()}


def truth_of(source: Path) -> dict[str, float] | None:
    """Return the true parameters of a run on a simulated bench, or None if they are not available.

    The run folder does not contain the true parameters. They are read from the bench file of the
    run or from a packaged file of this name, if the file has the recorded SHA-256. The result is
    None for a bench with injected effects.

    Raises:
        InputError: ``run.json`` is damaged.
    """
    if not is_file(source / RUN_FILE):
        return None
    record = read_record(source)
    entry = record.inputs.get(BENCH_ATTACHMENT)
    if not record.simulated or entry is None:
        return None
    path = recorded_input(source, entry)
    for candidate in (path, packaged(path.stem, "benches")):
        if is_file(candidate) and sha256_file(candidate) == entry["sha256"]:
            try:
                machine = load_bench(candidate).value.mock
            except InputError:
                # This version cannot read the bench file, but can still identify the recording.
                return None
            return None if machine is None or machine.effects else true_parameters(machine)
    return None
