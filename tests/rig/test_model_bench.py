"""A simulated bench made from a result reproduces the recording that the result describes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from identification.recording import Bench as Constants
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import Bench, load_bench
from rig.results.diagnose.model_bench import base_bench, model_bench
from rig.results.diagnose.model_file import model_of
from rig.runs.run import bench_constants, load_run

from .benches import sine, stages

SEQUENCE = stages(sine("free", 8, 0.5, 2.5))
NOMINAL = {
    "J": 0.21, "Mc": 5.9, "Ms": 10.1, "omega_sf": 0.061, "sigma_2": 4.4, "mu_c": 0.05, "mu_s": 0.08,
    "omega_sL": 0.03, "mu_2": 0.03,
}  # fmt: skip
EFFECTS = {
    "asymmetric_coulomb": {"torque_Nm": 0.9},
    "cogging": {"torque_Nm": 0.7, "per_motor_turn": 7.0, "phase_rad": 0.4},
}


CURVE = {
    "equation": "torque", "coordinate": "angle", "unit": "rad", "residual_unit": "N m",
     "grid": [0.0, 1.0],
    "value": [0.0, 1.0],
}  # fmt: skip


def record(effects: dict[str, dict[str, float]], **more: Any) -> dict[str, Any]:
    """A result of ``rig diagnose``, as far as it holds the model."""
    where = {"recordings": ["b"]}
    listed = [
        {"name": name, "where": where, "parameters": {k: {"value": v} for k, v in given.items()}}
        for name, given in effects.items()
    ]
    return {"parameters": NOMINAL, "alpha": 1.8, "effects": listed, **more}


def run(tmp_path: Path, name: str, bench: dict[str, Any]) -> Path:
    (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(bench))
    (tmp_path / "short.yaml").write_text(SEQUENCE)
    out = tmp_path / name
    files = [str(tmp_path / "short.yaml"), "--bench", str(tmp_path / f"{name}.yaml")]
    assert status(["run", *files, "--yes", "--out", str(out)]) == 0
    return out


def test_the_loop_is_closed(tmp_path: Path) -> None:
    hidden = base_bench(tmp_path)
    hidden["mock"]["joint"] |= {
        "inertia_kg_m2": 0.21, "Mc_N_m": 5.9, "Ms_N_m": 10.1, "omega_sf_rad_s": 0.061,
        "sigma_2_N_m_s_rad": 4.4,
        "mu_c": 0.05, "mu_s": 0.08, "omega_sL_rad_s": 0.03, "mu_2_s_rad": 0.03, "alpha": 1.8,
    }  # fmt: skip
    hidden["mock"]["effects"] = EFFECTS
    recorded = run(tmp_path, "hidden", hidden)
    (original,) = load_run(recorded).recordings
    bench, notes = model_bench(
        base_bench(recorded), model_of(record(EFFECTS), ["free"]), original.bench
    )
    assert notes == []
    (again,) = load_run(run(tmp_path, "corrected", bench)).recordings
    for channel in ("angle", "motor_angle", "current"):
        assert np.array_equal(again.channels[channel], original.channels[channel]), channel
    plain, _ = model_bench(base_bench(recorded), model_of(record({}), ["free"]), original.bench)
    (nominal,) = load_run(run(tmp_path, "nominal", plain)).recordings
    assert np.max(np.abs(nominal.channels["current"] - original.channels["current"])) > 0.3


def test_what_belongs_to_one_recording_names_its_place() -> None:
    constants = bench_constants(load_bench("practical").value)
    bench, _ = model_bench(
        base_bench(Path()),
        model_of(record({"wrong_weight": {"mass_kg": 24.0}}), ["a", "b"]),
        constants,
    )
    assert bench["mock"]["effects"] == {"wrong_weight": {"mass_kg": 24.0, "recording": 2.0}}


def test_what_the_machine_cannot_be_is_told_and_left_out() -> None:
    constants = bench_constants(load_bench("practical").value)
    found = record({"time_skew": {"time_s": -0.002}, "backlash": {"gap_rad": 0.006}}, curve=CURVE)
    bench, notes = model_bench(base_bench(Path()), model_of(found, ["a"]), constants)
    assert bench["mock"]["effects"] == {"backlash": {"gap_rad": 0.006}}
    assert notes[0].startswith(
        "time_skew is left out of the simulated bench: time_skew.time_s: must be within 0 to"
    )
    assert "empirical curve" in notes[1]


def test_fitted_constants_of_the_motor_are_in_it_and_other_parameters_are_noted() -> None:
    constants = bench_constants(load_bench("practical").value)
    more = {"R": 1.7, "Ke": 0.027, "offset": 0.3, "mu_gc": 0.05, "mu_gs": 0.0, "J_r": 0.1}
    found = record({}) | {"parameters": NOMINAL | more}
    bench, notes = model_bench(base_bench(Path()), model_of(found, ["a"]), constants)
    motor = bench["mock"]["motor"]
    assert (motor["resistance_ohm"], motor["back_emf_constant_V_s_rad"]) == (1.7, 0.027)
    assert bench["machine"]["resistance_ohm"] == constants.resistance
    assert [note.partition(" ")[0] for note in notes] == ["offset", "mu_gc", "J_r"]
    Bench.model_validate_json(json.dumps(bench), strict=True)


def test_an_unloaded_result_makes_a_machine_without_load_friction() -> None:
    constants = bench_constants(load_bench("practical").value)
    found = record({}) | {
        "parameters": {n: v for n, v in NOMINAL.items() if not n.startswith("mu_")}
    }
    bench, _ = model_bench(base_bench(Path()), model_of(found, ["a"]), constants)
    assert bench["mock"]["joint"]["mu_c"] == bench["mock"]["joint"]["mu_s"] == 0.0
    Bench.model_validate_json(json.dumps(bench), strict=True)


@pytest.mark.parametrize(
    ("constants", "found", "why"),
    [
        (Constants(), record({}), "resistance_ohm"),
        (None, record({}) | {"parameters": NOMINAL | {"J": None}}, "needs J"),
        (Constants(motion="linear"), record({}), "which the result"),
    ],
)
def test_what_a_machine_needs_is_asked_for(constants, found, why):
    with pytest.raises(InputError, match=why):
        model_bench(
            base_bench(Path()),
            model_of(found, ["a"]),
            constants or bench_constants(load_bench("practical").value),
        )
