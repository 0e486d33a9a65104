"""Blind rigs, of friction and of gas: what is drawn, and that nothing written tells it."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.mock.plant.effects.gas import GAS_CATALOGUE, GAS_OUTSIDE
from drivers.mock.plant.effects.pack import effect_vector, problems
from identification.effects import EFFECTS
from rig.cli.entry import status
from rig.results.prove import gas_simulate
from rig.results.prove.draw import OUTSIDE_SIZES, SIZES, Kind, Rig, assignment, draw
from rig.results.prove.excitation import CYCLE_S, WIDE, Experiment, experiments
from rig.results.prove.gas_simulate import (
    GAS_OUTSIDE_SIZES,
    GAS_SIZES,
    GasExperiment,
    draw_gas,
    gas_experiments,
)
from rig.results.prove.judge import Judgement
from rig.results.prove.score import STRONG
from rig.results.prove.simulate import (
    SETTLE_S,
    as_recorded,
    campaign,
    floors,
    left_over,
    reference_of,
    strength,
    write,
)
from rig.results.prove.truth import unseal
from rig.runs.recorded_inputs import true_parameters
from rig.sources import load_source

HIDES = ("backlash", "asymmetric_coulomb")


PROBES: dict[Kind, tuple[str, ...]] = {"nothing": (), "one": ("cogging",), "outside": ("x_bursts",)}


def short(rig: Rig, cycles: int = 2000) -> tuple[Rig, list[Experiment]]:
    """Return a rig with two of its first and its last experiment, and so many cycles of each."""
    chosen = (experiments()[0], experiments()[3], experiments()[-1])
    return rig._replace(pauses_s=rig.pauses_s[:3]), [
        e._replace(command=e.command[:cycles]) for e in chosen
    ]


def test_what_is_sealed_is_told_as_a_recording_shows_it() -> None:
    """It begins after the machine has settled; the swing that it shows is the smaller by then."""
    hidden = {
        "encoder_slip": {"angle_rad": 0.01, "at_s": 5.0, "recording": 2.0},
        "load_swing": {"fraction": 0.2, "frequency_Hz": 1.0, "decay_s": 4.0},
    }
    told = as_recorded(hidden)
    assert told["encoder_slip"] == {**hidden["encoder_slip"], "at_s": 5.0 - SETTLE_S}
    assert told["load_swing"] == {
        **hidden["load_swing"],
        "fraction": pytest.approx(0.2 * np.exp(-SETTLE_S / 4.0)),
    }
    assert hidden["load_swing"]["fraction"] == 0.2, "the machine's own are as they were"


@pytest.mark.parametrize("name", [*SIZES, *OUTSIDE_SIZES])
def test_every_draw_is_one_that_the_machine_takes(name: str) -> None:
    for seed in range(20):
        machine = draw("one", (name,), (seed, 1)).machine
        assert list(problems(machine.effects)) == []
        assert effect_vector(machine).size
        assert machine.joint.Ms_N_m > machine.joint.Mc_N_m
        assert machine.joint.mu_s > machine.joint.mu_c


def test_a_full_proof_goes_round_the_catalogue() -> None:
    drawn = assignment(600, 4)
    kinds = Counter(kind for kind, _ in drawn)
    assert kinds == {"one": 300, "nothing": 200, "two": 60, "outside": 40}
    singles = Counter(names for kind, names in drawn if kind == "one")
    assert len(singles) == len(SIZES)
    assert max(singles.values()) - min(singles.values()) <= 1
    assert all(len(set(names)) == 2 for kind, names in drawn if kind == "two")


def test_the_experiments_stay_within_the_bench() -> None:
    plan = experiments()
    assert Counter(e.role for e in plan) == {"fit": 9, "validate": 4}
    assert len({e.weight_kg for e in plan}) == 4
    for e in plan:
        assert len(e.command) == round(30.0 / CYCLE_S)
        assert np.max(np.abs(e.command)) <= WIDE
        assert np.max(np.abs(np.diff(e.command))) / CYCLE_S < np.deg2rad(115.0)
        assert np.max(np.abs(np.diff(e.command, 2))) / CYCLE_S**2 < 45.0
        assert abs(e.command[0]) < 1e-9
        assert abs(e.command[-1]) < 1e-4


def test_the_folder_reads_as_a_campaign_and_tells_nothing(tmp_path: Path) -> None:
    rig, plan = short(draw("two", HIDES, (3, 1)))
    recorded = campaign(rig, plan)
    path = write(tmp_path / "rig", rig.machine, recorded)
    dataset = load_source(path)
    assert [r.weight_mass for r in dataset.recordings] == [0.0, 10.0, 0.0]
    starts = [float(r.channels["time"][0]) for r in dataset.recordings]
    assert np.all(np.diff(starts) > 2.0 + 15.0)
    assert dataset.recordings[0].averaged == {"current", "voltage"}
    np.testing.assert_array_equal(
        dataset.recordings[1].channels["angle"], recorded[1].samples.angle
    )
    text = path.read_text()
    hidden = [str(v) for given in rig.machine.effects.values() for v in given.values()]
    hidden += [str(v) for v in true_parameters(rig.machine).values()]
    assert not [word for word in (*HIDES, *hidden, str(rig.seed)) if word in text]
    assert {p.suffix for p in path.parent.iterdir()} == {".yaml", ".npz"}


def test_the_kind_of_load_tells_nothing() -> None:
    loads = {
        kind: [draw(kind, names, (5, k)).gravity for k in range(60)]
        for kind, names in PROBES.items()
    }
    assert all(0 < sum(gravity) < 20 for gravity in loads.values())
    assert draw("one", ("load_dependent_friction",), (5, 1)).gravity
    assert not any(draw("one", ("load_swing",), (5, k)).gravity for k in range(60))


def test_a_gravity_bench_says_what_turns_with_the_joint(tmp_path: Path) -> None:
    rig, _ = short(draw("one", ("load_dependent_friction",), (3, 1)))
    plan = [
        e._replace(command=e.command[:3000]) for e in (experiments(True)[0], experiments(True)[3])
    ]
    rig = rig._replace(pauses_s=rig.pauses_s[:2])
    held = campaign(rig._replace(machine=replace(rig.machine, effects={})), plan)
    dataset = load_source(write(tmp_path / "rig", rig.machine, held))
    assert [(r.stage, r.weight_mass) for r in dataset.recordings] == [("unloaded", 0.0)] * 2
    assert [r.pendulum.zero for r in dataset.recordings if r.pendulum] == [0.0, -0.8]
    tilted = held[1].samples
    moving = tilted.velocity > 0.2
    friction = 3.0 * np.mean(tilted.current[moving])
    weight = 10.0 * 9.80665 * 0.1 * np.mean(np.sin(tilted.angle[moving] + 0.8))
    backward = 3.0 * np.mean(tilted.current[tilted.velocity < -0.2])
    assert friction + backward == pytest.approx(2.0 * weight, rel=0.15)


@pytest.mark.proof
def test_a_loss_that_the_constants_absorb_is_told_from_one_that_stays() -> None:
    """Both change the current; but the gear's loss is a bench with other constants."""
    rig, plan = short(draw("one", ("asymmetric_coulomb",), (3, 1)), 8000)
    floor = floors(rig.machine, reference_of(rig, plan))

    def shown(hides: dict[str, dict[str, float]]) -> tuple[float, float]:
        hiding = campaign(rig._replace(machine=replace(rig.machine, effects=hides)), plan)
        left = left_over(floors(rig.machine, hiding), floor)
        return strength(hiding, reference_of(rig, plan))["current"], left["torque"]

    asymmetry = shown({"asymmetric_coulomb": {"torque_Nm": 1.0}})
    loss = shown({"transmission_efficiency": {"efficiency": 0.85}})
    assert min(asymmetry[0], loss[0]) > STRONG
    assert asymmetry[1] > STRONG
    assert loss[1] < 1.5
    by_name = {e.name: e for e in experiments()}
    plan[1] = by_name["m"]._replace(command=by_name["m"].command[:8000])
    floor = floors(rig.machine, reference_of(rig, plan))
    assert shown({"transmission_efficiency": {"efficiency": 0.85}})[1] > STRONG, (
        "a weight that drives the motor back"
    )


