"""The blind gas rigs: drawn over the catalogue, within the plant's ranges, telling nothing."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from drivers.mock.plant.effects.gas import GAS_CATALOGUE, GAS_OUTSIDE
from drivers.mock.plant.effects.pack import problems
from identification.effects import EFFECTS
from rig.cli.entry import status
from rig.results.prove import gas_simulate
from rig.results.prove.excitation import CYCLE_S
from rig.results.prove.gas_simulate import (
    GAS_OUTSIDE_SIZES,
    GAS_SIZES,
    GasExperiment,
    draw_gas,
    gas_experiments,
)
from rig.results.prove.judge import Judgement
from rig.results.prove.truth import unseal
from rig.sources.load import load_source

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


def test_the_burns_stay_within_the_bench() -> None:
    plan = gas_experiments()
    assert Counter(e.role for e in plan) == {"fit": 6, "validate": 2}
    for e in plan:
        assert len(e.command) == round(20.0 / CYCLE_S)
        assert np.degrees(np.min(e.command)) > -1e-9
        assert np.degrees(np.max(e.command)) < 29.0
        assert np.max(np.abs(np.diff(e.command))) / CYCLE_S < np.deg2rad(210.0)
        assert abs(e.command[0]) < 1e-4


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have burns of 3 s."""
    plan = tuple(GasExperiment(e.name, e.role, e.command[:3000]) for e in gas_experiments())
    monkeypatch.setattr(gas_simulate, "gas_experiments", lambda: plan)


@pytest.mark.usefixtures("short")
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
