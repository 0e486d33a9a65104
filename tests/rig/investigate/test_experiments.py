"""Experiments: within the limits of the bench, simulated on what is believed of it, and costed."""

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from identification.effects.model import CorrectedModel
from identification.model.parameters import NOMINAL
from identification.views.view import one_clock
from rig.common.errors import InputError
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.config.sequence import StageSection, Tone, load_sequence, sequence_text
from rig.investigate.experiments import (
    CONFIRM_S,
    HANG_S,
    OFF_S,
    START_S,
    Part,
    SimulatedBench,
    as_document,
    bench_seconds,
    family,
    weight_changes,
    weights,
)
from rig.planning.plan import make_plan

MODEL = CorrectedModel(dict(NOMINAL))


def limited(**limits: float) -> Document[Bench]:
    bench = load_bench("practical")
    changed = bench.value.limits.model_copy(update=limits)
    return dataclasses.replace(bench, value=bench.value.model_copy(update={"limits": changed}))


def swing(amplitude_deg: float, frequency_Hz: float, mass: float = 0.0) -> Part:
    stage = StageSection(
        name=f"swing-{mass:g}",
        stage="loaded" if mass else "unloaded",
        weight_kg=mass,
        tones=(Tone(amplitude_deg=amplitude_deg, frequency_Hz=frequency_Hz),),
        duration_s=2.0,
        ramp_in_s=0.5,
        ramp_out_s=0.5,
    )
    return Part(stage.name, (stage,))


@pytest.mark.parametrize("bench", [limited(), limited(angle_min_deg=5.0, speed_deg_s=40.0)])
def test_every_part_is_a_plan_within_the_limits(bench: Document[Bench]) -> None:
    for part in family(bench.value, np.random.default_rng(0)):
        plan = make_plan(as_document("x", [part]), bench)
        assert plan.stages, part.name


def test_a_seed_gives_the_same_parts_and_another_seed_others() -> None:
    bench = load_bench("practical").value
    first, again, other = (family(bench, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert first == again
    assert [p.name for p in first] == [p.name for p in other]
    assert first != other


def test_weights_are_those_of_the_file_within_the_limits() -> None:
    bench = load_bench("practical").value
    assert weights(bench.model_copy(update={"weights_kg": (50.0, 5.0, 12.0)})) == (5.0, 12.0)
    assert weights(bench.model_copy(update={"weights_kg": (50.0,)})) == ()
    assert all(0.0 < w < bench.limits.weight_kg for w in weights(bench))
    limits = bench.limits.model_copy(update={"weight_kg": 13.0})
    assert weights(bench.model_copy(update={"weights_kg": (13.0,), "limits": limits})) == (13.0,)


def test_a_weight_is_hung_once_and_costs_the_operator_s_time() -> None:
    parts = [swing(5.0, 0.5, 10.0), swing(5.0, 0.5), swing(6.0, 0.4, 10.0)]
    parts[2] = parts[2]._replace(stages=(parts[2].stages[0].model_copy(update={"name": "again"}),))
    document = as_document("x", parts)
    assert [s.weight_kg for s in document.value.stages] == [0.0, 10.0, 10.0]
    assert weight_changes(document.value.stages) == 1
    plan = make_plan(document, load_bench("practical"))
    hands = START_S + 2 * HANG_S + 2 * CONFIRM_S  # the weight is taken off for the next run
    assert plan.duration_s + hands <= bench_seconds(plan) < plan.duration_s + hands + 10.0


def test_the_sequence_of_an_experiment_is_a_file(tmp_path: Path) -> None:
    parts = family(load_bench("practical").value, np.random.default_rng(0))[:3]
    document = as_document("x", parts)
    file = tmp_path / "x.yaml"
    file.write_text(sequence_text(document.value, "# why\n"))
    assert load_sequence(file).value == document.value


def test_the_truth_of_a_simulated_bench_is_not_known(tmp_path: Path) -> None:
    text = load_bench("practical").path.read_text()
    file = tmp_path / "bench.yaml"
    file.write_text(
        text.replace("effects: {}", "effects: {backlash: {gap_rad: 0.007}}").replace(
            "Mc_N_m: 6.825", "Mc_N_m: 9.5"
        )
    )
    bench = SimulatedBench.of(load_bench(file))
    assert "backlash" not in json.dumps(bench.base)
    machine = bench.machine(MODEL)
    assert machine.effects == {}
    assert machine.joint.Mc_N_m == NOMINAL["Mc"]
    assert machine.sensing.current_noise_A == 0.0


def test_a_misfit_without_inertia_or_fall_of_friction_can_be_simulated() -> None:
    bench = SimulatedBench.of(load_bench("practical"))
    machine = bench.machine(CorrectedModel({**NOMINAL, "J": 0.0, "omega_sf": 0.0}))
    assert machine.joint.inertia_kg_m2 == pytest.approx(NOMINAL["J"])
    assert machine.joint.omega_sf_rad_s == NOMINAL["omega_sf"]


def test_a_model_that_no_machine_can_have_is_refused() -> None:
    bench = SimulatedBench.of(load_bench("practical"))
    with pytest.raises(InputError, match="J"):
        bench.machine(CorrectedModel({"Mc": 6.8}))
    wrong = {"backlash": {"gap_rad": -1.0}}
    with pytest.raises(InputError, match="backlash"):
        bench.machine(CorrectedModel(dict(NOMINAL), effects=wrong))


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        ({}, ""),
        ({"current_A": 4.5}, "current"),
        ({"torque_N_m": 13.5}, "torque"),
        ({"speed_deg_s": 40.0}, "speed"),
        ({"angle_max_deg": 11.0}, "angle"),
        ({"following_error_deg": 0.05}, "following"),
        ({"supply_min_V": 61.0, "supply_max_V": 72.0}, "supply"),
    ],
)
def test_an_experiment_near_a_limit_is_refused(limits: dict[str, float], problem: str) -> None:
    bench = SimulatedBench.of(limited(**limits))
    plan = make_plan(as_document("x", [swing(10.0, 0.5)]), bench.document)
    found = bench.simulate(plan, bench.machine(MODEL))
    assert problem in found.problem
    assert bool(found.problem) is bool(problem)
    assert [len(r.time) for r in found.recordings] == [2000]


def test_the_peaks_of_a_plan_are_those_of_every_hypothesis() -> None:
    bench = SimulatedBench.of(load_bench("practical"))
    heavy = as_document("x", [swing(10.0, 0.5, 39.0)])
    bench.plan(heavy, [MODEL])
    sticky = CorrectedModel({**NOMINAL, "Ms": 80.0})
    with pytest.raises(InputError, match="torque"):
        bench.plan(heavy, [MODEL, sticky])


def test_the_stages_of_a_simulated_experiment_are_on_one_clock() -> None:
    bench = SimulatedBench.of(load_bench("practical"))
    stages = tuple(
        swing(2.0, 1.0).stages[0].model_copy(update={"name": n, "repeats": 2}) for n in "ab"
    )
    plan = make_plan(as_document("x", [Part("x", stages)]), bench.document)
    found = bench.simulate(plan, bench.machine(MODEL)).recordings
    assert len(found) == 4
    assert one_clock(found)
    rests = [later.time[0] - first.time[-1] for first, later in itertools.pairwise(found)]
    assert rests[1] > OFF_S + rests[0] - 0.1