ONE = ("one", ("leakage",))
SEED = (5, 1)


def test_every_gas_effect_can_be_drawn_hidden_and_named() -> None:
    named = [e.name for e in EFFECTS.values() if e.group == "gas generator"]
    assert list(GAS_SIZES) == list(GAS_CATALOGUE) == named
    assert GAS_OUTSIDE_SIZES.keys() == GAS_OUTSIDE.keys()


@pytest.mark.parametrize("name", [*GAS_SIZES, *GAS_OUTSIDE_SIZES])
def test_draws_are_within_what_the_plant_can_hide(name: str) -> None:
    machines = [draw_gas("one", (name,), (seed, 1)).machine for seed in range(20)]
    assert not [text for machine in machines for text in problems(machine.effects)]
    noises = [m.gas.transmitter.noise_Pa / m.gas.transmitter.range_Pa for m in machines]
    assert 0.001 <= min(noises) < max(noises) <= 0.0025
    assert len({m.gas.burning_rate_mm_s for m in machines}) == 20


@pytest.fixture
def short_burns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have burns of 3 s."""
    plan = tuple(GasExperiment(e.name, e.role, e.command[:3000]) for e in gas_experiments())
    monkeypatch.setattr(gas_simulate, "gas_experiments", lambda: plan)


@pytest.mark.usefixtures("short_burns")
def test_a_rig_is_sealed_and_its_campaign_tells_nothing(tmp_path: Path) -> None:
    sealed = gas_simulate.seal_gas(tmp_path, 1, ONE, SEED)
    strengths = gas_simulate.simulate_gas(sealed, ONE, SEED)
    assert strengths["pressure"] > 0.1
    truth = unseal(sealed.truth, sealed.digest)
    assert truth.effects == draw_gas(*ONE, SEED).machine.effects
    dataset = load_source(sealed.campaign)
    assert all(
        r.channels.keys() == {"time", "command", "angle", "pressure"} for r in dataset.recordings
    )
    text = sealed.campaign.read_text()
    assert not [
        word
        for word in ("leakage", *map(str, truth.record(1)["parameters"].values()))
        if word in text
    ]
    other = gas_simulate.seal_gas(tmp_path, 2, ("nothing", ()), (5, 2))
    assert gas_simulate.simulate_gas(other, ("nothing", ()), (5, 2)) == {}
    assert other.campaign.read_text() == text


def test_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def blind(source: Path, seed: int) -> Judgement:
        shift = {"n": {"before": 0.5, "after": 0.51, "unit": "1"}}
        fit = {"validate_baseline_rms": 2.0, "validate_final_rms": 2.0, "noise_floor_rms": 1.0}
        record = {"verdict": "nothing_missing", "effects": [], "location": None, "p_value": 1.0}
        record |= {"fit": fit, "fits": [fit], "parameter_shift": shift}
        return Judgement(record, {}, lambda _names: None, 0.0, 0.0)

    plan = tuple(GasExperiment(e.name, e.role, e.command[:500]) for e in gas_experiments())
    monkeypatch.setattr(gas_simulate, "gas_experiments", lambda: plan)
    monkeypatch.setattr("rig.results.prove.judge.judge", blind)
    out = tmp_path / "proof"
    assert status(["prove", "--gas", "--rigs", "4", "--seed", "2", "--out", str(out)]) == 0
    result = json.loads((out / "prove.json").read_text())
    assert result["false_alarms"]["n"] == 0
    assert result["counts"] == {"one": 2, "two": 0, "nothing": 2, "outside": 0, "unscored": 0}
    assert all(set(row["nominal"]) == {"n"} for row in result["rigs"])
    assert status(["prove", "--rigs", "4", "--seed", "2", "--out", str(out)]) == 2
