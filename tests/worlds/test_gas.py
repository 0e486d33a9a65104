"""Blind firings of the gas generator: what is drawn, and that nothing written tells it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.worlds import gas
from benchmarks.worlds.gas import (
    GAS_OUTSIDE_SIZES,
    GAS_SIZES,
    GasExperiment,
    draw_gas,
    gas_assignment,
    gas_experiments,
)
from drivers.mock.plant.effects.gas import GAS_CATALOGUE, GAS_OUTSIDE
from drivers.mock.plant.effects.pack import problems
from identification.effects import EFFECTS
from rig.results.prove.engine import Processes
from rig.results.prove.judge import oracle_of
from rig.results.prove.truth import unseal
from rig.sources import load_source


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


def test_rigs_are_sealed_and_their_campaigns_tell_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Burns of 3 s."""
    plan = tuple(GasExperiment(e.name, e.role, e.command[:3000]) for e in gas_experiments())
    monkeypatch.setattr(gas, "gas_experiments", lambda: plan)
    rigs = gas.seal_gas(tmp_path, 4, 2, Processes(1), lambda what, share: None, lambda n: "salt")
    kinds = {}
    for n, (sealed, assigned) in enumerate(zip(rigs, gas_assignment(4, 2), strict=True), start=1):
        truth = unseal(sealed.truth, sealed.digest)
        assert truth.effects == draw_gas(*assigned, (2, n)).machine.effects
        kinds.setdefault(truth.kind, []).append(truth.strength.get("pressure", 0.0) > 0.0)
        channels = {tuple(sorted(r.channels)) for r in load_source(sealed.campaign).recordings}
        assert channels == {("angle", "command", "pressure", "time")}
        text = sealed.campaign.read_text()
        assert not [
            word for word in (*truth.effects, *map(str, truth.parameters.values())) if word in text
        ]
    assert kinds == {"one": [True, True], "nothing": [False, False]}
    assert len({sealed.campaign.read_text() for sealed in rigs}) == 1
    assert oracle_of(rigs[0].campaign, ["leakage"]) is None, "the oracle is of the motion"
