"""The truth behind a simulated bench, for the tables of a demonstration.

Only code that prints uses this, after the estimators are done; the dataset that they are given holds nothing of it.
"""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from drivers.mock.plant.constants import Machine
from rig.bench import Bench
from rig.mcap_reader import read_run
from rig.run_file import read_record
from rig.run_record import BENCH_ATTACHMENT, RECORDING_FILE, RUN_FILE
from rig.yaml_tree import DocumentError, parse


def true_parameters(machine: Machine) -> dict[str, float]:
    """Return a simulated machine's nine parameters under the names of the estimators, SI units."""
    joint = machine.joint
    return {
        "Mc": joint.Mc_N_m,
        "Ms": joint.Ms_N_m,
        "omega_sf": joint.omega_sf_rad_s,
        "sigma_2": joint.sigma_2_N_m_s_rad,
        "J": joint.inertia_kg_m2,
        "mu_c": joint.mu_c,
        "mu_s": joint.mu_s,
        "omega_sL": joint.omega_sL_rad_s,
        "mu_2": joint.mu_2_s_rad,
    }


def truth_of(source: Path) -> dict[str, float] | None:
    """Return the true parameters of a run on the simulated bench, or None for anything else, or where
    its bench file is of a version that is not understood.

    They come from the bench file that is attached to the run's recording.

    Raises:
        InputError: ``run.json`` is damaged.
    """
    if not (source / RUN_FILE).is_file() or not read_record(source).simulated:
        return None
    attached = read_run(source / RECORDING_FILE).attachments.get(BENCH_ATTACHMENT)
    if attached is None:
        return None
    try:
        tree, _ = parse(attached.decode("utf-8"))
        machine = Bench.model_validate_json(json.dumps(tree.plain()), strict=True).mock
    except (ValidationError, DocumentError, UnicodeDecodeError):
        # A bench file that this version does not know; the recording can be identified all the same.
        return None
    return None if machine is None else true_parameters(machine)
