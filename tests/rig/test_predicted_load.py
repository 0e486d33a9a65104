"""Predicted peaks of torque and current: against eq. 9 to 13, and the simulated bench."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.model.parameters import NOMINAL
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Array, Sequence, load_sequence
from rig.planning.plan import Plan, make_plan
from rig.planning.predicted_load import (
    LOOP_S,
    FrictionModel,
    friction_model,
    moves_to_start,
    peak_torque,
    predicted_peaks,
)
from rig.runs.run import bench_constants, load_run

CYCLE_S = 1e-3
PER_KG = 10 * 9.80665 * 0.095
MODEL = FrictionModel(NOMINAL, 2.0, 0.095, PER_KG, "known", measured=True)
P = NOMINAL


def constant(travel: float, speed: float) -> Array:
    """Return angles at a constant speed, rad, from rest and to rest."""
    cycles = round(travel / speed / CYCLE_S)
    return np.concatenate([np.zeros(50), np.arange(cycles) * speed * CYCLE_S, np.full(50, travel)])


def under(moment: float, angle: Array, model: FrictionModel = MODEL) -> float:
    return peak_torque(angle, CYCLE_S, np.full(len(angle), moment), model)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_breaks_away_against_static_friction_and_load(sign: float) -> None:
    speed, moment = 0.01, 100.0
    step = P["J"] * speed / LOOP_S
    expected = P["Ms"] + moment * P["mu_s"] + step
    assert under(moment, sign * constant(0.02, speed)) == pytest.approx(
        expected, rel=0.3 * step / expected
    )
    assert under(0.0, sign * constant(0.02, speed)) == pytest.approx(
        P["Ms"] + step, rel=0.3 * step / P["Ms"]
    )


def test_a_fast_motion_is_ruled_by_damping() -> None:
    speed, moment = 2.0, 100.0
    rise = np.cumsum(
        np.concatenate([np.linspace(0.0, speed, 4000), np.linspace(speed, 0.0, 4000)]) * CYCLE_S
    )
    expected = (
        P["Mc"]
        + P["sigma_2"] * speed
        + moment * (P["mu_c"] + P["mu_2"] * speed)
        + P["J"] * speed / 4.0
    )
    assert under(moment, rise) == pytest.approx(expected, rel=0.02)


def test_inertia_counts_where_the_motion_turns() -> None:
    """A sine's greatest acceleration is where its speed is none, and friction static."""
    amplitude, frequency = 0.03, 8.0
    t = np.arange(3000) * CYCLE_S
    angle = amplitude * (1.0 - np.cos(2.0 * math.pi * frequency * t)) * 0.5
    acceleration = 0.5 * amplitude * (2.0 * math.pi * frequency) ** 2
    assert under(0.0, angle) == pytest.approx(P["Ms"] + P["J"] * acceleration, rel=0.02)
    heavy = dataclasses.replace(MODEL, values={**P, "J": 2.0})
    assert under(0.0, angle, heavy) == pytest.approx(P["Ms"] + 2.0 * acceleration, rel=0.02)


def planned(
    text: str, tmp_path: Path, bench: str = "practical", first_pass: bool | None = None
) -> tuple[Plan, Any]:
    path = tmp_path / "s.yaml"
    path.write_text(f"sequence: 1\nname: s\nstages:\n{text}")
    document = load_bench(bench)
    return make_plan(load_located(path, Sequence), document, first_pass), document.value


LOADED = """\
  - {name: heavy, stage: loaded, weight_kg: 20, tones: [{amplitude_deg: 5, frequency_Hz: 1}],
     duration_s: 4,
     center_deg: 10, repeats: 2}
"""


def test_the_moves_to_each_part_are_known(tmp_path: Path) -> None:
    plan, _ = planned(LOADED, tmp_path, first_pass=True)
    (stage,) = plan.stages
    moves = moves_to_start(stage, plan)
    starts = [
        float(stage.first_passes[0].targets[0]),
        float(stage.targets[0]),
        float(stage.targets[0]),
    ]
    assert moves[0][0] == 0.0
    assert [float(move[-1]) for move in moves] == starts[: len(moves)]
    speeds = [np.max(np.abs(np.diff(move))) / plan.cycle_s for move in moves]
    assert max(speeds) <= plan.approach_speed * (1 + 1e-6)


SIMULATED = """\
sequence: 1
name: s
stages:
  - {name: tone, stage: unloaded, tones: [{amplitude_deg: 8, frequency_Hz: 0.8}], duration_s: 4}
  - {name: heavy, stage: loaded, weight_kg: 30.6, tones: [{amplitude_deg: 8, frequency_Hz: 0.8}],
     duration_s: 4}
  - {name: ramp, stage: loaded, weight_kg: 10, ramp: {travel_deg: 4, speed_deg_s: 4}, duration_s: 3}
  - {name: quick, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 3}], duration_s: 3}
"""


def test_the_simulated_bench_takes_what_was_predicted(elsewhere: Path) -> None:
    """What its loops add where the joint breaks away is not in the prediction."""
    Path("s.yaml").write_text(SIMULATED)
    document = load_bench("practical")
    plan = make_plan(load_sequence("s.yaml"), document)
    model = friction_model(bench_constants(document.value))
    peaks = predicted_peaks(plan, document.value, model)
    predicted = {peak.stage: peak.torque_N_m for peak in peaks}
    assert status(["run", "s.yaml", "--yes", "--out", "run"]) == 0
    for recording in load_run(Path("run")).recordings:
        taken = 3.0 * float(np.max(np.abs(recording.channels["current"])))
        assert 0.8 < taken / predicted[recording.name.partition("[")[0]] < 1.25, recording.name


def test_a_hot_firing_is_predicted_from_its_pressure() -> None:
    document = load_bench("practical_hot")
    plan = make_plan(load_sequence("hotfire"), document)
    peaks = {p.stage: p.torque_N_m for p in predicted_peaks(plan, document.value, MODEL)}
    force = next(stage for stage in plan.stages if stage.name == "sine").contact_force_N
    assert peaks["sine"] == pytest.approx(P["Ms"] + force * 0.095 * P["mu_s"], rel=0.1)
    assert peaks["flow"] > peaks["sine"]
