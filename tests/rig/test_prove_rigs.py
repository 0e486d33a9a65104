"""Blind rigs, of friction and of gas: what is drawn, and that nothing written tells it."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.mock.plant.effects.pack import effect_vector, problems
from rig.results.prove.draw import OUTSIDE_SIZES, SIZES, Kind, Rig, assignment, draw
from rig.results.prove.excitation import CYCLE_S, WIDE, Experiment, experiments
from rig.results.prove.score import STRONG
from rig.results.prove.simulate import (
    SETTLE_S,
    Recorded,
    as_recorded,
    campaign,
    floors_of,
    left_over,
    reference_of,
    strength,
    write,
)
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
def test_a_loss_that_the_constants_absorb_is_told_from_one_that_stays(tmp_path: Path) -> None:
    """Both change the current; but the gear's loss is a bench with other constants."""

    def floor_of(recorded: list[Recorded]) -> dict[str, float]:
        return floors_of(write(tmp_path, rig.machine, recorded, packed=False))

    rig, plan = short(draw("one", ("asymmetric_coulomb",), (3, 1)), 8000)
    floor = floor_of(reference_of(rig, plan))

    def shown(hides: dict[str, dict[str, float]]) -> tuple[float, float]:
        hiding = campaign(rig._replace(machine=replace(rig.machine, effects=hides)), plan)
        left = left_over(floor_of(hiding), floor)
        return strength(hiding, reference_of(rig, plan))["current"], left["torque"]

    asymmetry = shown({"asymmetric_coulomb": {"torque_Nm": 1.0}})
    loss = shown({"transmission_efficiency": {"efficiency": 0.85}})
    assert min(asymmetry[0], loss[0]) > STRONG
    assert asymmetry[1] > STRONG
    assert loss[1] < 1.5
    by_name = {e.name: e for e in experiments()}
    plan[1] = by_name["m"]._replace(command=by_name["m"].command[:8000])
    floor = floor_of(reference_of(rig, plan))
    assert shown({"transmission_efficiency": {"efficiency": 0.85}})[1] > STRONG, (
        "a weight that drives the motor back"
    )
